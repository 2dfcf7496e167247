# SPDX-License-Identifier: Apache-2.0
"""Docking's parameters at their bounds: what contradicts others is refused by name, with the rest the charger docks."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from deltacharger_core.parameters import Declaration, ParameterError, declared
from deltacharger_docking.codes import Code, DockingError, Rejected
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import DockGoal, Observation
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_sim.virtual.virtual_charger import GOAL, VirtualCharger

from .dockings import assert_safe_at_home, charger

PARAMETERS = {each.name: each for each in declared(DockingParameters)}
ENDS = {
    "servo_stiffness": {Code.SERVO_FAULT},  # the arm has another one, as for the constant
    "torque_constant": {Code.SERVO_FAULT, Code.STUCK},
    "gravity": {Code.SERVO_FAULT, Code.ESTIMATE_UNSURE},  # twice as strong, and aside
    "home_z": {Code.REJECTED},  # beyond the electrodes
    "critical_angle": {Code.CRITICAL_ANGLE},
    "electrode_half_gap": {Code.CRITICAL_ANGLE},
    "electrode_half_length": {Code.CRITICAL_ANGLE},
    "clearance_min": {Code.CRITICAL_ANGLE},
    "place_stddev": {Code.LEANING},  # 0.1 mm for a place that is 14 mm off
    "magnet_force": {Code.ESTIMATE_UNSURE, Code.STUCK},
    "goal_timeout": {Code.TIMEOUT},  # with another parameter: alone 12 s are enough
}
"""How a docking may end, without a fault of the charger, with a parameter at a bound."""


def bounds(each: Declaration) -> Iterator[Any]:
    """Yield the ends of a parameter's range, for a vector those of each number, or its choices."""
    if isinstance(each.default, tuple):
        for axis, _ in enumerate(each.default):
            for end in (each.low, each.high):
                yield (*each.default[:axis], end, *each.default[axis + 1 :])
    else:
        yield from each.choices or (each.low, each.high)


BOUNDS = [(name, value) for name, each in PARAMETERS.items() for value in bounds(each)]


def pairs(count: int, seed: int) -> Iterator[dict[str, Any]]:
    """Yield two parameters at bounds that do not contradict each other or the rest."""
    dice = random.Random(seed)
    while count:
        first, second = dice.sample(sorted(PARAMETERS), 2)
        given = {name: dice.choice(list(bounds(PARAMETERS[name]))) for name in (first, second)}
        if refusal(given) is None:
            yield given
            count -= 1


def ended(run: VirtualCharger) -> tuple[Code, str]:
    """Dock, and return how that ended; NONE = with success."""
    try:
        outcome = run.dock(limit=4000.0)
    except DockingError as refusal:
        return refusal.code, str(refusal)
    return outcome.code, outcome.message


def refusal(given: Mapping[str, Any]) -> ParameterError | None:
    try:
        DockingParameters(**given)
    except ParameterError as error:
        return error
    return None


def test_a_bound_is_accepted_or_contradicts_another_parameter_by_name() -> None:
    refused = set()
    for name, value in BOUNDS:
        if (error := refusal({name: value})) is not None:
            named = {error.key, *(word for word in PARAMETERS if word in error.problem)}
            assert name in named, error
            assert len(named) > 1, error
            refused.add(name)
    batteries = {"battery_voltage_min", "battery_voltage_start", "battery_voltage_max"}
    assert refused == {"current_min", "current_max"} | batteries


@pytest.mark.parametrize(
    ("given", "key", "other"),
    [
        ({"current_min": 0.48}, "current_min", r"current_max must be more than 0\.03 A above it"),
        ({"current_max": 0.6, "hard_current": 0.55}, "current_max", "hard_current, 0.55"),
        ({"battery_voltage_min": 24.0}, "battery_voltage_min", r"battery_voltage_start, 23\.7"),
        ({"battery_voltage_max": 23.0}, "battery_voltage_start", "battery_voltage_max, 23"),
    ],
)
def test_two_that_contradict_each_other_are_refused(given: dict[str, float], key: str, other: str) -> None:
    with pytest.raises(ParameterError, match=other) as refused:
        DockingParameters(**given)
    assert refused.value.key == key


@pytest.mark.parametrize(("low", "high"), [(0.85, 0.95), (0.16, 0.25), (0.15, 0.19)])
def test_with_another_band_it_docks_too(low: float, high: float) -> None:
    given = {"current_min": low, "current_max": high, "hard_current": 1.6}
    run = charger(11.0, -9.0, 6.0, parameters=given, coarse=True)
    outcome = run.dock()
    assert outcome.success, outcome.message
    assert low <= outcome.contact_current <= high
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


def assert_sensible_end(given: Mapping[str, Any]) -> None:
    """With a target that is 14 mm off its place and rolled by 6°, so that more is decided by touch."""
    run = charger(11.0, -9.0, 6.0, parameters=given, coarse=True)
    code, message = ended(run)
    if code is Code.NONE:
        run.run(3.0)
        undocked = run.undock()
        assert undocked.success, undocked.message
    else:
        assert code in set().union(*(ENDS.get(name, set()) for name in given)), message
    record = run.world.record
    assert not record.energised_shorts
    assert not record.energised_unsafe
    assert not record.parted_live
    assert not run.world.snapshot().contactor_closed


@pytest.mark.rest
@pytest.mark.parametrize(("name", "value"), [bound for bound in BOUNDS if refusal(dict([bound])) is None])
def test_a_docking_with_a_parameter_at_its_bound_has_a_sensible_end(name: str, value: Any) -> None:
    assert_sensible_end({name: value})


@pytest.mark.rest
@pytest.mark.parametrize("given", pairs(60, seed=1), ids=str)
def test_a_docking_with_two_parameters_at_their_bounds_has_a_sensible_end(given: dict[str, Any]) -> None:
    assert_sensible_end(given)
