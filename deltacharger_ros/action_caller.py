# SPDX-License-Identifier: Apache-2.0
"""Non-blocking client for other nodes' actions."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action.client import ActionClient
from rclpy.node import Node

from deltacharger_ros.qos import ACTION
from deltacharger_ros.sent_goal import LOST, Echo, SentGoal

OnEnd = Callable[[int, int, Any, Any], None]
"""Called with a goal's number, its end, its result message (None = none) and its latest feedback."""


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
