# SPDX-License-Identifier: Apache-2.0
"""What every node stands on: declared parameters that refuse by name."""

from __future__ import annotations

from typing import Any

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

from deltacharger_ros import node_support
from deltacharger_ros.node_support import StartupError

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"rate": 900.0}, "'rate'"),
        ({"rate": "fast"}, "'rate'"),
        ({"rat": 5.0}, "did you mean 'rate'"),
    ],
)
def test_a_wrong_parameter_stops_the_node_with_its_name(
    context: Any, namespace: str, given: dict[str, Any], says: str
) -> None:
    class Subject(Node):
        def __init__(self) -> None:
            overrides = [Parameter(name, value=value) for name, value in given.items()]
            super().__init__(
                "subject",
                context=context,
                namespace=namespace,
                parameter_overrides=overrides,
                use_global_arguments=False,
            )
            node_support.declare(self, "rate", 50.0, "how often (Hz)", 1.0, 500.0)
            node_support.reject_unknown(self)

    with pytest.raises(StartupError, match=says):
        Subject()
