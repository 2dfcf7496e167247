# SPDX-License-Identifier: Apache-2.0
"""The world's parameters: bounds, contradictions, and worlds outside the verified range."""

from __future__ import annotations

import itertools
import math
import warnings
from dataclasses import fields, is_dataclass, replace
from typing import Any

import pytest

from deltacharger_core.parameters import ParameterError, declared, from_mapping
from deltacharger_sim import stability_map
from deltacharger_sim.parameters import (
    ContactParameters,
    MagnetParameters,
    ServoParameters,
    UnprovenWarning,
    WorldParameters,
    doubts,
    nearest,
)
from deltacharger_sim.world import World


def names(instance: Any, path: str = "") -> set[str]:
    """Return the dotted names of all numbers."""
    found = set()
    for item in fields(instance):
        value = getattr(instance, item.name)
        found |= names(value, f"{path}{item.name}.") if is_dataclass(value) else {f"{path}{item.name}"}
    return found


def test_every_parameter_has_bounds_that_contain_its_default_and_a_description() -> None:
    known = {each.name: each for each in declared(WorldParameters)}
    for each in known.values():
        assert not each.problem(each.default), each.name
        assert each.text, each.name
        assert each.kind is bool or math.isfinite(each.low + each.high), each.name
    assert names(WorldParameters()) == set(known)


@pytest.mark.parametrize(
    ("content", "key", "problem"),
    [
        ({"contact": {"stiffness": 9e3, "hard_stop": 0.0021}}, "contact.hard_stop", "0.002"),
        ({"contact": {"stiffness": 5e4, "hard_stop_stiffness": 1e4}}, "contact.hard_stop_stiffness", "100000"),
        (
            {"contact": {"stiffness": 6e4, "hard_stop_stiffness": 1e5, "hard_stop": 0.001}},
            "contact.hard_stop_stiffness",
            "softer",
        ),
        ({"servo": {"friction": 1.0, "stall_torque": 0.9}}, "servo.friction", "stall_torque"),
        ({"servo": {"friction": 1.0, "stall_torque": 1.0}}, "servo.friction", "no servo"),
        ({"servo": {"supply_resistance": 1.0}}, "servo.supply_resistance", "supply_voltage"),
        ({"servo": {"supply_resistance": 0.5, "stall_torque": 12.0}}, "servo.supply_resistance", "smaller"),
    ],
)
def test_contradictory_parameters_are_refused_by_key(content: dict[str, Any], key: str, problem: str) -> None:
    with pytest.raises(ParameterError, match=problem) as caught:
        from_mapping(content, WorldParameters, "simulation.world")
    assert caught.value.key == f"simulation.world.{key}"


@pytest.mark.parametrize(
    "content",
    [
        {"contact": {"stiffness": 9e3, "hard_stop": 0.002}},
        {"contact": {"stiffness": 1e4, "hard_stop": 0.02}},
        {"contact": {"stiffness": 1e9}},  # its springs never reach any stop
        {"contact": {"stiffness": 1e3, "hard_stop_stiffness": 1e4}},
        {"port": {"voltage": -24.0}},
        {"servo": {"unpowered_friction": 0.0}},
        {"magnets": {"force": 300.0, "range": 0.0002}},
    ],
)
def test_unusual_but_possible_parameters_are_accepted(content: dict[str, Any]) -> None:
    from_mapping(content, WorldParameters)


def test_the_default_world_is_verified() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        World(WorldParameters())


def test_every_stiffness_is_verified_up_to_ten_milliseconds() -> None:
    every = itertools.product((0.0001, 0.0003, 0.001, 0.003, 0.01), (1e3, 3e4, 1e5, 2e8, 1e9), (2.5, 4.0, 15.0, 20.0))
    for step, stiffness, servo in every:
        contact = ContactParameters(stiffness=stiffness)
        assert doubts(WorldParameters(step=step, contact=contact, servo=ServoParameters(stiffness=servo))) == ()


def test_an_unverified_world_warns_with_the_nearest_verified_point() -> None:
    bold = WorldParameters(step=0.1, magnets=MagnetParameters(force=0.0))
    with pytest.warns(UnprovenWarning, match=r"nearest verified point") as caught:
        World(bold)
    assert len(caught) == 1
    servo, contact, step = nearest(15.0, 1e5, 0.1)
    near = replace(
        bold,
        step=step,
        servo=replace(bold.servo, stiffness=servo),
        contact=replace(bold.contact, stiffness=contact),
    )
    assert doubts(near) == ()


def test_the_map_is_complete_and_has_no_divergence() -> None:
    assert len(stability_map.CELLS) == len(stability_map.SERVO_STIFFNESSES)
    for rows in stability_map.CELLS:
        assert len(rows) == len(stability_map.CONTACT_STIFFNESSES)
        for row in rows:
            assert len(row) == len(stability_map.STEPS)
            assert set(row) <= {"+", "p", "s"}
