# SPDX-License-Identifier: Apache-2.0
"""Goals on a docked target: each is fulfilled, none moves electrodes that rest well or weakens the supervision."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import Any

import pytest

from deltacharger_docking.codes import Busy, Code, State
from deltacharger_docking.observation import DockGoal, Reply, Service
from deltacharger_lab.campaigns.virtual_charger import GOAL, VirtualCharger
from deltacharger_sim.parameters import CircuitParameters, MagnetParameters

from .dockings import assert_safe_at_home, charger, felt_as, quick_charger


def docked(*place: float, start_charging: bool = True, **kwargs: Any) -> VirtualCharger:
    run = quick_charger(*place, **kwargs)
    outcome = run.dock(DockGoal(GOAL, start_charging=start_charging))
    assert outcome.success, outcome.message
    return run


def shifted(reply: Reply, degrees: float) -> Reply:
    """The same answer for a target rotated by this angle."""
    assert reply.estimate is not None
    return replace(reply, estimate=felt_as(reply.estimate, angle=math.radians(degrees)))


def test_a_stop_condition_counts_from_its_own_goal() -> None:
    run = docked()
    run.run(5.0)
    contacts, before = run.world.record.contacts, run.now
    outcome = run.dock(DockGoal(GOAL, hold=True, stop_energy=700.0))
    assert outcome.success
    assert 700.0 <= outcome.energy < 800.0
    assert run.now - before > 2.0, "the energy before the goal is not its own"
    assert run.dock(DockGoal(GOAL, hold=True, stop_after=2.0)).success
    truth = run.world.snapshot()
    assert not truth.contactor_closed
    assert run.world.record.contacts == contacts
    assert run.machine.status.docked


def test_a_stop_condition_without_hold_ends_charging_under_supervision() -> None:
    run = docked()
    assert run.dock(DockGoal(GOAL, stop_after=3.0)).success
    assert run.world.snapshot().contactor_closed
    run.until(lambda: not run.world.snapshot().contactor_closed, 4.0)
    run.run(1.0)
    assert run.machine.status.docked
    assert run.machine.status.code is Code.NONE


def test_a_goal_without_charging_ends_charging_and_keeps_the_contact() -> None:
    run = docked()
    contacts = run.world.record.contacts
    assert run.dock(DockGoal(GOAL, start_charging=False)).success
    assert not run.world.snapshot().contactor_closed
    assert run.machine.status.docked
    assert run.world.record.contacts == contacts
    assert run.world.record.broken_current < 1.5, "it was ramped down first"


def test_electrodes_that_lift_to_repeat_a_contact_are_not_docked_until_they_rest_again() -> None:
    run = docked(start_charging=False)
    doubts = [0.04]  # rad; at six standard deviations no clearance is sure

    def doubt(reply: Reply) -> Reply:
        assert reply.estimate is not None
        return replace(reply, estimate=replace(reply.estimate, angle_stddev=doubts.pop())) if doubts else reply

    run.answer[Service.ESTIMATE] = doubt
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is State.CONTACT, 5.0)
    assert run.world.misalignment is None
    assert not run.machine.status.docked
    assert run.finish(20.0).success
    assert run.machine.status.docked


def test_a_target_whose_magnets_do_not_release_stays_docked_after_any_goal() -> None:
    run = quick_charger(magnets=MagnetParameters(force=200.0), parameters={"magnet_force": 200.0})
    run.answer[Service.ESTIMATE] = functools.partial(shifted, degrees=14.0)
    outcome = run.dock()
    assert outcome.code is Code.STUCK
    assert run.world.misalignment is not None
    assert run.machine.status.docked


def test_a_docked_target_is_energised_in_place_after_a_new_clearance_measurement() -> None:
    run = docked(start_charging=False)
    contacts = run.world.record.contacts
    asked: list[Service] = []

    def note(service: Service, reply: Reply) -> Reply:
        asked.append(service)
        return reply

    for service in (Service.TARE, Service.ESTIMATE, Service.PROBE):
        run.answer[service] = functools.partial(note, service)
    outcome = run.dock()
    assert outcome.success
    assert run.world.record.contacts == contacts
    assert asked[0] is Service.ESTIMATE
    assert asked.count(Service.PROBE) == 1
    assert Service.TARE not in asked
    assert run.machine.status.charging


def test_a_target_that_turned_while_docked_is_not_energised_in_place() -> None:
    run = docked(start_charging=False)
    run.answer[Service.ESTIMATE] = lambda reply: shifted(reply, 12.5)
    assert run.dock().code is Code.CRITICAL_ANGLE
    assert run.world.record.energised == 0.0
    assert_safe_at_home(run)


def test_a_docked_target_that_has_moved_away_is_docked_again() -> None:
    run = docked(start_charging=False)
    contacts = run.world.record.contacts
    run.begin(DockGoal(GOAL))
    run.distort = lambda observation: replace(observation, tactile_contact=False)
    run.tick()
    run.distort = lambda observation: observation
    assert run.finish(120.0).success
    assert run.world.record.contacts > contacts


def test_repeated_goals_do_not_delay_the_clearance_check() -> None:
    run = docked()
    run.answer[Service.ESTIMATE] = lambda reply: shifted(reply, 12.5)
    start = run.now
    while run.world.snapshot().contactor_closed and run.now < start + 20.0:
        assert run.dock().success
        run.run(0.5)
    assert run.now - start < 3.0 * run.parameters.clearance_period + 1.0
    assert run.machine.status.code is Code.CRITICAL_ANGLE


def test_the_lowest_critical_angle_of_all_goals_applies() -> None:
    run = quick_charger()
    assert run.dock(DockGoal(GOAL, critical_angle=math.radians(8.0))).success
    assert run.dock().success, "a goal without a limit of its own"
    run.answer[Service.ESTIMATE] = lambda reply: shifted(reply, 9.0)
    run.until(lambda: run.machine.status.code is Code.CRITICAL_ANGLE, 10.0)


def test_a_goal_with_a_limit_below_the_measured_angle_ends_charging() -> None:
    run = docked(3.0, -2.0, 5.0)
    assert run.dock(DockGoal(GOAL, critical_angle=math.radians(3.0))).code is Code.CRITICAL_ANGLE
    assert_safe_at_home(run)


def test_a_cancel_without_a_goal_changes_nothing_and_a_held_goal_can_be_cancelled() -> None:
    run = docked()
    run.machine.cancel()
    run.run(1.0)
    assert run.world.snapshot().contactor_closed
    run.begin(DockGoal(GOAL, hold=True))
    run.run(0.5)
    with pytest.raises(Busy):
        run.machine.start_undock("", run.observe())
    run.machine.cancel()
    assert run.finish(30.0).code is Code.CANCELED
    assert_safe_at_home(run)


def test_holding_without_current_lasts_until_its_time_or_a_cancel() -> None:
    run = quick_charger()
    outcome = run.dock(DockGoal(GOAL, start_charging=False, hold=True, stop_after=40.0))
    assert outcome.success
    assert outcome.elapsed >= 40.0
    assert run.machine.status.docked


FILLING = CircuitParameters(target_capacity=40.0)  # constant voltage after 13 s, then a time constant of 6.4 s


@pytest.mark.parametrize("hold", [True, False])
def test_current_that_tapers_off_means_a_full_target(hold: bool) -> None:
    run = quick_charger(circuit=FILLING)
    outcome = run.dock(DockGoal(GOAL, hold=hold), limit=300.0)
    assert outcome.success
    run.until(lambda: not run.world.snapshot().contactor_closed, 120.0)
    run.run(0.5)
    assert run.machine.status.code is Code.NONE
    assert run.machine.status.docked
    assert not run.machine.status.charging
    assert run.world.snapshot().contact_force > 0.0
    assert run.world.circuit.voltages()[1] > 28.0, "it is full"


@pytest.mark.parametrize("wait", [1.0, 25.0])
def test_current_that_is_cut_off_is_not_a_full_target(wait: float) -> None:
    """Also in the middle of the taper, when current is already small."""
    run = docked(circuit=FILLING)
    run.run(wait)
    assert run.world.snapshot().contactor_closed
    run.distort = lambda observation: replace(observation, charge_current=0.0)
    run.until(lambda: run.machine.status.code is not Code.NONE, 0.1)
    assert run.machine.status.code is Code.NO_CHARGE_CURRENT


@pytest.mark.parametrize("jump", [3600.0, -3600.0])
def test_a_clock_that_jumps_opens_the_contactor(jump: float) -> None:
    run = docked()
    run.distort = lambda observation: replace(observation, time=observation.time + jump)
    run.tick()
    assert not run._energised
    run.until(lambda: run.machine.status.state is State.IDLE, 30.0)
    assert run.machine.status.code is Code.POWER_STALE
    assert_safe_at_home(run)
    run.distort = lambda observation: observation
    assert run.dock().success


@pytest.mark.parametrize("jump", [3600.0, -3600.0])
def test_a_goal_ends_in_time_despite_clock_jumps(jump: float) -> None:
    run = quick_charger()
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is State.MEASURE, 60.0)
    run.distort = lambda observation: replace(observation, time=observation.time + jump)
    outcome = run.finish(run.parameters.goal_timeout)
    assert outcome.success if jump < 0.0 else outcome.code is Code.TIMEOUT
    assert (run.machine.status.state is State.IDLE) != outcome.success


AGAIN = {"restarts_max": 2}


def lose_contact(run: VirtualCharger) -> None:
    """The target is nudged away for a moment."""
    run.distort = lambda observation: replace(observation, currents=(0.0, 0.0, 0.0))
    run.until(lambda: run.machine.status.state is State.RETRACT, 1.0)
    run.distort = lambda observation: observation


def test_docking_again_recovers_from_a_nudge_under_supervision() -> None:
    run = docked(parameters=AGAIN)
    shown = len(run.states)
    lose_contact(run)
    with pytest.raises(Busy):
        run.machine.start_dock(DockGoal(GOAL), run.observe())
    run.until(lambda: run.machine.status.charging, 120.0)
    assert run.machine.status.code is Code.NONE
    assert run.states[shown : shown + 3] == [State.RETRACT, State.APPROACH, State.CONTACT]
    assert run.world.record.parted_live == 0


def test_a_held_goal_survives_a_nudge_and_counts_all_its_energy() -> None:
    run = quick_charger(parameters=AGAIN)
    run.begin(DockGoal(GOAL, hold=True, stop_energy=2000.0))
    run.until(lambda: run.machine.status.charging, 120.0)
    run.run(3.0)
    lose_contact(run)
    outcome = run.finish(200.0)
    assert outcome.success
    assert 2000.0 <= outcome.energy < 2100.0


def test_docking_again_is_bounded_and_keeps_the_first_error() -> None:
    run = charger(3.0, 20.0, parameters=AGAIN)
    outcome = run.dock()
    assert outcome.code is Code.NO_TACTILE_CONTACT
    assert "docking again" in outcome.message
    assert outcome.retriable
    assert run.states.count(State.RETRACT) == 3
    assert_safe_at_home(run)


def test_there_is_no_retry_for_errors_that_docking_again_cannot_mend() -> None:
    run = quick_charger(3.0, -2.0, 14.0, parameters=AGAIN)
    assert run.dock().code in (Code.CRITICAL_ANGLE, Code.ESTIMATE_UNSURE)
    assert run.states.count(State.RETRACT) == 1


@pytest.mark.parametrize(("state", "code"), [(State.RETRACT, Code.NO_CONTACT), (State.CONTACT, Code.CANCELED)])
def test_a_cancel_before_or_while_docking_again_ends_the_goal(state: State, code: Code) -> None:
    run = quick_charger(parameters=AGAIN)
    run.begin(DockGoal(GOAL, hold=True))
    run.until(lambda: run.machine.status.charging, 120.0)
    lose_contact(run)
    run.until(lambda: run.machine.status.state is state, 60.0)
    run.machine.cancel()
    outcome = run.finish(60.0)
    assert outcome.code is code
    assert "contact was lost" in outcome.message
    assert_safe_at_home(run)


def test_a_cancel_during_the_last_retract_does_not_lose_the_result() -> None:
    run = quick_charger(3.0, -2.0, 14.0)
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is State.RETRACT, 120.0)
    run.machine.cancel()
    assert run.finish(60.0).code is Code.CRITICAL_ANGLE


def test_undocking_ends_docking_again() -> None:
    run = docked(parameters=AGAIN)
    lose_contact(run)
    run.until(lambda: run.machine.status.state is State.CONTACT, 30.0)
    assert run.undock().success
    assert_safe_at_home(run)


def test_a_cancel_while_the_camera_looks() -> None:
    run = quick_charger()
    run.answer[Service.DETECT] = lambda reply: None
    run.begin(DockGoal(None))
    run.run(1.0)
    assert run.machine.status.state is State.LOCATE
    run.machine.cancel()
    assert run.finish(10.0).code is Code.CANCELED
    assert_safe_at_home(run)


def test_a_cancelled_undocking_still_ends_at_home() -> None:
    run = docked()
    run.outcome = None
    run.machine.start_undock("", run.observe())
    run.run(0.3)
    run.machine.cancel()
    assert run.finish(30.0).code is Code.CANCELED
    assert_safe_at_home(run)


def test_a_reply_to_a_later_request_is_ignored() -> None:
    run = quick_charger()
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is State.MEASURE, 60.0)
    forged = tuple(Reply(number, True, resistance=1e9, target_voltage=24.0) for number in range(3, 60))
    run.answer[Service.PROBE] = lambda reply: None
    run.distort = lambda observation: replace(
        observation, replies=(*observation.replies, *(forged if run.machine.status.state is State.CONTACT else ()))
    )
    run.finish(120.0)
    assert run.world.record.energised == 0.0
