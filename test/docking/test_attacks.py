# SPDX-License-Identifier: Apache-2.0
"""Faults found by attacks on docking, in virtual time: each once left current on, an arm stuck or an endless goal."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from deltacharger_docking.codes import Busy, Code, State
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import DockGoal, Observation, Reply, Service
from deltacharger_lab.campaigns.virtual_charger import GOAL, VirtualCharger
from deltacharger_sim.parameters import CircuitParameters, ContactParameters

from ..marks import rest
from .dockings import quick_charger

NAN = math.nan


def charging(**kwargs: object) -> VirtualCharger:
    run = quick_charger(**kwargs)
    assert run.dock().success
    assert run.world.snapshot().contactor_closed
    return run


def until_open(run: VirtualCharger, limit: float = 30.0) -> float:
    """Return how long (s) the contactor stayed closed from now on."""
    start = run.now
    run.until(lambda: not run.world.snapshot().contactor_closed, limit)
    return float(run.now - start)


def until_idle(run: VirtualCharger) -> None:
    run.until(lambda: run.machine.status.state is State.IDLE, 40.0)


@pytest.mark.parametrize(
    ("values", "code"),
    [
        ({"charge_current": NAN}, Code.POWER_STALE),
        ({"currents": (NAN, NAN, NAN)}, Code.SERVO_FAULT),
    ],
)
def test_values_that_are_no_longer_measured_end_charging(values: dict[str, object], code: Code) -> None:
    run = charging()
    run.distort = lambda observation: replace(observation, **values)
    assert until_open(run, 1.0) <= 0.3
    assert run.machine.status.code is code


@pytest.mark.parametrize(
    ("answer", "code"),
    [
        (lambda reply: Reply(reply.number, False, "no node serves predict_misalignment"), Code.TACTILE_STALE),
        (lambda reply: None, Code.TACTILE_STALE),
        (lambda reply: replace(reply, estimate=replace(reply.estimate, sure=False)), Code.ESTIMATE_UNSURE),
        (lambda reply: replace(reply, estimate=replace(reply.estimate, in_range=False)), Code.ESTIMATE_UNSURE),
    ],
)
def test_charging_ends_without_estimates_of_the_clearance(answer: Callable[[Reply], Reply | None], code: Code) -> None:
    run = charging()
    run.answer[Service.ESTIMATE] = answer
    until_open(run, 15.0)
    assert run.machine.status.code is code


def test_one_unsure_estimate_does_not_end_charging() -> None:
    run = charging()
    left = [2]

    def doubt(reply: Reply) -> Reply:
        left[0] -= 1
        assert reply.estimate is not None
        return replace(reply, estimate=replace(reply.estimate, sure=left[0] < 0))

    run.answer[Service.ESTIMATE] = doubt
    run.run(12.0)
    assert run.machine.status.charging


def test_the_next_goal_does_not_pull_electrodes_off_a_welded_contactor() -> None:
    run = charging(circuit=CircuitParameters(welded=True))
    assert run.undock().code is Code.CONTACTOR_WELDED
    assert run.dock().code is Code.CONTACTOR_WELDED
    run.run(1.0)
    assert run.world.record.parted_live == 0
    assert run.observe().torque_enabled


def test_a_failure_right_after_the_close_waits_until_the_contactor_is_open() -> None:
    """Closing takes time and charger_power is late, so the first messages still report an open contactor."""
    run = quick_charger()
    late: list[tuple[float, Callable[[], None]]] = []
    plant, close, open_ = run.plant, run.plant.close_contactor, run.plant.open_contactor
    plant.close_contactor = lambda: late.append((run.now + 0.04, close))
    plant.open_contactor = lambda ramp: late.append((run.now + 0.04, lambda: open_(ramp)))
    seen: list[Observation] = []

    def delay(observation: Observation) -> Observation:
        for item in [item for item in late if item[0] <= run.now]:
            late.remove(item)
            item[1]()
        seen.append(observation)
        old = seen[max(len(seen) - 8, 0)]
        power = {name: getattr(old, name) for name in ("contactor_closed", "charge_current", "power_fault")}
        return replace(observation, power_age=observation.time - old.time, **power)

    run.distort = delay
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine._context.energise, 120.0)
    run.machine.cancel()
    assert run.finish(30.0).code is Code.CANCELED
    assert run.world.record.parted_live == 0
    assert run.world.record.unpowered_live == 0


def test_a_goal_while_the_arm_retracts_is_refused() -> None:
    run = charging()
    run.distort = lambda observation: replace(observation, charge_current=0.0)
    run.run(0.03)
    run.distort = lambda observation: observation
    assert run.machine.status.state is State.RETRACT
    for start_charging in (True, False):
        with pytest.raises(Busy):
            run.machine.start_dock(DockGoal(GOAL, start_charging=start_charging), run.observe())
    until_idle(run)
    assert not run.observe().torque_enabled
    assert run.dock().success


@pytest.mark.parametrize("fault", [{"servo_age": 0.2}, {"angles": (NAN, NAN, NAN), "servos_valid": False}])
def test_retracting_ends_with_any_servo_data(fault: dict[str, object]) -> None:
    run = quick_charger(parameters={"retract_timeout": 3.0})
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is State.MEASURE, 60.0)
    run.machine.cancel()
    run.distort = lambda observation: replace(observation, **fault)
    assert run.finish(8.0).code is Code.CANCELED
    run.run(0.1)
    assert not run.observe().torque_enabled


def test_soft_electrodes_are_pulled_off_before_the_arm_goes_home() -> None:
    run = quick_charger(contact=ContactParameters(stiffness=4e3))
    assert run.dock(DockGoal(GOAL, start_charging=False)).success
    outcome = run.undock()
    away = math.dist(run.world.snapshot().position, run.parameters.home)
    assert outcome.success == (away < 0.004), "success only at home"
    assert outcome.success


def test_undocking_moves_a_limp_arm_home_even_without_contact_at_the_pads() -> None:
    run = quick_charger()
    assert run.dock(DockGoal(GOAL, start_charging=False)).success
    run._torque = False
    run.run(0.5)
    run.distort = lambda observation: replace(observation, tactile_contact=False)
    assert run.undock().success
    assert math.dist(run.world.snapshot().position, run.parameters.home) < 0.004


def test_a_pull_that_the_servos_lost_is_repeated() -> None:
    run = quick_charger()
    assert run.dock(DockGoal(GOAL, start_charging=False)).success
    run.outcome = None
    run.machine.start_undock("", run.observe())
    run.run(0.06)
    run._trajectory, run._goal = (), run._angles()
    assert run.finish(30.0).success


def test_holding_a_goal_is_not_limited_by_the_time_to_dock() -> None:
    run = quick_charger(parameters={"goal_timeout": 30.0})
    assert run.dock(DockGoal(GOAL, hold=True, stop_after=25.0)).success


def test_undocking_fails_if_the_torque_stays_on() -> None:
    run = charging()
    serve = run._reply
    run._reply = lambda pending: (
        Reply(pending.request.number, False, "out of order")
        if pending.request.service is Service.TORQUE_OFF
        else serve(pending)
    )
    assert run.undock().code is Code.SERVO_FAULT


def test_undocking_fails_while_servo_state_reports_torque_on() -> None:
    run = charging()
    run.distort = lambda observation: replace(observation, torque_enabled=True)
    outcome = run.undock()
    assert outcome.code is Code.SERVO_FAULT
    assert "still reports" in outcome.message


def test_a_docking_node_that_was_restarted_lifts_off_before_it_tares() -> None:
    run = charging()
    run.machine = DockingMachine(run.parameters)
    run.run(0.2)
    contacts, touching = run.world.record.contacts, []

    def tare(reply: Reply) -> Reply:
        touching.append(run.world.snapshot().contact_force > 0.0)
        return reply

    run.answer[Service.TARE] = tare
    assert run.dock().success
    assert touching == [False]
    assert run.world.record.contacts > contacts


def test_a_fault_latched_before_docking_is_cleared_once() -> None:
    run = quick_charger()
    latched = [True]

    def clear(reply: Reply) -> Reply:
        latched[0] = False
        return reply

    run.answer[Service.OPEN] = clear
    run.distort = lambda observation: replace(observation, power_fault=8) if latched[0] else observation
    assert run.dock().success


def test_after_an_emergency_a_much_later_goal_is_served() -> None:
    run = quick_charger()
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is State.CONTACT, 60.0)
    run.machine.emergency()
    run.run(60.0)
    assert run.dock().success


def test_a_docked_charger_without_current_is_supervised() -> None:
    run = quick_charger()
    assert run.dock(DockGoal(GOAL, start_charging=False)).success
    contacts = run.world.record.contacts
    assert run.dock(DockGoal(GOAL, start_charging=False)).success
    assert run.world.record.contacts == contacts, "docking when docked moves nothing"
    run.distort = lambda observation: replace(observation, hardware_error=32)
    run.until(lambda: run.machine.status.code is Code.SERVO_FAULT, 1.0)
    run.run(0.5)
    assert not run.observe().torque_enabled


@pytest.mark.parametrize(
    ("fault", "code"), [(1, Code.NO_CHARGE_CURRENT), (2, Code.SHORT_CIRCUIT), (0, Code.POWER_STALE)]
)
def test_a_refused_renewal_opens_at_once_and_the_next_fault_gives_the_code(fault: int, code: Code) -> None:
    run = charging()
    refused_at = run.now

    def refuse(observation: Observation) -> Observation:
        known = run.now - refused_at > 0.1
        return replace(observation, contactor_refusal="refused", power_fault=fault if known else 0)

    run.distort = refuse
    assert until_open(run) <= 0.1
    run.run(0.5)
    assert run.machine.status.code is code


@pytest.mark.parametrize("fault", [{"hardware_error": 32}, {"servo_age": 5.0}])
def test_undocking_without_servos_fails_while_the_magnets_may_hold(fault: dict[str, object]) -> None:
    run = quick_charger()
    assert run.dock(DockGoal(GOAL, start_charging=False)).success
    run.distort = lambda observation: replace(observation, **fault)
    run.until(lambda: run.machine.status.code is Code.SERVO_FAULT, 2.0)
    until_idle(run)
    assert run.undock().code is Code.SERVO_FAULT
    assert run.machine.status.docked, "the electrodes rest on the target"
    run.distort = lambda observation: observation
    assert run.undock().success
    assert not run.machine.status.docked


NAMES = "servo_state from /servo_node and /stranger"


def two_speak(observation: Observation) -> Observation:
    return replace(observation, duplicate_sources=NAMES)


@pytest.mark.parametrize("begins", [rest(State.APPROACH), State.MEASURE, rest(State.ENERGISE)])
def test_the_contactor_stays_open_while_there_is_a_second_source(begins: State) -> None:
    """At any time: docking continues up to closing, waits for it to disappear, reports it and retracts."""
    run = quick_charger(parameters={"duplicate_source_timeout": 2.0})
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is begins, 60.0)
    run.distort = two_speak
    outcome = run.finish(120.0)
    assert (outcome.code, outcome.retriable) == (Code.DUPLICATE_SOURCE, True)
    assert NAMES in outcome.message
    assert run.machine.status.duplicate_sources == NAMES
    assert run.world.record.energised == 0.0
    until_idle(run)


@pytest.mark.parametrize("begins", [rest(State.CONTACT), State.MEASURE])
def test_an_estimate_made_during_a_second_source_allows_no_current(begins: State) -> None:
    """A second source that has disappeared before closing may have sent the estimate, so it is repeated."""
    run = quick_charger()
    felt: list[float] = []

    def note(reply: Reply) -> Reply:
        felt.append(run.now)
        return reply

    run.answer[Service.ESTIMATE] = note
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is begins, 60.0)
    run.distort = two_speak
    run.until(lambda: run.machine.status.state is State.MEASURE and len(felt) >= 1, 60.0)
    run.run(0.5)
    run.distort = lambda observation: observation
    gone = run.now
    assert run.finish(120.0).success
    assert felt[-1] > gone
    run.until(lambda: run.world.snapshot().contactor_closed, 1.0)


def test_a_second_source_during_charging_is_reported_and_opens_nothing() -> None:
    run = charging()
    run.distort = two_speak
    run.run(10.0)
    assert run.machine.status.charging
    assert run.machine.status.duplicate_sources == NAMES


def test_a_restarted_node_gets_as_much_time_as_a_new_one() -> None:
    run = quick_charger()
    run.run(1.0)
    since = run.now
    run.distort = lambda observation: (
        replace(observation, tactile_age=observation.time - since + 5.0)
        if observation.time < since + 2.0
        else observation
    )
    assert run.dock().success


def test_pads_that_stay_silent_end_a_goal_before_anything_moves() -> None:
    run = quick_charger()
    before = run.world.snapshot().position
    run.distort = lambda observation: replace(observation, tactile_age=observation.time + 5.0)
    assert run.dock().code is Code.TACTILE_STALE
    assert run.now < run.parameters.first_data_timeout + 1.0
    assert math.dist(run.world.snapshot().position, before) < 1e-3
