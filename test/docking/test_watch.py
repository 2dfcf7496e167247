# SPDX-License-Identifier: Apache-2.0
"""What docking watches, in virtual time: where the arm is, what a measurement rests on, and what is live."""

import math
from dataclasses import replace
from typing import Any

import pytest

from deltacharger_docking import codes, observation
from deltacharger_sim.parameters import ContactParameters, StandParameters, TargetParameters
from deltacharger_sim.virtual.virtual_charger import VirtualCharger

from ..marks import rest
from .dockings import MILLIMETRE, charger, commands, decisions, docked, quick_charger, reach, spoil, until_open

_WELD = {"power_fault": 7}
_LIVE = {"contactor_closed": True, "charge_current": 8.0}
SLIPPERY = ContactParameters(friction=0.02)


# Law 1: where the arm is.


def outside(run: VirtualCharger) -> float:
    """Return how far (m) the platform is outside its workspace."""
    low, high = run.geometry.workspace_min, run.geometry.workspace_max
    return max(max(a - p, p - b) for a, p, b in zip(low, run.world.snapshot().position, high, strict=True))


@pytest.mark.parametrize("index", [rest(0), 1, rest(2)])
@pytest.mark.parametrize(
    "phase",
    [codes.State.APPROACH, codes.State.CONTACT, codes.State.ALIGN, rest(codes.State.MEASURE), codes.State.RETRACT],
)
def test_a_servo_that_keeps_its_place_is_named_before_the_others_drive_on(phase: codes.State, index: int) -> None:
    run = quick_charger(4.0, 4.0) if phase is codes.State.MEASURE else quick_charger(8.0, 8.0)
    if phase is codes.State.RETRACT:
        reach(run, codes.State.CHARGING)
        run.machine.start_undock("", run.observe())
        run.until(lambda: run.machine.status.state is phase, 5.0)
        run.until(lambda: not run.world.snapshot().contactor_closed, 5.0)
    else:
        reach(run, phase)
    command, held = run.plant.command_servo, run._goal[index]

    def deaf(servo: int, on: bool, goal: float, *more: float) -> None:
        command(servo, on, held if servo == index else goal, *more)

    run.plant.command_servo = deaf  # type: ignore[method-assign]
    run.outcome, most = None, -math.inf
    while run.outcome is None:
        run.tick()
        most = max(most, outside(run))
    assert run.outcome.code is codes.Code.SERVO_FAULT, run.outcome.message
    assert f"servo {index + 1} is farther from its goal" in run.outcome.message
    assert most < 5 * MILLIMETRE
    assert not run.observe().torque_enabled


def test_a_target_that_moves_away_does_not_take_the_arm_along() -> None:
    run = quick_charger()
    reach(run, codes.State.MEASURE)
    for _ in range(100):
        run.world.mechanics.move_along(0.5 * MILLIMETRE)
        run.tick()
        assert outside(run) < 0.0
    assert run.machine.status.code is codes.Code.NO_CONTACT, run.machine.status.message
    assert "moves away" in run.machine.status.message


@pytest.mark.parametrize("docks", [False, True])
def test_pads_that_feel_contact_at_home_do_not_pull_the_arm_below(docks: bool) -> None:
    run, most = quick_charger(), -math.inf
    if docks:
        reach(run, codes.State.APPROACH)
        run.run(0.3)
    else:
        run.outcome = None
        run.machine.start_undock("", run.observe())
    spoil(run, tactile_contact=True, tared=True)
    while run.outcome is None:
        run.tick()
        most = max(most, outside(run))
    assert run.outcome.code is codes.Code.STUCK, run.outcome.message
    assert "pads feel contact at home" in run.outcome.message
    assert most < MILLIMETRE


def test_a_target_that_rolls_while_it_is_measured_is_named() -> None:
    run = quick_charger(stand=StandParameters(stiffness=20e3))
    reach(run, codes.State.MEASURE)
    run.world.mechanics.set_brakes(0.1)
    run.until(lambda: run.machine.status.code is not codes.Code.NONE, 10.0)
    assert run.machine.status.code is codes.Code.TARGET_ROLLS, run.machine.status.message
    assert outside(run) < 0.0


# Law 2: zero is measured in free air, and a push is heard by two senses.


@pytest.mark.parametrize("nearer", [10.0, 24.0, rest(40.0), 60.0])
def test_a_target_nearer_than_told_is_charged_with_the_push_that_is_told(nearer: float) -> None:
    place = TargetParameters()
    run = charger(coarse=True, target=replace(place, x=0.003, z=place.z - nearer * MILLIMETRE))
    outcome = run.dock()
    assert outcome.success, outcome.message
    assert outcome.contact_force_min <= run.world.snapshot().push <= outcome.contact_force_max
    assert run.undock().success


@pytest.mark.parametrize("share", [0.0, rest(0.3)])
@pytest.mark.parametrize("phase", [rest(codes.State.APPROACH), codes.State.CONTACT])
def test_currents_that_lie_stop_the_push_that_the_pads_feel(phase: codes.State, share: float) -> None:
    run = charger(coarse=True)
    reach(run, phase)
    frozen = run.observe().currents

    def lie(seen: observation.Observation) -> observation.Observation:
        return replace(seen, earlier=(), currents=frozen if not share else tuple(share * i for i in seen.currents))

    run.distort, most = lie, 0.0
    while run.outcome is None:
        run.tick()
        most = max(most, run.world.snapshot().push if run.world.mechanics.contact_force else 0.0)
    assert run.outcome.code is codes.Code.SERVO_FAULT, run.outcome.message
    assert most < 30.0


# Law 3: evidence ends with its contact.


def test_a_target_that_shifts_while_docking_awaits_the_probe_is_measured_again() -> None:
    run = quick_charger(0.0, 0.0, 0.0, contact=SLIPPERY)
    reach(run, codes.State.ENERGISE)
    found = commands(run)
    run.world.move_target(0.0, 6 * MILLIMETRE, 0.0, 0.05)
    run.until(lambda: run.outcome is not None, 60.0)
    kinds = [each.kind for each in decisions(found)]
    assert kinds.index("doubt") < kinds.index("measured") < kinds.index("close")
    assert run.world.record.energised_unsafe == run.world.record.energised_shorts == 0


# Law 4: live is what is measured live.


@pytest.mark.parametrize("shift", [(12.0, 0.0), (-12.0, 0.0), (0.0, 14.0), (0.0, -14.0)])
def test_a_target_that_moves_on_the_pads_opens_before_a_short(shift: tuple[float, float]) -> None:
    across, degrees = shift
    run = docked(0.0, 0.0, 0.0, contact=SLIPPERY)
    run.run(0.5)
    run.world.move_target(0.0, across * MILLIMETRE, math.radians(degrees), 0.2)
    assert until_open(run) < 0.2
    run.run(0.1)
    assert run.machine.status.code is codes.Code.NO_CONTACT
    assert run.world.record.energised_unsafe == run.world.record.energised_shorts == 0


@pytest.mark.parametrize("shown", [_WELD, _LIVE], ids=["welded", "current"])
@pytest.mark.parametrize(
    "phase",
    [codes.State.APPROACH, codes.State.CONTACT, codes.State.MEASURE, codes.State.ALIGN, rest(codes.State.ENERGISE)],
)
def test_current_that_nobody_ordered_ends_the_goal_where_the_arm_is(phase: codes.State, shown: dict[str, Any]) -> None:
    run = quick_charger(8.0, 8.0)
    reach(run, phase)
    spoil(run, **shown)
    before = run.world.snapshot().position
    run.until(lambda: run.outcome is not None, 5.0)
    assert run.outcome is not None
    assert run.outcome.code is codes.Code.CONTACTOR_WELDED
    still = phase in (codes.State.CONTACT, codes.State.MEASURE, codes.State.ENERGISE)  # in ALIGN it pulls off already
    assert not still or math.dist(before, run.world.snapshot().position) < 6 * MILLIMETRE


@pytest.mark.parametrize("leaves", [False, True])
def test_a_voltage_of_electrodes_in_free_air_is_a_weld(leaves: bool) -> None:
    run = docked() if leaves else quick_charger()
    spoil(run, target_voltage=25.0)
    outcome = run.undock() if leaves else run.dock()
    assert outcome.code is codes.Code.CONTACTOR_WELDED
    assert "touch nothing but have 25.0 V" in outcome.message
    assert run.world.record.contacts == leaves
    assert not run.observe().torque_enabled
