# SPDX-License-Identifier: Apache-2.0
"""What the mock nodes share: the target's parameters, and a fault that can be switched while they run."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from deltacharger_ros import node_support
from deltacharger_scenes.mocks.arm import MockTarget


def declare_target(node: Node) -> MockTarget:
    """Declare where the mock's target is; mock_servo_node and mock_tactile_node must be told the same.

    Raises:
        StartupError: a value is out of its range.
    """
    default = MockTarget()
    ranges = {
        "x": ("midpoint of the target's electrodes along x (m)", -0.1, 0.1),
        "y": ("midpoint of the target's electrodes along y (m)", -0.1, 0.1),
        "z": ("plane in which contact begins (m)", 0.0, 0.2),
        "angle": ("of the target about +z (rad)", -math.pi / 2, math.pi / 2),
        "stiffness": ("of the contact (N/m)", 1e3, 2e5),
        "friction": ("coefficient of the contact", 0.0, 2.0),
        "grip": ("normal force of the magnets as friction feels it (N)", 0.0, 200.0),
    }
    values = {
        name: node_support.declare(node, f"target_{name}", getattr(default, name), text, low, high)
        for name, (text, low, high) in ranges.items()
    }
    return MockTarget(**values)


class FaultSwitch:
    """The parameters `fault` (may be set while the node runs) and `fault_delay` (s from then until it acts)."""

    def __init__(self, node: Node, faults: Sequence[str]) -> None:
        self._node = node
        self._faults = tuple(faults)
        node_support.declare(node, "fault", "none", "how to misbehave", choices=self._faults, read_only=False)
        self._delay = node_support.declare(
            node, "fault_delay", 0.0, "time from setting the fault (or the start) until it acts (s)", 0.0, 1e6
        )
        self._name = "none"
        self._since = time.monotonic()
        self._reported = False
        self._refresh(node.get_parameter("fault").value)
        node.add_on_set_parameters_callback(self._on_set)

    def active(self) -> str:
        """Return the fault that acts now, "none" where none does."""
        return self._name if time.monotonic() - self._since >= self._delay else "none"

    def first_time(self) -> bool:
        """Return True once for each time that a fault was set and acts."""
        fresh = not self._reported
        self._reported = True
        return fresh

    def _refresh(self, name: str) -> None:
        if name != self._name:
            self._name, self._since, self._reported = name, time.monotonic(), False

    def _on_set(self, parameters: Sequence[Parameter[Any]]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name != "fault":
                continue
            if parameter.value not in self._faults:
                reason = f"fault '{parameter.value}' is not one of {', '.join(self._faults)}"
                return SetParametersResult(successful=False, reason=reason)
            self._refresh(parameter.value)
        return SetParametersResult(successful=True)
