# SPDX-License-Identifier: Apache-2.0
"""What the driver of a camera says of itself on /diagnostics, whoever wrote it."""

from __future__ import annotations

import threading

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

_SPOKEN_MAX = 300  # characters of a message that are passed on
_KEPT_MAX = 200  # names: a robot has many nodes, and a broken one could invent more


class DriverDiagnostics:
    """The last words of each node on /diagnostics that are neither OK nor withdrawn.

    Args:
        node: subscribes.
        lock: held while it is told and asked.
    """

    def __init__(self, node: Node, lock: threading.Condition) -> None:
        self._node = node
        self._lock = lock
        self._problems: dict[str, str] = {}
        self._subscription = node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def close(self) -> None:
        """Stop listening."""
        self._node.destroy_subscription(self._subscription)

    def of_publisher(self, topic: str) -> str:
        """Return who publishes a topic and what ails it, as "NODE: PART says MESSAGE", or ''."""
        for end in self._node.get_publishers_info_by_topic(topic):
            name = f"{end.node_namespace.rstrip('/')}/{end.node_name}".lstrip("/")
            for told, message in self._problems.items():
                if told == name or told.startswith(f"{name}:"):
                    return f"{told} says: {message[:_SPOKEN_MAX]}"
        return ""

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        with self._lock:
            for status in message.status:
                name = status.name.lstrip("/")
                self._problems.pop(name, None)
                if status.level != DiagnosticStatus.OK and status.message and len(self._problems) < _KEPT_MAX:
                    self._problems[name] = status.message
