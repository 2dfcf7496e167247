# SPDX-License-Identifier: Apache-2.0
"""How a node says how it fares: /diagnostics, by REP 107."""

from __future__ import annotations

import math
from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from deltacharger_core.quantity import UNKNOWN

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Diagnostics:
    """Publishes a node's diagnostics.

    Args:
        node: publishes.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def status(
        self, level: bytes, message: str, values: Mapping[str, object], part: str, hardware: str = ""
    ) -> DiagnosticStatus:
        """Return how a part of the node fares, named "NAMESPACE/NODE: PART".

        Args:
            level: OK, WARN or ERROR.
            message: one sentence.
            values: further ones, told as text; None and NaN as "unknown".
            part: its name.
            hardware: what it drives; '' = nothing.
        """
        return DiagnosticStatus(
            level=level,
            name=f"{self._node.get_fully_qualified_name().lstrip('/')}: {part}",
            message=message,
            hardware_id=hardware,
            values=[KeyValue(key=key, value=_told(value)) for key, value in values.items()],
        )

    def tell(self, level: bytes, message: str, values: Mapping[str, object], part: str, hardware: str = "") -> None:
        """Publish how one part fares; arguments as of `status`."""
        self.publish(self.status(level, message, values, part, hardware))

    def publish(self, *statuses: DiagnosticStatus) -> None:
        """Publish; does nothing once ROS was shut down."""
        if not self._node.context.ok():
            return
        message = DiagnosticArray(status=list(statuses))
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)


def _told(value: object) -> str:
    unknown = value is None or (isinstance(value, float) and math.isnan(value))
    return UNKNOWN if unknown else str(value)
