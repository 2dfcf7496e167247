# SPDX-License-Identifier: Apache-2.0
"""Action server that accepts every goal, because only a result can carry an error code and a reason."""

import contextlib
import math
import threading
import time
from collections.abc import Callable
from typing import Any, TypeAlias

from rclpy.action.server import ActionServer, CancelResponse, GoalResponse, ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from deltacharger_core.ros import log, messages, qos
from deltacharger_core.texts import titled

GoalHandle: TypeAlias = "ServerGoalHandle[Any, Any, Any]"  # a string, because Jazzy's class is not generic

KEPT = 3600  # s that a result is kept for a client that was away; rcl names each kept goal in every status message
_CHECK_PERIOD = 1.0  # s between checks whether a goal is still served
_SEND_TIME = 0.1  # s for the result to leave: rclpy sends it later, from another thread, without notice


class Work:
    """Work that a goal has started.

    Attributes:
        handle: of the goal.
        outcome: how the work ended; None before.
        done: set when the work has ended.
        answered: set when a goal has its result.
    """

    def __init__(self, handle: GoalHandle) -> None:
        self.handle = handle
        self.outcome: Any = None
        self.done = threading.Event()
        self.answered = threading.Event()
        self._last_news: object = None
        self._fed_back_at = -math.inf

    def end(self, outcome: Any) -> None:
        """Answer the goal; `outcome` has `success` and `canceled`."""
        self.outcome = outcome
        self.done.set()

    def is_due(self, news: object, period: float) -> bool:
        """Return whether feedback is due: `news` has changed or `period` s have passed. True restarts the period."""
        now = time.monotonic()
        if news == self._last_news and now - self._fed_back_at < period:
            return False
        self._last_news, self._fed_back_at = news, now
        return True

    def feed_back(self, message: Any) -> None:
        """Publish feedback."""
        with contextlib.suppress(RuntimeError):  # the client may have left
            self.handle.publish_feedback(message)

    def wait_until_answered(self, timeout: float) -> None:
        """Wait until a client has probably received the result; `timeout`: s for the goal's callback to set it."""
        if self.answered.wait(timeout):
            threading.Event().wait(_SEND_TIME)


class WorkServer:
    """Serves an action. A goal waits for the end of its work in a worker of the node's `Spinner`.

    It logs the end of each goal, and cancels.

    Args:
        node: owner.
        kind: action type.
        name: action name.
        begin: starts the work of a goal; an exception aborts the goal.
        is_served: whether the work is still being done; a goal must not wait for ever.
        outcome: converts an exception of `begin` to an outcome; internal error unless it is a refusal.
        refusals: exception that `begin` raises to refuse a goal.
        result: builds the result message from the outcome and the work (None = none).
        may_cancel: whether a client may cancel the goal now.
        accepted: calls `execute` of a goal's handle, now or later.
    """

    def __init__(
        self,
        node: Node,
        kind: Any,
        name: str,
        begin: Callable[[GoalHandle], Work],
        is_served: Callable[[Work], bool],
        outcome: Callable[[Exception], Any],
        refusals: type[Exception],
        result: Callable[[Any, Any], Any],
        may_cancel: Callable[[GoalHandle], bool] = lambda handle: True,
        accepted: Callable[[GoalHandle], None] = lambda handle: handle.execute(),
    ) -> None:
        self._name, self._log = name, log.Log(node)
        self._may_cancel = may_cancel
        self._begin, self._is_served = begin, is_served
        self._outcome, self._refusals, self._result = outcome, refusals, result
        self._server: Any = ActionServer(
            node,
            kind,
            name,
            execute_callback=self._execute,
            goal_callback=lambda request: GoalResponse.ACCEPT,
            handle_accepted_callback=accepted,
            cancel_callback=self._on_cancel,
            callback_group=ReentrantCallbackGroup(),
            result_timeout=KEPT,
            **qos.ACTION,
        )

    def destroy(self) -> None:
        """Release the ROS side."""
        self._server.destroy()

    def _title(self, handle: GoalHandle) -> str:
        return titled(self._name, handle.request.request_id)

    def _on_cancel(self, handle: GoalHandle) -> CancelResponse:
        allowed = self._may_cancel(handle)
        text = "cancelled by a client" if allowed else "a client's cancel came too late: the goal has ended"
        self._log.info(f"{self._title(handle)}: {text}")
        return CancelResponse.ACCEPT if allowed else CancelResponse.REJECT

    def _execute(self, handle: GoalHandle) -> Any:
        try:
            work = self._begin(handle)
        except Exception as error:  # rclpy would answer with an empty result, which looks like code 0
            if not isinstance(error, self._refusals):
                self._log.error(f"internal error in a goal: {type(error).__name__}: {error}")
            handle.abort()
            result = self._result(self._outcome(error), None)
            self._log_end(handle, result, "refused" if isinstance(error, self._refusals) else "not started")
            return result
        while not work.done.wait(_CHECK_PERIOD):
            if not self._is_served(work) and not work.done.is_set():
                work.end(self._outcome(LookupError("the goal was lost")))
        if work.outcome.success:
            handle.succeed()
        elif work.outcome.canceled and handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        work.answered.set()
        result = self._result(work.outcome, work)
        self._log_end(handle, result)
        return result

    def _log_end(self, handle: GoalHandle, result: Any, failed: str = "failed") -> None:
        """Log how a goal ended, a lost charge as a warning; an error in logging must not cost its client the result."""
        try:
            outcome = messages.to_outcome(self._name, result)
            line = f"{self._title(handle)}: {outcome.ending(failed)}"
            if failed == "failed":
                lasted = "" if outcome.success else f" (after {outcome.elapsed:.1f} s)"
                line = "; ".join(filter(None, (f"{line}{lasted}", outcome.figures())))
            (self._log.warning if outcome.lost_the_charge else self._log.info)(line)
        except Exception as error:
            self._log.error(f"cannot log the end of a goal: {type(error).__name__}: {error}")
