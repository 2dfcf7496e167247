# SPDX-License-Identifier: Apache-2.0
"""A node's parameters are those that its package declares, with their bounds and texts, and no others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest
from rclpy.node import Node

from deltacharger_core.parameters import Bounded, choice, flag, number, numbers, words
from deltacharger_ros.node_support import StartupError
from deltacharger_ros.parameters import declare_all, reject_unknown

from ..nodes import options

pytestmark = pytest.mark.ros


@dataclass(frozen=True)
class Rates(Bounded):
    rate: float = number(50.0, 1.0, 500.0, "Hz", "how often")
    count: int = number(3, 1, 9, "", "how many")
    corner: tuple[float, ...] = numbers((0.0, 1.0), -2.0, 2.0, "m", "of the box")
    mode: str = choice("soft", ("soft", "stiff"), "how it yields", live=True)
    files: tuple[str, ...] = words(("",), "to read")
    on: bool = flag(True, "whether it is")


def test_what_is_declared_is_what_the_node_tells(context: Any, namespace: str) -> None:
    node = Node("subject", **options(context, namespace, corner=[1.0, 2.0], files=["a", "b"]))
    try:
        given = declare_all(node, Rates, defaults=Rates(rate=60.0))
        assert given == Rates(rate=60.0, corner=(1.0, 2.0), files=("a", "b"))
        told = {name: node.describe_parameter(name) for name in Rates.__dataclass_fields__}
    finally:
        node.destroy_node()
    assert told["rate"].description == "how often (Hz)"
    assert told["rate"].floating_point_range[0].to_value == 500.0
    assert told["count"].integer_range[0].from_value == 1
    assert told["corner"].additional_constraints == "-2.0 to 2.0"
    assert told["mode"].additional_constraints == "one of: soft, stiff"
    assert not told["files"].additional_constraints
    assert [each.read_only for each in told.values()] == [True, True, True, False, True, True]


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
            super().__init__("subject", **options(context, namespace, **given))
            declare_all(self, Rates)
            reject_unknown(self)

    with pytest.raises(StartupError, match=says):
        Subject()
