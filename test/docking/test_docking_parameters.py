# SPDX-License-Identifier: Apache-2.0
"""Docking's parameters: each is read and used; live ones are set between goals and apply to the next one."""

from __future__ import annotations

import ast
import dataclasses
from pathlib import Path
from typing import Any

import pytest

from deltacharger_core.machine import DOCK_DISTANCE
from deltacharger_core.parameters import Declaration, declared
from deltacharger_core.servo_types import MX_64, TYPES, ServoType
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import Observation
from deltacharger_docking.parameters import DockingNodeParameters, DockingParameters
from deltacharger_docking.ros.docking_node import DockingNode
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_mission.parameters import MissionParameters
from deltacharger_scenes.overrides import problems
from deltacharger_scenes.scene import parse_scene

from ..nodes import options

LIVE = [each for each in declared(DockingParameters) if each.tunable]
GUARDS = {  # of live electrodes, or copied by another part
    "power", "critical_angle", "clearance_min", "electrode_half_gap", "electrode_half_length", "yaw_max", "pitch_max",
    "battery_voltage_min", "battery_voltage_start", "battery_voltage_max",
    "servo_age_max", "live_servo_age_max", "tactile_age_max", "power_age_max",
    "hard_current", "torque_constant", "gravity", "servo_stiffness", "magnet_force",
}  # fmt: skip


def content(thing: Any, seen: set[int]) -> Any:
    """Return all values that can be reached from an object."""
    if id(thing) in seen or callable(thing):
        return type(thing).__name__
    if isinstance(thing, dict | list | tuple) or hasattr(thing, "__dict__"):
        seen.add(id(thing))
    if isinstance(thing, dict):
        return {str(key): content(value, seen) for key, value in thing.items()}
    if isinstance(thing, list | tuple):
        return [content(value, seen) for value in thing]
    if hasattr(thing, "__dict__"):
        return content(vars(thing), seen)
    return repr(thing)


@pytest.mark.parametrize("each", LIVE, ids=lambda each: each.name)
def test_a_tuned_machine_equals_one_created_with_these_values(each: Declaration) -> None:
    wanted = dataclasses.replace(DockingParameters(), **{each.name: other(each)})
    tuned = DockingMachine(DockingParameters())
    assert tuned.tune(wanted) == ""
    assert content(tuned, set()) == content(DockingMachine(wanted), set())
    assert content(tuned, set()) != content(DockingMachine(DockingParameters()), set())


def test_parameters_that_protect_live_electrodes_or_describe_the_machine_are_fixed() -> None:
    assert len(LIVE) > 10
    assert not GUARDS & {each.name for each in LIVE}
    assert {each.name for each in declared(DockingParameters)} >= GUARDS


def test_tuning_is_refused_while_the_arm_retracts() -> None:
    machine = DockingMachine(DockingParameters())
    machine.start_undock("", Observation(0.0))
    assert machine.tune(DockingParameters(home_z=0.01)).startswith("a goal is running")
    machine.emergency()
    assert machine.tune(DockingParameters(home_z=0.01)) == ""


ROOT = Path(__file__).resolve().parents[2]
TABLES = (DockingParameters, DockingNodeParameters, MissionParameters)


def other(each: Declaration) -> Any:
    """Return an allowed value near the default, so that no two parameters contradict each other."""
    if isinstance(each.default, tuple):
        return [*each.default[:-1], 0.51]
    if each.kind is bool:
        return not each.default
    if each.kind is str:
        return next((word for word in each.choices if word != each.default), "elsewhere")
    if each.kind is int:
        return each.default + (1 if each.default < each.high else -1)
    return each.default + 1e-3 * min(each.high - each.default, each.default - each.low or each.high)


def values(node: str) -> dict[str, Any]:
    tables = TABLES[:2] if node == "docking_node" else TABLES[2:]
    return {each.name: other(each) for table in tables for each in declared(table)}


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.__name__)
def test_every_declared_parameter_is_read(table: type[Any]) -> None:
    """Read as an attribute somewhere in the package that declares it."""
    read = {
        node.attr
        for path in (ROOT / table.__module__.partition(".")[0]).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load)
    }
    assert not {each.name for each in declared(table)} - read


@pytest.mark.parametrize("node", ["docking_node", "mission_node"])
def test_a_scene_may_set_each_parameter_and_wrong_values_are_refused(node: str) -> None:
    given = values(node)
    assert not list(problems(parse_scene({"nodes": [node], "parameters": {node: given}}, "mine")))
    for name in [name for name, value in given.items() if type(value) in (int, float)][::3]:
        ((key, _),) = problems(parse_scene({"nodes": [node], "parameters": {node: {name: "much"}}}, "mine"))
        assert key == f"parameters.{node}.{name}"


@pytest.mark.ros
def test_the_node_uses_the_values_of_the_scene(context: Any, namespace: str) -> None:
    given = parse_scene({"nodes": ["docking_node"], "parameters": {"docking_node": values("docking_node")}}, "mine")
    decides_by = parameters_of(context, namespace, **given.node_parameters("docking_node", {}))
    wanted = {each.name: other(each) for each in declared(DockingParameters)}
    assert decides_by == DockingParameters(**{**wanted, "gravity": tuple(wanted["gravity"])})


def parameters_of(context: Any, namespace: str, **given: Any) -> DockingParameters:
    """Return what a docking_node with these ROS parameters decides by."""
    node = DockingNode(held=True, **options(context, namespace, **given))
    try:
        return node._machine.parameters
    finally:
        node.destroy_node()


@pytest.mark.ros
@pytest.mark.parametrize("servo", TYPES.values(), ids=lambda servo: servo.name)
def test_the_band_of_every_servo_type_is_the_papers_force(context: Any, namespace: str, servo: ServoType) -> None:
    found = parameters_of(context, namespace, servo_type=servo.name)
    torques = [(found.torque_constant * current,) * 3 for current in (found.current_min, found.current_max)]
    forces = [ScalarDelta().force(0.0, 0.0, DOCK_DISTANCE, torque)[2] for torque in torques]
    assert forces == pytest.approx([15.3, 19.2], abs=0.06)  # N, the paper's 0.4 and 0.5 A of an MX-64
    assert (found == DockingParameters()) is (servo is MX_64)
    own = parameters_of(context, f"{namespace}_own", servo_type=servo.name, current_max=0.6)
    assert own == dataclasses.replace(found, current_max=0.6)
