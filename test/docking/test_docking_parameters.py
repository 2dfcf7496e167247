# SPDX-License-Identifier: Apache-2.0
"""Docking's parameters: a charger that differs in one alone from one with the defaults acts differently.

A parameter that changes nothing which a user can see has no place among them. What contradicts others is refused by
name; live ones are set between goals.
"""

import ast
import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import pytest

from deltacharger_core import parameters, servo_types
from deltacharger_core.machine import DOCK_DISTANCE
from deltacharger_docking import codes, observation
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.parameters import DockingNodeParameters, DockingParameters
from deltacharger_docking.ros.docking_node import DockingNode
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_sim.parameters import TargetParameters
from deltacharger_sim.virtual.virtual_charger import GOAL, VirtualCharger

from ..nodes import options
from .dockings import charger, commands, decisions, reach, spoil

TESTS = Path(__file__).resolve().parents[1]
Shows = Callable[[VirtualCharger], Any]


class Case(NamedTuple):
    """Two chargers, of which the second has another value of one parameter.

    Args:
        value: of the parameter, on the second charger.
        shows: what a charger shows.
        then: the code of the second goal, while the first succeeds; or how the second compares with the first.
        place: of the target, in mm, mm and degrees from the goal's.
        also: other parameters of both chargers.
        world: other parameters of their world.
    """

    value: Any
    shows: Shows
    then: codes.Code | Callable[[Any, Any], bool]
    place: tuple[float, float, float] = (3.0, -2.0, 2.0)
    also: Mapping[str, Any] = MappingProxyType({})
    world: Mapping[str, Any] = MappingProxyType({})

    def seen(self, **given: Any) -> Any:
        """Return what a charger with these parameters shows."""
        return self.shows(charger(*self.place, parameters={**self.also, **given}, coarse=True, **self.world))


def code(run: VirtualCharger) -> codes.Code:
    return run.dock().code


def seconds(run: VirtualCharger) -> float:
    assert run.dock().success
    return run.now


def contacts(run: VirtualCharger) -> int:
    assert run.dock().success
    return run.world.record.contacts


def push(run: VirtualCharger) -> float:
    """Return the contact current at rest, A."""
    outcome = run.dock(observation.DockGoal(GOAL, start_charging=False))
    assert outcome.success
    return outcome.contact_current


def told_force(run: VirtualCharger) -> float:
    outcome = run.dock(observation.DockGoal(GOAL, start_charging=False))
    assert outcome.success
    return outcome.contact_force


def tared_at(run: VirtualCharger) -> float:
    """Return where the arm measures its zero, m."""
    sent = commands(run)
    run.begin(observation.DockGoal(GOAL))
    run.until(lambda: bool(decisions(sent, "zero")), 30.0)
    return run.world.snapshot().position[2]


def returns_to(run: VirtualCharger) -> float:
    """Return where the arm rests after undocking, m."""
    assert run.dock().success
    assert run.undock().success
    return run.world.snapshot().position[2]


def shown(state: codes.State, lasts: float, **values: Any) -> Shows:
    """Replace these values in an observation for some seconds from a state on, and return the code that follows."""

    def shows(run: VirtualCharger) -> codes.Code:
        reach(run, state)
        run.run(0.1)
        spoil(run, **values)
        run.run(lasts)
        spoil(run)
        run.run(0.1)
        return run.machine.status.code

    return shows


def yaw_error(run: VirtualCharger) -> float:
    """Return the standard deviation of the faces' yaw, rad."""
    assert run.dock().success
    return run.machine.status.estimate.yaw_stddev


CASES: dict[str, Case | str] = {
    "power": "docking/test_approaches.py::test_it_docks_and_aligns_and_reports_only_known_values",
    "servo_stiffness": Case(160.0, code, codes.Code.SERVO_FAULT),
    "torque_constant": Case(1.2, told_force, operator.lt),
    "gravity": Case((0.0, 20.0, 0.0), code, codes.Code.SERVO_FAULT),
    "home_z": Case(0.03, returns_to, operator.gt),
    "travel_speed": Case(0.02, seconds, operator.gt),
    "search_speed": Case(0.005, seconds, operator.gt),
    "press_speed": Case(0.003, seconds, operator.gt),
    "standoff": Case(0.03, tared_at, operator.lt),
    "search_depth": Case(0.005, code, codes.Code.NO_CONTACT, world={"target": TargetParameters(z=0.095)}),
    "current_min": Case(0.46, push, operator.gt),
    "current_max": Case(0.44, push, operator.lt),
    "critical_angle": Case(math.radians(5.0), code, codes.Code.CRITICAL_ANGLE, (3.0, -2.0, 6.0)),
    "electrode_half_gap": Case(0.001, code, codes.Code.CRITICAL_ANGLE, (3.0, -2.0, 6.0)),
    "electrode_half_length": Case(0.1, code, codes.Code.CRITICAL_ANGLE, (3.0, -2.0, 6.0)),
    "clearance_min": Case(0.005, code, codes.Code.CRITICAL_ANGLE, (3.0, -2.0, 6.0)),
    "landing_limit": Case(0.001, contacts, operator.gt, (11.0, -9.0, 6.0)),
    "overlap_loss_max": Case(0.001, contacts, operator.gt),
    "place_stddev": Case(0.0001, code, codes.Code.LEANING, (11.0, -9.0, 6.0)),
    "yaw_stddev": Case(0.0, contacts, operator.lt),
    "platform_compliance": Case(0.1, yaw_error, operator.gt),
    "magnet_force": Case(300.0, code, codes.Code.STUCK),
    "charge_stable_time": Case(3.0, seconds, operator.gt),
    "battery_voltage_min": Case(
        23.5, shown(codes.State.CHARGING, 6.0, battery_voltage=23.2), codes.Code.VOLTAGE_OUT_OF_RANGE
    ),
    "battery_voltage_start": Case(27.0, code, codes.Code.VOLTAGE_OUT_OF_RANGE),
    "battery_voltage_max": Case(24.0, code, codes.Code.VOLTAGE_OUT_OF_RANGE),
    "hold_max": "docking/test_docked_goals.py::test_a_rest_ends_after_hold_max_with_or_without_a_client",
    "age_max": Case(0.2, shown(codes.State.CONTACT, 0.2, servo_age=0.3), codes.Code.SERVO_STALE),
    "live_servo_age_max": Case(0.1, shown(codes.State.CHARGING, 0.1, servo_age=0.15), codes.Code.SERVO_STALE),
    "goal_timeout": Case(12.0, code, codes.Code.TIMEOUT, also={"press_speed": 0.002}),
    "servo_type": "docking/test_docking_parameters.py::test_the_band_of_every_servo_type_is_the_papers_force",
    "base_frame": "ros/test_frames.py::test_without_tf2_ros_parameters_are_used_and_other_frames_refused_by_name",
    "base_pose": "docking/test_docking_messages.py::test_a_goal_that_leans_keeps_its_lean_in_either_frame",
}
"""For each parameter its case, or the test that shows what it does."""


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if isinstance(case, Case)])
def test_another_value_changes_what_the_charger_does(name: str) -> None:
    case = CASES[name]
    assert isinstance(case, Case)
    usual, changed = case.seen(), case.seen(**{name: case.value})
    if isinstance(case.then, codes.Code):
        assert (usual, changed) == (codes.Code.NONE, case.then)
    else:
        assert case.then(changed, usual), (changed, usual)


def test_every_parameter_has_a_case_or_a_test_that_exists() -> None:
    assert set(CASES) == {
        each.name for table in (DockingParameters, DockingNodeParameters) for each in parameters.declared(table)
    }
    for name in CASES.values():
        if isinstance(name, str):
            file, _, test = name.partition("::")
            tree = ast.parse((TESTS / file).read_text("utf-8"))
            assert test in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, name


GUARDS = {  # of live electrodes, or copied by another part
    *("power", "critical_angle", "clearance_min", "electrode_half_gap", "electrode_half_length"),
    *("battery_voltage_min", "battery_voltage_start", "battery_voltage_max", "age_max", "live_servo_age_max"),
    *("torque_constant", "gravity", "servo_stiffness", "magnet_force"),
}


def test_parameters_that_protect_live_electrodes_or_describe_the_machine_are_fixed() -> None:
    assert not GUARDS & {each.name for each in parameters.declared(DockingParameters) if each.tunable}
    assert {each.name for each in parameters.declared(DockingParameters)} >= GUARDS


def test_tuning_is_refused_while_the_arm_retracts() -> None:
    machine = DockingMachine(DockingParameters())
    machine.start_undock("", observation.Observation(0.0))
    assert machine.tune(DockingParameters(home_z=0.01)).startswith("a goal is running")
    machine.emergency()
    assert machine.tune(DockingParameters(home_z=0.01)) == ""


@pytest.mark.parametrize(
    ("given", "key", "other"),
    [
        ({"current_min": 0.48}, "current_min", r"current_max must be more than 0\.03 A above it"),
        ({"battery_voltage_min": 24.0}, "battery_voltage_min", r"battery_voltage_start, 23\.7"),
    ],
)
def test_two_that_contradict_each_other_are_refused(given: dict[str, float], key: str, other: str) -> None:
    with pytest.raises(parameters.ParameterError, match=other) as refused:
        DockingParameters(**given)
    assert refused.value.key == key


def test_a_home_from_which_the_arm_could_not_pull_off_is_refused() -> None:
    with pytest.raises(codes.Rejected, match="less than 12 mm beyond home_z, 68 mm"):
        charger(parameters={"home_z": 0.0681}, coarse=True).dock()


def parameters_of(context: Any, namespace: str, **given: Any) -> DockingParameters:
    """Return what a docking_node with these ROS parameters decides by."""
    node = DockingNode(held=True, **options(context, namespace, **given))
    try:
        return node._machine.parameters
    finally:
        node.destroy_node()


@pytest.mark.ros
@pytest.mark.parametrize("servo", servo_types.TYPES.values(), ids=lambda servo: servo.name)
def test_the_band_of_every_servo_type_is_the_papers_force(
    context: Any, namespace: str, servo: servo_types.ServoType
) -> None:
    found = parameters_of(context, namespace, servo_type=servo.name)
    torques = [(found.torque_constant * current,) * 3 for current in (found.current_min, found.current_max)]
    forces = [ScalarDelta().force(0.0, 0.0, DOCK_DISTANCE, torque)[2] for torque in torques]
    assert forces == pytest.approx([15.3, 19.2], abs=0.06)  # N, the paper's 0.4 and 0.5 A of an MX-64
    assert (found == DockingParameters()) is (servo is servo_types.MX_64)
    own = parameters_of(context, f"{namespace}_own", servo_type=servo.name, current_max=0.6)
    assert own == replace(found, current_max=0.6)
