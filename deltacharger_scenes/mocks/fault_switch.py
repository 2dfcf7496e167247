# SPDX-License-Identifier: Apache-2.0
"""A mock's fault, which can be changed while the node runs."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter


class FaultSwitch:
    """The fault of a node with the declared parameter `fault`, which may be changed at runtime.

    Args:
        node: with the fault.
        faults: possible values.
        delay: s from setting it until it acts.
    """

    def __init__(self, node: Node, faults: Sequence[str], delay: float) -> None:
        self._faults = tuple(faults)
        self._delay = delay
        self._name = "none"
        self._since = time.monotonic()
        self._reported = False
        self._refresh(node.get_parameter("fault").value)
        node.add_on_set_parameters_callback(self._on_set)

    def active(self) -> str:
        """Return the active fault; "none" if there is none."""
        return self._name if time.monotonic() - self._since >= self._delay else "none"

    def first_time(self) -> bool:
        """Return True at the first call since the fault was set; call it while the fault acts."""
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
                reason = f"fault '{parameter.value}' is unknown: give one of {', '.join(self._faults)}"
                return SetParametersResult(successful=False, reason=reason)
            self._refresh(parameter.value)
        return SetParametersResult(successful=True)
