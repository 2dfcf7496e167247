# SPDX-License-Identifier: Apache-2.0
"""The client's side of an action: a goal and its end, whether the server answers, and calls that never wait."""

from __future__ import annotations

import math
import threading
import time
import uuid
from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalInfo, GoalStatus
from rclpy.action.client import ActionClient, ClientGoalHandle
from rclpy.node import Node

from deltacharger_core.ros.qos import ACTION

REFUSED, LOST = -1, -2
"""Ends of a goal besides GoalStatus: goal not accepted; action server gone, restarted, or without its result."""

ONE_USER = (
    "run both as one user, since root and others do not hear each other, and containers with --ipc=host and --user "
    "(docs/security.md); else docking_node hangs: read its log"
)
"""What to do if a charger is discovered, but does not answer."""

_ASK_AFTER = 1.0  # s without a result before it is requested again; doubled each time, as a goal may last for hours
_ASK_EVERY = 60.0  # s, the longest such pause, as an answer may be lost while the network fails
_QUESTION_EVERY = 1.0  # s, of `Echo`

OnEnd = Callable[[int, int, Any, Any], None]
"""Called with a goal's number, its end, its result message (None = none) and its latest feedback."""


def _new_handle(client: ActionClient[Any, Any, Any]) -> Any:
    """Return the handle of a goal with a new id, which the server does not know."""
    name = GoalInfo().goal_id
    name.uuid = list(uuid.uuid4().bytes)
    unknown: Any = None  # the server's response
    return ClientGoalHandle(client, name, unknown)


class SentGoal:
    """Sends one goal and follows it to its end.

    A server's answer is lost if it leaves before the server has discovered the reader of its client: Fast DDS waits
    only 0.1 s. After a node's start that may take longer, because discovery messages overflow its socket. The goal's
    id is therefore enough: feedback shows that the goal was accepted, and its result is requested by the id.

    Args:
        node: node of the client, served by a `Spinner`.
        client: of the action.
        goal: goal message.
        on_feedback: called with each feedback message, from the serving thread.

    Attributes:
        accepted: whether the server is known to have the goal.
        finished: set at the end.
        end: how it ended: a GoalStatus, REFUSED or LOST.
        result: result message; None = none.
        error: why the exchange failed; None = it did not.
    """

    def __init__(
        self, node: Node, client: ActionClient[Any, Any, Any], goal: Any, on_feedback: Callable[[Any], None]
    ) -> None:
        self.accepted = False
        self.finished = threading.Event()
        self.end: int = GoalStatus.STATUS_UNKNOWN
        self.result: Any = None
        self.error: BaseException | None = None
        self._on_feedback = on_feedback
        self._cancel_wanted = False
        self._pause = _ASK_AFTER
        self._ask_at = time.monotonic() + _ASK_AFTER
        self._handle = _new_handle(client)
        executor: Any = node.executor
        self._call_soon = executor.call_soon
        sent = self._call_soon(client.send_goal_async, goal, self._on_message, self._handle.goal_id)
        sent.add_done_callback(self._on_sent)

    @property
    def is_canceled(self) -> bool:
        """Whether the server has received a cancel request."""
        return self._cancel_wanted and self.accepted

    def cancel(self) -> None:
        """Cancel the goal, also one whose acceptance is not known yet. Safe to call again."""
        if not self._cancel_wanted:
            self._cancel_wanted = True
            self._handle.cancel_goal_async()

    def check(self) -> None:
        """Request the result again when that is due; call it regularly."""
        if time.monotonic() >= self._ask_at:
            self._ask_at = time.monotonic() + self._pause
            self._pause = min(2.0 * self._pause, _ASK_EVERY)
            self._call_soon(self._ask)

    def _ask(self) -> None:
        self._handle.get_result_async().add_done_callback(self._on_result)

    def _on_sent(self, future: Any) -> None:
        answer = self._value(future)
        if answer is not None:
            answer.add_done_callback(self._on_response)

    def _on_response(self, future: Any) -> None:
        handle = self._value(future)
        if handle is None:
            return
        if handle.accepted:
            self._accept()
        else:
            self._finish(REFUSED)

    def _on_message(self, message: Any) -> None:
        self._accept()
        self._on_feedback(message)

    def _accept(self) -> None:
        if not self.accepted:
            self.accepted = True
            if self._cancel_wanted:  # the first request may have come before the goal
                self._handle.cancel_goal_async()
            self._ask()

    def _on_result(self, future: Any) -> None:
        reply = self._value(future)
        if reply is None:
            return
        if reply.status != GoalStatus.STATUS_UNKNOWN:
            self._finish(reply.status, reply.result)
        elif self.accepted:
            self._finish(LOST)

    def _finish(self, end: int, result: Any = None) -> None:
        if not self.finished.is_set():
            self.end, self.result = end, result
            self.finished.set()

    def _value(self, future: Any) -> Any:
        """Return a future's result; None after its error, which ends the goal."""
        error = future.exception()
        if error is None:
            return future.result()
        self.error = error
        self._finish(LOST if self.accepted else REFUSED)
        return None


class Echo:
    """Cancels a goal of an action's server that nobody has, until it answers that it does not know it.

    Fast DDS discovers over UDP but delivers over shared memory, which two users or two containers may not share: a goal
    would be accepted and its answers lost. Every action server answers this at once, and it changes nothing.

    Args:
        node: node of the client, served by a `Spinner`.
        client: of the action.
    """

    def __init__(self, node: Node, client: ActionClient[Any, Any, Any]) -> None:
        self._node, self._client = node, client
        self._heard = False
        self._since = math.nan  # when the server was discovered; NaN = it is not
        self._ask_at = -math.inf
        self._question: Any = None

    @property
    def silence(self) -> float:
        """How long (s) the server has been there without an answer; 0 if it has answered, or is not there."""
        return 0.0 if self._heard or math.isnan(self._since) else time.monotonic() - self._since

    def answers(self) -> bool:
        """Return whether the server is there and has answered. Call it regularly: it asks."""
        now = time.monotonic()
        executor: Any = self._node.executor
        if not self._client.server_is_ready():
            self._heard, self._since = False, math.nan
        elif math.isnan(self._since):
            self._since = self._ask_at = now
        if not (self._heard or math.isnan(self._since)) and now >= self._ask_at and executor is not None:
            self._ask_at = now + _QUESTION_EVERY
            executor.call_soon(self._ask)
        return self._heard

    def _ask(self) -> None:
        if self._question is not None:
            self._question.cancel()  # rclpy would keep it
        self._question = _new_handle(self._client).cancel_goal_async()
        self._question.add_done_callback(self._on_answer)

    def _on_answer(self, question: Any) -> None:
        if not question.cancelled() and question.exception() is None:
            self._heard = True


class _Call:
    """One pending goal."""

    def __init__(self, number: int, goal: Any) -> None:
        self.number = number
        self.goal = goal
        self.sent: SentGoal | None = None
        self.unwanted = False
        self.feedback: Any = None  # the latest
        self.silent_since = math.inf

    def on_feedback(self, message: Any) -> None:
        """Keep the feedback."""
        self.feedback = message.feedback


class ActionCaller:
    """Sends goals to an action and reports their ends. Goals wait for a server that is not there yet.

    Args:
        node: owner.
        kind: action type.
        name: action name.
        on_end: called at the end of each goal.
        lost_timeout: s without a server in the graph, or without its answer to a goal, before the goal counts as lost.
    """

    def __init__(
        self,
        node: Node,
        kind: Any,
        name: str,
        on_end: OnEnd,
        lost_timeout: float,
    ) -> None:
        self._node = node
        self._client: ActionClient[Any, Any, Any] = ActionClient(node, kind, name, **ACTION)
        self._echo = Echo(node, self._client)
        self._on_end = on_end
        self._lost_timeout = lost_timeout
        self._calls: dict[int, _Call] = {}

    @property
    def is_served(self) -> bool:
        """Whether the action has a server now that has answered."""
        return self._echo.answers()

    @property
    def is_idle(self) -> bool:
        """Whether every goal has ended."""
        return not self._calls

    @property
    def is_settled(self) -> bool:
        """Whether every goal has ended or its cancel was sent."""
        return all(call.sent is not None and call.sent.is_canceled for call in self._calls.values())

    def send(self, number: int, goal: Any) -> None:
        """Queue a goal; `tick` sends it."""
        self._calls[number] = _Call(number, goal)

    def cancel(self, number: int) -> None:
        """Cancel a goal."""
        call = self._calls.get(number)
        if call is not None:
            call.unwanted = True
            if call.sent is not None:
                call.sent.cancel()

    def tick(self) -> None:
        """Send queued goals, report those that have ended, and detect lost servers."""
        now, served = time.monotonic(), self.is_served
        for call in list(self._calls.values()):
            goal = call.sent
            if goal is None:
                if call.unwanted:
                    self._end(call, GoalStatus.STATUS_CANCELED)
                elif served:
                    call.sent = SentGoal(self._node, self._client, call.goal, call.on_feedback)
                continue
            if goal.finished.is_set():
                self._end(call, goal.end, goal.result)
                continue
            goal.check()
            call.silent_since = math.inf if served and goal.accepted else min(call.silent_since, now)
            if now - call.silent_since > self._lost_timeout:
                goal.cancel()  # nothing watches it when its server is back
                self._end(call, LOST)

    def destroy(self) -> None:
        """Release the ROS side."""
        self._client.destroy()

    def _end(self, call: _Call, end: int, result: Any = None) -> None:
        del self._calls[call.number]
        self._on_end(call.number, end, result, call.feedback)


def result_of(future: Any) -> Any:
    """Return a future's result; None if it failed, for example because the node was shut down."""
    return None if future.exception() is not None else future.result()
