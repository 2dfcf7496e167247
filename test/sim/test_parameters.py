# SPDX-License-Identifier: Apache-2.0
"""Every parameter of the world refuses what it cannot be, by name."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest

from deltacharger_core.parameters import ParameterError, declared, from_mapping
from deltacharger_sim.parameters import ContactParameters, ServoParameters, WorldParameters


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
    with pytest.raises(ParameterError, match=r"world\.servo\.stiffness.*2\.5 to 20 N·m/rad") as caught:
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


def test_every_parameter_has_bounds_that_contain_its_default_and_a_description() -> None:
    known = {each.name: each for each in declared(WorldParameters)}
    for each in known.values():
        assert not each.problem(each.default), each.name
        assert each.text, each.name
        assert each.kind is bool or math.isfinite(each.low + each.high), each.name
    assert set(numbers(WorldParameters())) == set(known)


def test_the_documented_table_is_the_code() -> None:
    page = (Path(__file__).parents[2] / "docs" / "simulation.md").read_text(encoding="utf-8")
    rows = {line for line in page.splitlines() if line.startswith("| ")}
    for each in declared(WorldParameters):
        row = f"| {each.name} | {each.default:.4g} | {each.low:g} to {each.high:g} | {each.unit} | {each.text} |"
        told = each.kind is bool or row in rows
        assert told, "run python benchmarks/world.py --parameters and put its table into docs/simulation.md"


def numbers(instance: Any, path: str = "") -> list[str]:
    found = []
    for item in fields(instance):
        value = getattr(instance, item.name)
        if is_dataclass(value):
            found += numbers(value, f"{path}{item.name}.")
        else:
            found.append(f"{path}{item.name}")
    return found
