# SPDX-License-Identifier: Apache-2.0
"""What each parameter of docking does: a charger that differs in it alone from one with the defaults acts differently.

A parameter that changes nothing which a user can see has no place among them.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import pytest

from deltacharger_core.parameters import declared
from deltacharger_docking.codes import Code, State
from deltacharger_docking.observation import DockGoal, ElectrodePose, Service
from deltacharger_docking.parameters import DockingNodeParameters, DockingParameters
from deltacharger_sim.parameters import TargetParameters
from deltacharger_sim.virtual.virtual_charger import GOAL, VirtualCharger

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
    then: Code | Callable[[Any, Any], bool]
    place: tuple[float, float, float] = (3.0, -2.0, 2.0)
    also: Mapping[str, Any] = MappingProxyType({})
    world: Mapping[str, Any] = MappingProxyType({})

    def seen(self, **given: Any) -> Any:
        """Return what a charger with these parameters shows."""
        return self.shows(charger(*self.place, parameters={**self.also, **given}, coarse=True, **self.world))


def code(run: VirtualCharger) -> Code:
    return run.dock().code


def seconds(run: VirtualCharger) -> float:
    assert run.dock().success
    return run.now


def contacts(run: VirtualCharger) -> int:
    assert run.dock().success
    return run.world.record.contacts


def push(run: VirtualCharger) -> float:
    """Return the contact current at rest, A."""
    outcome = run.dock(DockGoal(GOAL, start_charging=False))
    assert outcome.success
    return outcome.contact_current


def told_force(run: VirtualCharger) -> float:
    outcome = run.dock(DockGoal(GOAL, start_charging=False))
    assert outcome.success
    return outcome.contact_force


def tared_at(run: VirtualCharger) -> float:
    """Return where the arm measures its zero, m."""
    sent = commands(run)
    run.begin(DockGoal(GOAL))
    run.until(lambda: bool(decisions(sent, "zero")), 30.0)
    return run.world.snapshot().position[2]


def returns_to(run: VirtualCharger) -> float:
    """Return where the arm rests after undocking, m."""
    assert run.dock().success
    assert run.undock().success
    return run.world.snapshot().position[2]


def lean(yaw: float = 0.0, pitch: float = 0.0) -> Shows:
    """Dock at electrodes whose faces a goal gives as leaning, in degrees."""
    angles = {"yaw": math.radians(yaw), "pitch": math.radians(pitch), "yaw_stddev": 0.001, "pitch_stddev": 0.001}
    return lambda run: run.dock(DockGoal(ElectrodePose(GOAL.position, 0.0, **angles), start_charging=False)).code


def detected(age: float) -> Shows:
    def shows(run: VirtualCharger) -> Code:
        run.answer[Service.DETECT] = lambda reply: replace(reply, detection=replace(GOAL, age=age))
        return run.dock(DockGoal(None)).code

    return shows


def shown(state: State, lasts: float, **values: Any) -> Shows:
    """Replace these values in an observation for some seconds from a state on, and return the code that follows."""

    def shows(run: VirtualCharger) -> Code:
        reach(run, state)
        run.run(0.1)
        spoil(run, **values)
        run.run(lasts)
        spoil(run)
        run.run(0.1)
        return run.machine.status.code

    return shows


def pushed(run: VirtualCharger) -> Code:
    """Return the code after the servos pushed half as much again as they should, 0.7 A."""
    reach(run, State.MEASURE)
    run.distort = lambda seen: replace(seen, currents=tuple(1.5 * current for current in seen.currents))
    run.run(0.3)
    return run.machine.status.code


def yaw_error(run: VirtualCharger) -> float:
    """Return the standard deviation of the faces' yaw, rad."""
    assert run.dock().success
    return run.machine.status.estimate.yaw_stddev


def rest(run: VirtualCharger) -> State:
    """Return what the charger does a while after it was docked."""
    assert run.dock().success
    run.run(8.0)
    return run.machine.status.state


CASES: dict[str, Case | str] = {
    "power": "docking/test_approaches.py::test_it_docks_and_aligns_and_reports_only_known_values",
    "servo_stiffness": Case(160.0, code, Code.SERVO_FAULT),
    "torque_constant": Case(1.2, told_force, operator.lt),
    "gravity": Case((0.0, 20.0, 0.0), code, Code.SERVO_FAULT),
    "home_z": Case(0.03, returns_to, operator.gt),
    "travel_speed": Case(0.02, seconds, operator.gt),
    "search_speed": Case(0.005, seconds, operator.gt),
    "press_speed": Case(0.003, seconds, operator.gt),
    "standoff": Case(0.03, tared_at, operator.lt),
    "search_depth": Case(0.005, code, Code.NO_CONTACT, world={"target": TargetParameters(z=0.095)}),
    "current_min": Case(0.46, push, operator.gt),
    "current_max": Case(0.44, push, operator.lt),
    "hard_current": Case(0.55, pushed, Code.OVERCURRENT),
    "critical_angle": Case(math.radians(5.0), code, Code.CRITICAL_ANGLE, (3.0, -2.0, 6.0)),
    "yaw_max": Case(math.radians(2.0), lean(yaw=4.0), Code.LEANING),
    "pitch_max": Case(math.radians(2.0), lean(pitch=4.0), Code.LEANING),
    "electrode_half_gap": Case(0.001, code, Code.CRITICAL_ANGLE, (3.0, -2.0, 6.0)),
    "electrode_half_length": Case(0.1, code, Code.CRITICAL_ANGLE, (3.0, -2.0, 6.0)),
    "clearance_min": Case(0.005, code, Code.CRITICAL_ANGLE, (3.0, -2.0, 6.0)),
    "landing_limit": Case(0.001, contacts, operator.gt, (11.0, -9.0, 6.0)),
    "overlap_loss_max": Case(0.001, contacts, operator.gt),
    "place_stddev": Case(0.0001, code, Code.LEANING, (11.0, -9.0, 6.0)),
    "yaw_stddev": Case(0.0, contacts, operator.lt),
    "platform_compliance": Case(0.1, yaw_error, operator.gt),
    "magnet_force": Case(300.0, code, Code.STUCK),
    "charge_stable_time": Case(3.0, seconds, operator.gt),
    "battery_voltage_min": Case(23.5, shown(State.CHARGING, 6.0, battery_voltage=23.2), Code.VOLTAGE_OUT_OF_RANGE),
    "battery_voltage_start": Case(27.0, code, Code.VOLTAGE_OUT_OF_RANGE),
    "battery_voltage_max": Case(24.0, code, Code.VOLTAGE_OUT_OF_RANGE),
    "hold_max": Case(5.0, rest, operator.ne),
    "servo_age_max": Case(0.2, shown(State.CONTACT, 0.2, servo_age=0.3), Code.SERVO_STALE),
    "live_servo_age_max": Case(0.1, shown(State.CHARGING, 0.1, servo_age=0.15), Code.SERVO_STALE),
    "tactile_age_max": Case(0.2, shown(State.CHARGING, 0.1, tactile_age=0.3), Code.TACTILE_STALE),
    "power_age_max": Case(0.2, shown(State.CHARGING, 0.1, power_age=0.3), Code.POWER_STALE),
    "detection_age_max": Case(0.3, detected(0.6), Code.DETECTION_STALE),
    "goal_timeout": Case(12.0, code, Code.TIMEOUT, also={"press_speed": 0.002}),
    "servo_type": "docking/test_docking_parameters.py::test_the_band_of_every_servo_type_is_the_papers_force",
    "base_frame": "ros/test_frames.py::test_without_tf2_ros_parameters_are_used_and_other_frames_refused_by_name",
    "base_pose": "docking/test_docking_messages.py::test_a_goal_that_leans_keeps_its_lean_in_either_frame",
    "lean_max": "docking/test_docking_messages.py::test_a_goal_with_more_lean_than_lean_max_is_refused",
}
"""For each parameter its case, or the test that shows what it does."""


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if isinstance(case, Case)])
def test_another_value_changes_what_the_charger_does(name: str) -> None:
    case = CASES[name]
    assert isinstance(case, Case)
    usual, changed = case.seen(), case.seen(**{name: case.value})
    if isinstance(case.then, Code):
        assert (usual, changed) == (Code.NONE, case.then)
    else:
        assert case.then(changed, usual), (changed, usual)


def test_every_parameter_has_a_case_or_a_test_that_exists() -> None:
    assert set(CASES) == {each.name for table in (DockingParameters, DockingNodeParameters) for each in declared(table)}
    for name in CASES.values():
        if isinstance(name, str):
            file, _, test = name.partition("::")
            tree = ast.parse((TESTS / file).read_text("utf-8"))
            assert test in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, name
