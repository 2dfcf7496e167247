# SPDX-License-Identifier: Apache-2.0
"""A mock's fault, which can be changed while the node runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter


def fault_switch(node: Node, faults: Sequence[str]) -> Callable[[], str]:
    """Return what returns the present value of a node's declared parameter `fault`; unknown values are refused."""

    def check(parameters: Sequence[Parameter[Any]]) -> SetParametersResult:
        wrong = [each.value for each in parameters if each.name == "fault" and each.value not in faults]
        reason = f"fault '{wrong[0]}' is unknown: give one of {', '.join(faults)}" if wrong else ""
        return SetParametersResult(successful=not wrong, reason=reason)

    node.add_on_set_parameters_callback(check)
    return lambda: str(node.get_parameter("fault").value)
