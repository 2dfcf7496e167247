# SPDX-License-Identifier: Apache-2.0
"""Docking's parameters at their bounds: what contradicts others is refused by name, with the rest the charger docks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from deltacharger_core.parameters import ParameterError, declared
from deltacharger_docking.codes import Code, DockingError, Rejected
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import DockGoal, Observation
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_sim.virtual.virtual_charger import GOAL, VirtualCharger

from .dockings import assert_safe_at_home, charger

NAMES = {each.name for each in declared(DockingParameters)}
ENDS = {
    "servo_stiffness": {Code.SERVO_FAULT},  # the arm has another one, as for the constant
    "torque_constant": {Code.SERVO_FAULT, Code.STUCK},
    "home_z": {Code.REJECTED},  # beyond the electrodes
    "push_current": {Code.SERVO_FAULT},
    "release_current": {Code.STUCK},
    "critical_angle": {Code.CRITICAL_ANGLE},
    "electrode_half_gap": {Code.CRITICAL_ANGLE},
    "electrode_half_length": {Code.CRITICAL_ANGLE},
    "clearance_min": {Code.CRITICAL_ANGLE},
    "gravity_x": {Code.SERVO_FAULT, Code.ESTIMATE_UNSURE},  # twice as strong, and aside
    "gravity_y": {Code.SERVO_FAULT},
    "place_stddev": {Code.LEANING},  # 0.1 mm for a place that is 14 mm off
    "magnet_force": {Code.ESTIMATE_UNSURE, Code.STUCK},
    "magnet_width": {Code.ESTIMATE_UNSURE},
    "unsure_max": {Code.ESTIMATE_UNSURE},
}
"""How a docking may end, without a fault of the charger, with a parameter at a bound."""


def _bounds() -> Iterator[tuple[str, Any]]:
    for each in declared(DockingParameters):
        choices = each.choices or ((False, True) if each.kind is bool else (each.low, each.high))
        yield from ((each.name, value) for value in choices)


BOUNDS = list(_bounds())


def ended(run: VirtualCharger) -> tuple[Code, str]:
    """Dock, and return how that ended; NONE = with success."""
    try:
        outcome = run.dock(limit=4000.0)
    except DockingError as refusal:
        return refusal.code, str(refusal)
    return outcome.code, outcome.message


def refusal(name: str, value: Any) -> ParameterError | None:
    try:
        DockingParameters(**{name: value})
    except ParameterError as error:
        return error
    return None


def test_a_bound_is_accepted_or_contradicts_another_parameter_by_name() -> None:
    for name, value in BOUNDS:
        if (error := refusal(name, value)) is not None:
            named = {error.key, *(word for word in NAMES if word in error.problem)}
            assert name in named, error
            assert len(named) > 1, error


@pytest.mark.parametrize(
    ("given", "key", "other"),
    [
        ({"current_min": 0.85, "current_max": 0.95}, "current_max", "step_current_max, 0.6"),
        ({"current_max": 0.65, "step_current_max": 0.7, "push_current": 0.6}, "current_max", "push_current, 0.6"),
        ({"current_max": 0.6, "hard_current": 0.55}, "current_max", "hard_current, 0.55"),
        ({"current_min": 0.1}, "contact_lost_current", "current_min, 0.1"),
        ({"free_current": 0.41}, "free_current", "current_min, 0.4"),
        ({"current_min": 0.48}, "current_min", "current_max"),
        ({"approach_speed": 0.03, "approach_timeout": 6.0}, "approach_speed", "approach_timeout, 6 s"),
        ({"run_up": 0.02, "run_up_speed": 0.01, "approach_timeout": 7.0}, "run_up_speed", "approach_timeout, 7 s"),
        ({"search_depth": 0.05, "search_speed": 0.002}, "search_speed", "contact_timeout, 45 s"),
        ({"near": 0.02, "press_speed": 0.002, "contact_timeout": 18.0}, "press_speed", "contact_timeout, 18 s"),
        ({"travel_speed": 0.04, "align_timeout": 5.0}, "travel_speed", "align_timeout, 5 s"),
        ({"travel_speed": 0.04, "retract_timeout": 5.0}, "travel_speed", "retract_timeout, 5 s"),
        ({"opening_time": 0.5, "open_timeout": 0.6}, "opening_time", "open_timeout"),
        ({"clearance_sigmas": 7.0}, "clearance_sigmas", "clearance_sigmas_sure, 6"),
    ],
)
def test_two_that_contradict_each_other_are_refused(given: dict[str, float], key: str, other: str) -> None:
    with pytest.raises(ParameterError, match=other) as refusal:
        DockingParameters(**given)
    assert refusal.value.key == key


@pytest.mark.parametrize(
    "given",
    [
        {"current_min": 0.85, "current_max": 0.95, "step_current_max": 1.0, "push_current": 1.1, "hard_current": 1.6},
        {"current_min": 0.16, "current_max": 0.25, "push_current": 0.3},
        {"force_repeatability": 0.4},
    ],
    ids=str,
)
def test_with_another_band_it_docks_too(given: dict[str, float]) -> None:
    run = charger(11.0, -9.0, 6.0, parameters=given, coarse=True)
    assert run.dock().success
    assert run.undock().success
    assert_safe_at_home(run)


def test_a_home_from_which_the_arm_could_not_pull_off_is_refused() -> None:
    assert ended(charger(parameters={"home_z": 0.0681}, coarse=True)) == (
        Code.REJECTED,
        "the electrodes' z, 80 mm, is less than 12 mm beyond home_z, 68 mm, so the arm could not pull off: lower "
        "home_z, or move the robot back",
    )


def test_an_arm_that_reaches_no_electrodes_suggests_no_other_place() -> None:
    with pytest.raises(Rejected, match="correct the arm's geometry"):
        DockingMachine(DockingParameters(), DeltaGeometry(arm=0.01)).start_dock(
            DockGoal(GOAL, start_charging=False), Observation(0.0)
        )


@pytest.mark.rest
@pytest.mark.parametrize(("name", "value"), BOUNDS)
def test_a_docking_with_a_parameter_at_its_bound_has_a_sensible_end(name: str, value: Any) -> None:
    """With a target that is 14 mm off its place and rolled by 6°, so that more is decided by touch."""
    if refusal(name, value) is not None:
        return
    run = charger(11.0, -9.0, 6.0, parameters={name: value}, coarse=True)
    code, message = ended(run)
    if code is Code.NONE:
        run.run(3.0)
        assert run.undock().success
    else:
        assert code in ENDS.get(name, set()), message
    record = run.world.record
    assert not record.energised_shorts
    assert not record.energised_unsafe
    assert not run.world.snapshot().contactor_closed
