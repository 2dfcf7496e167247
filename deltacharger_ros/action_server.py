# SPDX-License-Identifier: Apache-2.0
"""Actions that take every goal: only a result can carry a code and a reason, a refusal cannot."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable
from typing import Any, Protocol, TypeAlias

from rclpy.action.server import ActionServer, CancelResponse, GoalResponse, ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from deltacharger_core.texts import titled
from deltacharger_ros.log import Log
from deltacharger_ros.messages import to_outcome
from deltacharger_ros.qos import ACTION

GoalHandle: TypeAlias = "ServerGoalHandle[Any, Any, Any]"  # in words, since Jazzy's class is not generic

_LOOK = 1.0  # s between two looks whether somebody still works on a goal
_TOLD_WITHIN = 0.1  # s for the result to leave: rclpy sends it later, from another thread, and tells nobody when


class Ended(Protocol):
    """How work ended."""

    @property
    def success(self) -> bool:
        """Whether it was done."""

    @property
    def canceled(self) -> bool:
        """Whether it ended because its client wished so."""


class Work:
    """What a goal has begun, and it and those that joined it wait for.

    Args:
        handle: of that goal.

    Attributes:
        handles: of the goals that wait.
        outcome: how it ended; None until then.
        done: set when it has ended.
        answered: set when a goal has its result.
    """

    def __init__(self, handle: GoalHandle) -> None:
        self.handles = [handle]
        self.outcome: Any = None
        self.done = threading.Event()
        self.answered = threading.Event()
        self._told: object = None
        self._told_at = -math.inf

    def end(self, outcome: Ended) -> None:
        """Let all goals that wait be answered."""
        self.outcome = outcome
        self.done.set()

    def is_due(self, news: object, period: float) -> bool:
        """Return whether feedback is due, and take it as given: `news` has changed, or a period (s) has passed."""
        now = time.monotonic()
        if news == self._told and now - self._told_at < period:
            return False
        self._told, self._told_at = news, now
        return True

    def feed_back(self, message: Any) -> None:
        """Publish feedback to all clients."""
        for handle in self.handles:
            with contextlib.suppress(RuntimeError):  # the client may have gone meanwhile
                handle.publish_feedback(message)

    def wait_until_told(self, timeout: float) -> None:
        """Wait until a client can have heard of the end; at most `timeout` s for its goal's callback to see it."""
        if self.answered.wait(timeout):
            threading.Event().wait(_TOLD_WITHIN)


class WorkServer:
    """Serves an action. A goal waits for the end of its work in a worker of the node's `Spinner`.

    It logs how each goal ended, who cancels it, and where nobody is left to hear of it.

    Args:
        node: owns it.
        kind: the action.
        name: its name.
        begin: begins, or joins, the work that a goal asks for; what it raises aborts the goal.
        is_served: whether somebody still works on it; a goal that nobody serves must not wait for ever.
        outcome: how a goal ended whose `begin` raised this; of what is no refusal, an internal error.
        refusals: what `begin` raises to refuse a goal.
        result: makes the message of an outcome, and of the work where there was any.
        may_cancel: whether a client may take its goal back now.
        accepted: calls `execute` of a goal's handle, now or later.
    """

    def __init__(
        self,
        node: Node,
        kind: Any,
        name: str,
        begin: Callable[[GoalHandle], Work],
        is_served: Callable[[Work], bool],
        outcome: Callable[[Exception], Ended],
        refusals: type[Exception],
        result: Callable[[Any, Any], Any],
        may_cancel: Callable[[GoalHandle], bool] = lambda handle: True,
        accepted: Callable[[GoalHandle], None] = lambda handle: handle.execute(),
    ) -> None:
        self._node, self._name, self._log = node, name, Log(node)
        self._may_cancel = may_cancel
        self._begin, self._is_served = begin, is_served
        self._outcome, self._refusals, self._result = outcome, refusals, result
        self._server: ActionServer[Any, Any, Any] = ActionServer(
            node,
            kind,
            name,
            execute_callback=self._execute,
            goal_callback=lambda request: GoalResponse.ACCEPT,
            handle_accepted_callback=accepted,
            cancel_callback=self._on_cancel,
            callback_group=ReentrantCallbackGroup(),
            **ACTION,
        )

    def destroy(self) -> None:
        """Release the ROS side."""
        self._server.destroy()

    def _title(self, handle: GoalHandle) -> str:
        return titled(self._name, handle.request.request_id)

    def _on_cancel(self, handle: GoalHandle) -> CancelResponse:
        allowed = self._may_cancel(handle)
        self._log.info(f"{self._title(handle)}: cancelled by a client" + ("" if allowed else " too late, it has ended"))
        return CancelResponse.ACCEPT if allowed else CancelResponse.REJECT

    def _execute(self, handle: GoalHandle) -> Any:
        try:
            work = self._begin(handle)
        except Exception as error:  # rclpy would answer with an empty result, which looks like code 0
            if not isinstance(error, self._refusals):
                self._log.error(f"a goal met a defect: {type(error).__name__}: {error}")
            handle.abort()
            result = self._result(self._outcome(error), None)
            self._tell_end(handle, result, "refused")
            return result
        heard = False
        while not work.done.wait(_LOOK):
            if not self._is_served(work) and not work.done.is_set():
                work.end(self._outcome(LookupError("the goal was lost")))
            before, heard = heard, self._is_heard()
            if before and not heard:
                self._log.info(
                    f"{self._title(handle)}: its client has gone; the goal goes on until it ends or is cancelled"
                )
        if work.outcome.success:
            handle.succeed()
        elif work.outcome.canceled and handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        work.answered.set()
        result = self._result(work.outcome, work)
        self._tell_end(handle, result)
        return result

    def _tell_end(self, handle: GoalHandle, result: Any, failed: str = "failed") -> None:
        """Log how a goal ended; an error in that must not cost its client the result."""
        try:
            outcome = to_outcome(self._name, result)
            line = f"{self._title(handle)}: {outcome.ending(failed)}"
            if failed == "failed":
                lasted = "" if outcome.success else f" (after {outcome.elapsed:.1f} s)"
                line = "; ".join(filter(None, (f"{line}{lasted}", outcome.figures())))
            self._log.info(line)
        except Exception as error:
            self._log.error(f"the end of a goal cannot be told: {type(error).__name__}: {error}")

    def _is_heard(self) -> bool:
        """Return whether any client follows goals of this action."""
        return self._node.count_subscribers(f"{self._node.resolve_topic_name(self._name)}/_action/feedback") > 0
