# SPDX-License-Identifier: Apache-2.0
"""Publishes a node's state on /diagnostics (REP 107)."""

from __future__ import annotations

import math
from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from deltacharger_core.texts import UNKNOWN

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Diagnostics:
    """Publishes a node's diagnostics.

    Args:
        node: publisher.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def status(
        self, level: bytes, message: str, values: Mapping[str, object], part: str, hardware: str = ""
    ) -> DiagnosticStatus:
        """Return the status of a part of the node, named "NAMESPACE/NODE: PART".

        Args:
            level: OK, WARN or ERROR.
            message: one sentence.
            values: further values, published as text; None and NaN as "unknown".
            part: name of the part.
            hardware: the hardware that it drives; '' = none.
        """
        return DiagnosticStatus(
            level=level,
            name=f"{self._node.get_fully_qualified_name().lstrip('/')}: {part}",
            message=message,
            hardware_id=hardware,
            values=[KeyValue(key=key, value=_as_text(value)) for key, value in values.items()],
        )

    def report(self, level: bytes, message: str, values: Mapping[str, object], part: str, hardware: str = "") -> None:
        """Publish the status of one part; arguments as in `status`."""
        self.publish(self.status(level, message, values, part, hardware))

    def publish(self, *statuses: DiagnosticStatus) -> None:
        """Publish; does nothing after ROS was shut down."""
        if not self._node.context.ok():
            return
        message = DiagnosticArray(status=list(statuses))
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)


def _as_text(value: object) -> str:
    unknown = value is None or (isinstance(value, float) and math.isnan(value))
    return UNKNOWN if unknown else str(value)
