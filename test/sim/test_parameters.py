# SPDX-License-Identifier: Apache-2.0
"""Every parameter of the world refuses what it cannot be, by name."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest

from deltacharger_sim.parameters import (
    ContactParameters,
    ParameterError,
    ServoParameters,
    WorldParameters,
    describe,
    from_mapping,
)


def test_nothing_given_is_the_default() -> None:
    assert from_mapping({}, WorldParameters) == WorldParameters()


def test_a_nested_key_reaches_its_group_and_leaves_the_rest() -> None:
    world = from_mapping({"servo": {"stiffness": 5}, "target": {"present": False}}, WorldParameters)
    assert world.servo == ServoParameters(stiffness=5.0)
    assert not world.target.present
    assert world.contact == ContactParameters()


def test_an_unknown_key_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(ParameterError, match=r"simulation\.world\.servo\.stifness.*stiffness") as caught:
        from_mapping({"servo": {"stifness": 3.0}}, WorldParameters, "simulation.world")
    assert caught.value.key == "simulation.world.servo.stifness"
    assert caught.value.value == 3.0


def test_an_unknown_key_without_a_near_name_lists_the_known_ones() -> None:
    with pytest.raises(ParameterError, match="gravity_y"):
        from_mapping({"qqqq": 1.0}, WorldParameters)


@pytest.mark.parametrize("value", [2.4, 20.1, -15.0, 1e300])
def test_a_value_out_of_range_is_refused_with_the_range(value: float) -> None:
    with pytest.raises(ParameterError, match=r"world\.servo\.stiffness.*2\.5 to 20\.0 N·m/rad") as caught:
        from_mapping({"servo": {"stiffness": value}}, WorldParameters, "world")
    assert caught.value.value == value


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "15", True, None, [15.0], {"a": 1}])
def test_what_is_not_a_finite_number_is_refused(value: Any) -> None:
    with pytest.raises(ParameterError, match=r"servo\.stiffness"):
        from_mapping({"servo": {"stiffness": value}}, WorldParameters)


@pytest.mark.parametrize("value", [1, "yes", None])
def test_a_truth_value_must_be_one(value: Any) -> None:
    with pytest.raises(ParameterError, match=r"target\.present"):
        from_mapping({"target": {"present": value}}, WorldParameters)


@pytest.mark.parametrize("value", [None, 3, [], "servo"])
def test_a_group_must_be_a_mapping(value: Any) -> None:
    with pytest.raises(ParameterError, match="servo"):
        from_mapping({"servo": value}, WorldParameters)


def test_bounds_hold_in_python_too() -> None:
    for bad in (math.nan, 0.0, 2e9):
        with pytest.raises(ParameterError, match="stiffness"):
            ContactParameters(stiffness=bad)


def test_every_number_has_bounds_that_contain_its_default_and_a_description() -> None:
    described = {entry[0]: entry for entry in describe(WorldParameters)}
    for key, default, low, high, _, doc in described.values():
        assert low <= default <= high, key
        assert doc, key
    assert set(numbers(WorldParameters())) == set(described)


def test_the_documented_table_is_the_code() -> None:
    page = (Path(__file__).parents[2] / "docs" / "simulation.md").read_text(encoding="utf-8")
    rows = {line for line in page.splitlines() if line.startswith("| ")}
    for key, default, low, high, unit, doc in describe(WorldParameters):
        row = f"| {key} | {default:.4g} | {low:g} to {high:g} | {unit} | {doc} |"
        assert row in rows, "run python benchmarks/world.py --parameters and put its table into docs/simulation.md"


def numbers(instance: Any, path: str = "") -> list[str]:
    found = []
    for item in fields(instance):
        value = getattr(instance, item.name)
        if is_dataclass(value):
            found += numbers(value, f"{path}{item.name}.")
        elif not isinstance(value, bool):
            found.append(f"{path}{item.name}")
    return found


@dataclass(frozen=True)
class Group:
    name: str = ""
    count: int = 1
    ports: tuple[str, ...] = ()
    servo: ServoParameters | None = None
    extra: dict[str, Any] = field(default_factory=dict)


def test_any_dataclass_can_be_read() -> None:
    group = from_mapping(
        {"name": "a", "count": 2, "ports": ["x", "y"], "servo": {"friction": 0}, "extra": {"b": 1}}, Group
    )
    assert group == Group("a", 2, ("x", "y"), ServoParameters(friction=0.0), {"b": 1})
    assert from_mapping({"servo": None}, Group).servo is None


@pytest.mark.parametrize(
    ("content", "key"),
    [
        ({"count": 1.5}, "group.count"),
        ({"count": True}, "group.count"),
        ({"name": 3}, "group.name"),
        ({"ports": "x"}, "group.ports"),
        ({"ports": ["x", 3]}, r"group.ports\[1\]"),
        ({"servo": {"friction": -1}}, "group.servo.friction"),
    ],
)
def test_a_wrong_type_anywhere_names_its_key(content: dict[str, Any], key: str) -> None:
    with pytest.raises(ParameterError, match=key):
        from_mapping(content, Group, "group")
