# SPDX-License-Identifier: Apache-2.0
"""Faults of docking in virtual time: it always ends safely."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from deltacharger_docking.codes import Code, State
from deltacharger_docking.observation import Command, DockGoal, Observation, Reply, Service
from deltacharger_lab.campaigns.virtual_charger import GOAL, TICK
from deltacharger_sim.parameters import CircuitParameters, ServoParameters

from .dockings import MILLIMETRE, assert_safe_at_home, moves, moving_in, quick_charger

PHASES = [
    State.APPROACH,
    State.CONTACT,
    State.MEASURE,
    State.ALIGN,
    State.ENERGISE,
]


@pytest.mark.parametrize("state", PHASES)
def test_cancel_in_every_phase(state: State) -> None:
    run = quick_charger(6, 6)
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is state, 60.0)
    run.machine.cancel()
    outcome = run.finish(30.0)
    assert outcome.code is Code.CANCELED
    assert outcome.retriable
    assert_safe_at_home(run)
    assert run.dock().success, "the next goal is served"


@pytest.mark.parametrize("state", [*PHASES, State.CHARGING])
@pytest.mark.parametrize(
    ("fault", "code"),
    [
        ({"servo_age": 1.0}, Code.SERVO_FAULT),
        ({"hardware_error": 32}, Code.SERVO_FAULT),
        ({"power_age": 5.0}, Code.POWER_STALE),
        ({"tactile_age": 5.0}, Code.TACTILE_STALE),
    ],
)
def test_every_fault_in_every_phase_opens_the_contactor(state: State, fault: dict[str, float], code: Code) -> None:
    run = quick_charger(6, 6)
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is state, 120.0)
    run.distort = lambda observation: replace(observation, **fault)
    watched = {
        Code.POWER_STALE: state in (State.ENERGISE, State.CHARGING),
        Code.TACTILE_STALE: state not in (State.ENERGISE, State.CHARGING),
    }
    if not watched.get(code, True):
        run.run(0.1)
        assert run.machine.status.code is Code.NONE, "it is not called in this phase"
        return
    run.until(lambda: run.machine.status.code is not Code.NONE, 5.0)
    assert run.machine.status.code is code
    run.run(0.1)
    assert not run.world.snapshot().contactor_closed
    run.distort = lambda observation: observation
    run.until(lambda: run.machine.status.state is State.IDLE, 30.0)
    assert not run.observe().torque_enabled


MOVING = [State.APPROACH, State.CONTACT, State.ALIGN]


@pytest.mark.parametrize("state", MOVING)
@pytest.mark.parametrize("fault", [{"servo_age": 0.15}, {"tactile_age": 0.15}])
def test_old_data_stop_the_arm_and_fresh_data_let_it_continue(state: State, fault: dict[str, float]) -> None:
    run = moving_in(state)
    run.distort = lambda observation: replace(observation, **fault)
    run.run(0.06)
    held = run.world.snapshot().position
    run.run(1.0)
    assert math.dist(held, run.world.snapshot().position) < 2.0 * MILLIMETRE
    assert run.machine.status.state is state
    run.distort = lambda observation: observation
    outcome = run.finish(120.0)
    assert outcome.success, outcome.message


@pytest.mark.parametrize(("fault", "code"), [("servo_age", Code.SERVO_FAULT), ("tactile_age", Code.TACTILE_STALE)])
@pytest.mark.parametrize("state", MOVING)
def test_a_missing_input_first_stops_the_arm_and_then_ends_the_goal(state: State, fault: str, code: Code) -> None:
    run = moving_in(state)
    since, z = run.now, run.world.snapshot().position[2]
    free = GOAL.position[2] - run.machine.parameters.search_from  # up to here it cannot strike anything
    run.distort = lambda observation: replace(observation, **{fault: run.now - since})
    run.run(0.2)
    assert run.outcome is None
    assert not moves(run, 0.2)
    assert run.finish(20.0).code is code
    assert run.world.snapshot().position[2] < max(z + 3.0 * MILLIMETRE, free), "it was never carried on"


def test_the_time_limit_runs_while_the_arm_is_stopped() -> None:
    run = quick_charger(parameters={"approach_timeout": 3.0})
    run.begin(DockGoal(GOAL))
    run.until(lambda: moves(run, 3 * TICK), 10.0)
    run.distort = lambda observation: replace(observation, tactile_age=0.2)
    outcome = run.finish(30.0)
    assert outcome.code is Code.TIMEOUT
    assert_safe_at_home(run)


def test_retracting_needs_no_tactile_data() -> None:
    run = moving_in(State.CONTACT)
    run.distort = lambda observation: replace(observation, tactile_age=9.0)
    assert run.finish(30.0).code is Code.TACTILE_STALE
    assert_safe_at_home(run)


@pytest.mark.parametrize("state", [State.APPROACH, State.CONTACT])
def test_torque_lost_during_a_motion_ends_the_goal_at_once(state: State) -> None:
    """Otherwise the command would reach the arm's limit, and pressing would resume from there."""
    run = moving_in(state)
    run.distort = lambda observation: replace(observation, torque_enabled=False)
    assert run.finish(2.0).code is Code.SERVO_FAULT


@pytest.mark.parametrize(
    ("state", "stiffness"), [*((state, 15.0) for state in (*MOVING, State.RETRACT)), (State.APPROACH, 5.0)]
)
def test_motion_ends_with_the_machine(state: State, stiffness: float) -> None:
    servo = ServoParameters(stiffness=stiffness)
    if state is State.RETRACT:
        run = quick_charger(servo=servo)
        assert run.dock().success
        run.outcome = None
        run.machine.start_undock("", run.observe())
        run.until(lambda: moves(run, 3 * TICK), 10.0)
    else:
        run = moving_in(state, servo=servo)
    energise = run._energised
    run.machine.step = lambda observation: Command(energise=energise)  # type: ignore[method-assign]
    run.run(0.3)
    assert not moves(run, 0.1)
    assert not moves(run, 1.0)


def test_a_pull_ends_with_the_machine_even_just_after_release() -> None:
    for ticks in range(1, 9, 3):
        run = quick_charger(6, 6)
        run.begin(DockGoal(GOAL))
        run.until(lambda run=run: run.machine.status.state is State.ALIGN, 60.0)  # type: ignore[misc]
        run.run((ticks - 0.5) * TICK)
        run.machine.step = lambda observation: Command()  # type: ignore[method-assign]
        run.run(0.3)
        assert not moves(run, 0.2)
        assert max(run._bound) < 1.5, "no servo goes on pulling"


def test_contact_lost_while_charging_opens_within_a_tenth_of_a_second() -> None:
    run = quick_charger()
    assert run.dock().success
    run.distort = lambda observation: replace(observation, currents=(0.0, 0.0, 0.0))
    start = run.now
    run.until(lambda: not run.world.snapshot().contactor_closed, 1.0)
    assert run.now - start <= 0.25
    run.distort = lambda observation: observation
    run.until(lambda: run.machine.status.state is State.IDLE, 30.0)
    assert run.machine.status.code is Code.NO_CONTACT
    assert not run.machine.status.docked


@pytest.mark.parametrize(
    ("circuit", "code"),
    [
        ({"target_leakage": 0.0, "contact_resistance": 0.001}, Code.SHORT_CIRCUIT),
        ({"target_voltage": -24.0}, Code.REVERSE_POLARITY),
        ({"target_voltage": 5.0}, Code.VOLTAGE_OUT_OF_RANGE),
        ({"target_voltage": 40.0}, Code.VOLTAGE_OUT_OF_RANGE),
        ({"target_accepts": False}, Code.NO_CHARGE_CURRENT),
    ],
)
def test_findings_of_the_probe_and_the_power_stage_end_docking(circuit: dict[str, float], code: Code) -> None:
    run = quick_charger(circuit=CircuitParameters(**circuit))
    outcome = run.dock()
    assert not outcome.success
    assert outcome.code is code
    assert_safe_at_home(run)


@pytest.mark.parametrize(
    ("service", "code"),
    [
        (Service.TORQUE_ON, Code.SERVO_FAULT),
        (Service.TARE, Code.TACTILE_STALE),
        (Service.ESTIMATE, Code.TACTILE_STALE),
        (Service.PROBE, Code.POWER_STALE),
    ],
)
def test_failing_services_end_docking(service: Service, code: Code) -> None:
    run = quick_charger()
    run.answer[service] = lambda reply: Reply(reply.number, False, "out of order")
    outcome = run.dock()
    assert outcome.code is code
    run.until(lambda: run.machine.status.state is State.IDLE, 30.0)
    assert not run.world.snapshot().contactor_closed


def test_after_an_emergency_everything_is_off() -> None:
    run = quick_charger()
    assert run.dock().success
    command = run.machine.emergency()
    assert not command.energise
    assert command.trajectory == ()
    assert not run.machine.busy


def test_no_observation_raises_an_error() -> None:
    """The machine answers any data; a machine that raises would leave a goal without result."""
    blank = Observation(time=0.0)
    run = quick_charger()
    run.begin(DockGoal(GOAL))
    run.distort = lambda observation: replace(blank, time=observation.time, replies=observation.replies)
    outcome = run.finish(60.0)
    assert outcome.code is Code.SERVO_FAULT
