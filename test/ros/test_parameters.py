# SPDX-License-Identifier: Apache-2.0
"""A node has exactly the parameters that its package declares, with their bounds and texts."""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from pathlib import Path
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
    mode: str = choice("soft", ("soft", "stiff"), "how it yields", tunable=True)
    files: tuple[str, ...] = words(("",), "to read")
    on: bool = flag(True, "whether it is")


def test_the_node_describes_its_declared_parameters(context: Any, namespace: str) -> None:
    node = Node("subject", **options(context, namespace, corner=[1.0, 2.0], files=["a", "b"]))
    try:
        given = declare_all(node, Rates, defaults=Rates(rate=60.0))
        assert given == Rates(rate=60.0, corner=(1.0, 2.0), files=("a", "b"))
        described = {name: node.describe_parameter(name) for name in Rates.__dataclass_fields__}
    finally:
        node.destroy_node()
    assert described["rate"].description == "how often (Hz)"
    assert described["rate"].floating_point_range[0].to_value == 500.0
    assert described["count"].integer_range[0].from_value == 1
    assert described["corner"].additional_constraints == "-2.0 to 2.0"
    assert described["mode"].additional_constraints == "one of: soft, stiff"
    assert not described["files"].additional_constraints
    assert [each.read_only for each in described.values()] == [True, True, True, False, True, True]


@pytest.mark.version
@pytest.mark.parametrize("source", ["-p", "--params-file"])
def test_integers_are_accepted_for_floats_from_command_line_and_files(
    context: Any, namespace: str, tmp_path: Path, source: str
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text("/**:\n  ros__parameters: {rate: 60, corner: [0, 1]}\n")
    words = ["-p", "rate:=60", "-p", "corner:=[0, 1]"] if source == "-p" else [source, str(file)]
    node = Node("subject", cli_args=["--ros-args", *words], **options(context, namespace))
    try:
        assert declare_all(node, Rates) == Rates(rate=60.0, corner=(0.0, 1.0))
        reject_unknown(node)
    finally:
        node.destroy_node()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rate": 900.0}, "'rate'"),
        ({"rate": "fast"}, "'rate'"),
        ({"corner": ["1", "2"]}, "'corner'"),
        ({"corner": [1, 9]}, "'corner'"),
        ({"count": 2.0}, "'count'"),
        ({"on": 1}, "'on'"),
        ({"rat": 5.0}, "did you mean 'rate'"),
    ],
)
def test_a_wrong_parameter_stops_the_node_with_its_name(
    context: Any, namespace: str, given: dict[str, Any], message: str
) -> None:
    class Subject(Node):
        def __init__(self) -> None:
            super().__init__("subject", **options(context, namespace, **given))
            declare_all(self, Rates)
            reject_unknown(self)

    with pytest.raises(StartupError, match=message):
        Subject()


def test_a_node_that_fails_after_its_parameters_is_freed_at_once(context: Any, namespace: str) -> None:
    """Otherwise the incomplete node would be closed with the context."""
    node = Node("subject", **options(context, namespace))
    declare_all(node, Rates)
    reject_unknown(node)
    left = weakref.ref(node)
    del node
    assert left() is None
