# SPDX-License-Identifier: Apache-2.0
"""Reads a camera driver's reports on /diagnostics, for any driver."""

from __future__ import annotations

import threading

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

_QUOTED_MAX = 300  # characters of a quoted message
_KEPT_MAX = 200  # names: a robot has many nodes, and a broken one could invent more


class DriverDiagnostics:
    """The latest report of each node on /diagnostics, unless OK.

    Args:
        node: that subscribes.
        lock: held by callbacks; hold it while calling `of_publisher`.
    """

    def __init__(self, node: Node, lock: threading.Condition) -> None:
        self._node = node
        self._lock = lock
        self._problems: dict[str, str] = {}
        self._subscription = node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def close(self) -> None:
        """Unsubscribe."""
        self._node.destroy_subscription(self._subscription)

    def of_publisher(self, topic: str) -> str:
        """Return the publisher of a topic and its problem, as "NODE: PART reports: MESSAGE", or ''."""
        for end in self._node.get_publishers_info_by_topic(topic):
            name = f"{end.node_namespace.rstrip('/')}/{end.node_name}".lstrip("/")
            for reporter, message in self._problems.items():
                if reporter == name or reporter.startswith(f"{name}:"):
                    return f"{reporter} reports: {message[:_QUOTED_MAX]}"
        return ""

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        with self._lock:
            for status in message.status:
                name = status.name.lstrip("/")
                self._problems.pop(name, None)
                if status.level != DiagnosticStatus.OK and status.message and len(self._problems) < _KEPT_MAX:
                    self._problems[name] = status.message
