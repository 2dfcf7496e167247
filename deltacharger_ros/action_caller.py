# SPDX-License-Identifier: Apache-2.0
"""Non-blocking client for other nodes' actions."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action.client import ActionClient
from rclpy.node import Node

from deltacharger_ros.qos import ACTION

REFUSED, LOST = -1, -2
"""Ends of a goal in addition to GoalStatus: goal not accepted; action server lost."""

OnEnd = Callable[[int, int, Any, Any], None]
"""Called with a goal's number, its end, its result message (None = none) and its latest feedback."""


class _Call:
    """One pending goal. Callbacks fill it; the node's loop checks it."""

    def __init__(self, number: int, goal: Any) -> None:
        self.number = number
        self.goal = goal
        self.sent = self.unwanted = self.cancel_sent = False
        self.handle: Any = None
        self.feedback: Any = None  # the latest
        self.lost_since = math.inf


class ActionCaller:
    """Sends goals to an action and reports their ends. Goals wait for a server that is not there yet.

    Args:
        node: owner.
        kind: action type.
        name: action name.
        on_end: called at the end of each goal.
        lost_timeout: s without a server in the graph before its goals count as lost.
    """

    def __init__(
        self,
        node: Node,
        kind: Any,
        name: str,
        on_end: OnEnd,
        lost_timeout: float,
    ) -> None:
        self._node: Any = node
        self._client: ActionClient[Any, Any, Any] = ActionClient(node, kind, name, **ACTION)
        self._on_end = on_end
        self._lost_timeout = lost_timeout
        self._lock = threading.RLock()
        self._calls: dict[int, _Call] = {}

    @property
    def is_served(self) -> bool:
        """Whether the action has a server now."""
        return bool(self._client.server_is_ready())

    @property
    def is_settled(self) -> bool:
        """Whether every goal has ended or its cancel was sent."""
        with self._lock:
            return all(call.cancel_sent for call in self._calls.values())

    def send(self, number: int, goal: Any) -> None:
        """Queue a goal; `tick` sends it."""
        with self._lock:
            self._calls[number] = _Call(number, goal)

    def cancel(self, number: int) -> None:
        """Cancel a goal, now or as soon as its server has accepted it."""
        with self._lock:
            call = self._calls.get(number)
            if call is not None:
                call.unwanted = True
                self._cancel(call)

    def tick(self) -> None:
        """Send queued goals and detect lost servers."""
        now, served = time.monotonic(), self.is_served
        with self._lock:
            for call in list(self._calls.values()):
                if not call.sent:
                    if call.unwanted:
                        self._end(call, GoalStatus.STATUS_CANCELED)
                    elif served:
                        self._send(call)
                    continue
                call.lost_since = math.inf if served else min(call.lost_since, now)
                if now - call.lost_since > self._lost_timeout:
                    self._end(call, LOST)

    def destroy(self) -> None:
        """Release the ROS side."""
        self._client.destroy()

    def _send(self, call: _Call) -> None:
        call.sent = True

        def on_feedback(message: Any) -> None:
            call.feedback = message.feedback

        sent = self._node.executor.call_soon(self._client.send_goal_async, call.goal, on_feedback)
        sent.add_done_callback(lambda done: self._on_sent(call, done))

    def _on_sent(self, call: _Call, future: Any) -> None:
        answer = result_of(future)
        if answer is not None:
            answer.add_done_callback(lambda done: self._on_response(call, done))
            return
        with self._lock:
            self._end(call, REFUSED)

    def _on_response(self, call: _Call, future: Any) -> None:
        handle = result_of(future)
        with self._lock:
            if handle is None or not handle.accepted:
                self._end(call, REFUSED)
                return
            call.handle = handle
            handle.get_result_async().add_done_callback(lambda done: self._on_result(call, done))
            if call.unwanted:  # also one that was given up long ago: nothing else watches it
                self._cancel(call)

    def _on_result(self, call: _Call, future: Any) -> None:
        answer = result_of(future)
        with self._lock:
            if answer is None:
                self._end(call, LOST)
            else:
                self._end(call, answer.status, answer.result)

    def _cancel(self, call: _Call) -> None:
        if call.handle is not None and not call.cancel_sent:
            call.cancel_sent = True
            call.handle.cancel_goal_async()

    def _end(self, call: _Call, end: int, result: Any = None) -> None:
        if self._calls.pop(call.number, None) is not None:
            self._on_end(call.number, end, result, call.feedback)


def result_of(future: Any) -> Any:
    """Return a future's result; None if it failed, for example because the node was shut down."""
    return None if future.exception() is not None else future.result()
