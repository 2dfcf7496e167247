"""Docking scenarios in virtual time: what happens, how it ends, and that every way out is safe."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from deltacharger_bringup.virtual_charger import GOAL, TICK, VirtualCharger
from deltacharger_docking.codes import Busy, Code, Rejected, State, Unreachable
from deltacharger_docking.observation import Command, Detection, DockGoal, Observation, Reply, Service
from deltacharger_docking.parameters import DockingParameters
from deltacharger_sim.parameters import (
    CircuitParameters,
    ServoParameters,
    TargetParameters,
    WorldParameters,
)

MILLIMETRE = 1e-3
PHASES = [
    State.APPROACH,
    State.CONTACT,
    State.MEASURE,
    State.ALIGN,
    State.ENERGISE,
]


def charger(x: float = 3.0, y: float = -2.0, degrees: float = 2.0, seed: int = 1, **kwargs: object) -> VirtualCharger:
    """A charger whose target is (x, y) mm and some degrees off from where the goal says."""
    target = TargetParameters(x=x * MILLIMETRE, y=y * MILLIMETRE, roll=math.radians(degrees))
    world = WorldParameters(target=target, **{k: v for k, v in kwargs.items() if k in ("circuit", "servo", "contact")})
    return VirtualCharger(world, kwargs.get("parameters"), seed)


def assert_safe_at_home(run: VirtualCharger) -> None:
    """The contactor is open, nothing was ever shorted, the arm is back and its torque off."""
    truth, record = run.world.snapshot(), run.world.record
    assert not truth.contactor_closed
    assert truth.charge_current == 0.0
    assert record.energised_shorts == 0
    assert record.energised_unsafe == 0.0
    assert math.dist(truth.position, run.parameters.home) < 3 * MILLIMETRE
    assert not run.observe().torque_enabled
    assert run.machine.status.state is State.IDLE


def test_docks_charges_and_undocks() -> None:
    run = charger()
    outcome = run.dock()
    assert outcome.success, outcome.message
    assert outcome.code is Code.NONE
    assert outcome.aligned
    assert outcome.charge_current > 0.5
    assert 0.4 <= outcome.contact_current <= 0.5
    truth = run.world.snapshot()
    assert truth.contactor_closed
    assert max(abs(value) for value in truth.misalignment[:2]) < 3.0 * MILLIMETRE
    assert run.undock().success
    assert_safe_at_home(run)
    assert run.states[-4:] == [State.ENERGISE, State.CHARGING, State.RETRACT, State.IDLE]


@pytest.mark.parametrize(("x", "y"), [(8, 8), (-8, 8), (-8, -8), (8, -8)])
def test_targets_in_the_four_quadrants_converge(x: float, y: float) -> None:
    run = charger(x, y)
    outcome = run.dock()
    assert outcome.success, outcome.message
    assert outcome.aligned
    truth = run.world.snapshot()
    assert max(abs(value) for value in truth.misalignment[:2]) < 3.5 * MILLIMETRE


@pytest.mark.parametrize("degrees", [0, 1, -2, 3, -4, 5, -6, 7, -7])
def test_up_to_seven_degrees_charges(degrees: float) -> None:
    run = charger(degrees=degrees, seed=11)
    outcome = run.dock()
    assert outcome.success, outcome.message
    assert run.world.record.energised_unsafe == 0.0


@pytest.mark.parametrize("degrees", [8, -9, 10, -11, 11.5])
def test_between_eight_and_twelve_degrees_charges_or_refuses_but_never_shorts(degrees: float) -> None:
    run = charger(degrees=degrees, seed=12)
    outcome = run.dock()
    assert run.world.record.energised_shorts == 0
    assert run.world.record.energised_unsafe == 0.0
    if not outcome.success:
        assert outcome.code in (Code.CRITICAL_ANGLE, Code.MISALIGNED)
        assert_safe_at_home(run)


@pytest.mark.parametrize("degrees", [12, -12, 13, -15, 19, -24])
def test_from_twelve_degrees_on_it_is_refused_with_the_arm_back(degrees: float) -> None:
    run = charger(degrees=degrees, seed=13)
    outcome = run.dock()
    assert not outcome.success
    assert outcome.code in (Code.CRITICAL_ANGLE, Code.ESTIMATE_UNSURE, Code.NO_TACTILE_CONTACT)
    assert run.world.record.energised == 0.0
    assert_safe_at_home(run)


def test_a_rolled_detection_is_refused_before_contact() -> None:
    run = charger()
    outcome = run.dock(DockGoal(Detection((0.0, 0.0, 0.080), math.radians(10), math.radians(1.2))))
    assert outcome.code is Code.CRITICAL_ANGLE
    assert run.world.record.contacts == 0
    assert_safe_at_home(run)


def test_a_lowered_critical_angle_refuses_what_would_charge() -> None:
    run = charger(degrees=5)
    assert run.dock(DockGoal(GOAL, critical_angle=math.radians(4))).code is Code.CRITICAL_ANGLE
    assert_safe_at_home(run)


@pytest.mark.parametrize("stiffness", [2.5, 10.0, 20.0])
@pytest.mark.parametrize("z", [-8.0, 0.0, 8.0])
def test_the_guarded_approach_rests_in_the_band_whatever_the_stiffness_and_depth(stiffness: float, z: float) -> None:
    target = TargetParameters(z=0.080 + z * MILLIMETRE)
    run = VirtualCharger(WorldParameters(target=target, servo=ServoParameters(stiffness=stiffness)))
    outcome = run.dock(DockGoal(GOAL, start_charging=False))
    assert outcome.success, outcome.message
    assert 0.4 <= outcome.contact_current <= 0.5


def test_paper_steps_overshoot_the_band_on_a_stiff_arm_and_guarded_ones_do_not() -> None:
    resting = {"paper": [], "guarded": []}
    for approach, found in resting.items():
        for z in (0.0, 1.0, 2.0, 3.0, 4.0):
            target = TargetParameters(z=0.083 + z * MILLIMETRE)
            parameters = DockingParameters(approach=approach, servo_stiffness=20.0)
            world = WorldParameters(target=target, servo=ServoParameters(stiffness=20.0))
            run = VirtualCharger(world, parameters)
            found.append(run.dock(DockGoal(GOAL, start_charging=False)).contact_current)
    assert all(0.4 <= value <= 0.5 for value in resting["guarded"])
    assert not all(value <= 0.5 for value in resting["paper"])


def test_a_target_nearer_than_told_is_backed_off_from_once() -> None:
    parameters = DockingParameters(approach="paper")
    target = TargetParameters(z=0.068)
    run = VirtualCharger(WorldParameters(target=target), parameters)
    run.dock(DockGoal(GOAL, start_charging=False))
    assert State.BACK_OFF in run.states


@pytest.mark.parametrize(("signal", "code"), [("sum", Code.NO_TACTILE_CONTACT), ("contact", Code.NO_CONTACT)])
def test_the_raw_sum_of_currents_reads_docked_in_free_air(signal: str, code: Code) -> None:
    nothing = WorldParameters(target=TargetParameters(present=False))
    run = VirtualCharger(nothing, DockingParameters(current_signal=signal, current_min=0.3))
    assert run.dock().code is code


@pytest.mark.parametrize("state", PHASES)
def test_cancel_in_every_phase(state: State) -> None:
    run = charger(6, 6)
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is state, 60.0)
    run.machine.cancel()
    outcome = run.finish(30.0)
    assert outcome.code is Code.CANCELED
    assert outcome.retriable
    assert_safe_at_home(run)
    assert run.dock().success, "the next goal is served"


def test_cancel_while_holding() -> None:
    run = charger()
    run.begin(DockGoal(GOAL, hold=True))
    run.until(lambda: run.machine.status.charging, 120.0)
    run.run(2.0)
    assert run.outcome is None
    run.machine.cancel()
    assert run.finish(30.0).code is Code.CANCELED
    assert_safe_at_home(run)


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
    run = charger(6, 6)
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is state, 120.0)
    run.distort = lambda observation: replace(observation, **fault)
    watched = {
        Code.POWER_STALE: state in (State.ENERGISE, State.CHARGING),
        Code.TACTILE_STALE: state not in (State.ENERGISE, State.CHARGING),
    }
    if not watched.get(code, True):
        return
    run.until(lambda: run.machine.status.code is not Code.NONE, 5.0)
    assert run.machine.status.code is code
    run.run(0.1)
    assert not run.world.snapshot().contactor_closed
    run.distort = lambda observation: observation
    run.until(lambda: run.machine.status.state is State.IDLE, 30.0)
    assert not run.observe().torque_enabled


def moving_in(state: State, **kwargs: object) -> VirtualCharger:
    """A charger whose platform has just begun to move in that state; in ALIGN sideways, off the magnets."""
    run = charger(6, 6, **kwargs)
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is state, 60.0)
    if state is State.ALIGN:
        run.until(lambda: run.world.snapshot().position[0] > 1.0 * MILLIMETRE, 10.0)
    run.until(lambda: moves(run, 3 * TICK), 10.0)
    return run


def moves(run: VirtualCharger, seconds: float) -> bool:
    """Whether the platform moves by more than 5 mm/s in the `seconds` to come."""
    before = run.world.snapshot().position
    run.run(seconds)
    return math.dist(before, run.world.snapshot().position) > 0.005 * seconds


MOVING = [State.APPROACH, State.CONTACT, State.ALIGN]


@pytest.mark.parametrize("state", MOVING)
@pytest.mark.parametrize("fault", [{"servo_age": 0.15}, {"tactile_age": 0.15}])
def test_old_data_hold_the_arm_and_fresh_ones_let_it_go_on(state: State, fault: dict[str, float]) -> None:
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
def test_an_input_that_stays_away_holds_the_arm_first_and_ends_the_goal_then(
    state: State, fault: str, code: Code
) -> None:
    run = moving_in(state)
    since, z = run.now, run.world.snapshot().position[2]
    run.distort = lambda observation: replace(observation, **{fault: run.now - since})
    run.run(0.2)
    assert run.outcome is None
    assert not moves(run, 0.2)
    assert run.finish(20.0).code is code
    assert run.world.snapshot().position[2] < z + 3.0 * MILLIMETRE, "it was never carried on"


def test_an_arm_that_is_held_does_not_stop_the_clock() -> None:
    run = charger(parameters=DockingParameters(approach_timeout=3.0))
    run.begin(DockGoal(GOAL))
    run.until(lambda: moves(run, 3 * TICK), 10.0)
    run.distort = lambda observation: replace(observation, tactile_age=0.2)
    outcome = run.finish(30.0)
    assert outcome.code is Code.TIMEOUT
    assert_safe_at_home(run)


def test_the_way_back_needs_no_touch() -> None:
    run = moving_in(State.CONTACT)
    run.distort = lambda observation: replace(observation, tactile_age=9.0)
    assert run.finish(30.0).code is Code.TACTILE_STALE
    assert_safe_at_home(run)


def test_torque_lost_on_the_way_ends_the_goal_at_once() -> None:
    run = moving_in(State.APPROACH)
    run.distort = lambda observation: replace(observation, torque_enabled=False)
    assert run.finish(2.0).code is Code.SERVO_FAULT


@pytest.mark.parametrize(
    ("state", "stiffness"), [*((state, 15.0) for state in (*MOVING, State.RETRACT)), (State.APPROACH, 5.0)]
)
def test_motion_dies_with_the_machine(state: State, stiffness: float) -> None:
    servo = ServoParameters(stiffness=stiffness)
    if state is State.RETRACT:
        run = charger(servo=servo)
        assert run.dock().success
        run.outcome = None
        run.machine.start_undock("", run.observe())
        run.until(lambda: moves(run, 3 * TICK), 10.0)
    else:
        run = moving_in(state, servo=servo)
    energise = run._energised
    run.machine.step = lambda observation: Command(energise=energise)  # type: ignore[method-assign]
    run.run(0.2)
    assert not moves(run, 0.1)
    assert not moves(run, 1.0)


def test_a_pull_dies_with_the_machine_even_when_it_has_just_come_off() -> None:
    for ticks in range(1, 9):
        run = charger(6, 6)
        run.begin(DockGoal(GOAL))
        run.until(lambda run=run: run.machine.status.state is State.ALIGN, 60.0)  # type: ignore[misc]
        run.run((ticks - 0.5) * TICK)
        run.machine.step = lambda observation: Command()  # type: ignore[method-assign]
        run.run(0.3)
        assert not moves(run, 0.2)
        assert max(run._bound) < 1.5, "no servo goes on pulling"


def test_contact_lost_while_charging_opens_within_a_tenth_of_a_second() -> None:
    run = charger()
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
def test_what_the_probe_and_the_stage_find_ends_docking(circuit: dict[str, float], code: Code) -> None:
    run = charger(circuit=CircuitParameters(**circuit))
    outcome = run.dock()
    assert not outcome.success
    assert outcome.code is code
    assert_safe_at_home(run)


def test_a_welded_contactor_is_told_and_the_arm_stays() -> None:
    run = charger(circuit=CircuitParameters(welded=True))
    assert run.dock().success
    outcome = run.undock()
    assert outcome.code is Code.CONTACTOR_WELDED
    assert run.world.snapshot().contact_force > 0.0, "pulling live electrodes apart would draw an arc"


def test_nothing_there_is_no_contact() -> None:
    run = VirtualCharger(WorldParameters(target=TargetParameters(present=False)))
    assert run.dock().code is Code.NO_CONTACT
    assert_safe_at_home(run)


def test_pads_that_miss_are_no_tactile_contact() -> None:
    run = charger(y=18.0)
    outcome = run.dock()
    assert outcome.code is Code.NO_TACTILE_CONTACT
    assert run.world.record.energised == 0.0
    assert_safe_at_home(run)


def test_a_pad_that_lost_its_ridge_still_tells_the_direction() -> None:
    run = charger(x=25.0, y=0.0)
    outcome = run.dock()
    assert outcome.success, outcome.message
    assert max(abs(value) for value in run.world.snapshot().misalignment[:2]) < 3.5 * MILLIMETRE


def test_an_unsure_estimate_is_measured_again_by_docking_once_more_then_given_up() -> None:
    run = charger(0, 0)

    def doubt(reply: Reply) -> Reply:
        assert reply.estimate is not None
        return replace(reply, estimate=replace(reply.estimate, sure=False))

    run.answer[Service.ESTIMATE] = doubt
    assert run.dock().code is Code.ESTIMATE_UNSURE
    assert run.world.record.contacts == 2
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
@pytest.mark.parametrize("silent", [True, False])
def test_services_that_fail_or_never_answer(service: Service, code: Code, silent: bool) -> None:
    run = charger()
    run.answer[service] = lambda reply: None if silent else Reply(reply.number, False, "out of order")
    outcome = run.dock()
    assert outcome.code is code
    run.until(lambda: run.machine.status.state is State.IDLE, 30.0)
    assert not run.world.snapshot().contactor_closed


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        (DockGoal(Detection((math.nan, 0, 0.08), 0.0)), Rejected),
        (DockGoal(Detection((0, 0, 0.08), math.nan)), Rejected),
        (DockGoal(GOAL, critical_angle=-0.1), Rejected),
        (DockGoal(GOAL, critical_angle=math.nan), Rejected),
        (DockGoal(GOAL, critical_angle=0.3), Rejected),
        (DockGoal(GOAL, stop_energy=math.inf), Rejected),
        (DockGoal(GOAL, stop_after=-1.0), Rejected),
        (DockGoal(Detection((0.3, 0, 0.08), 0.0)), Unreachable),
        (DockGoal(Detection((0, 0, 0.5), 0.0)), Unreachable),
    ],
)
def test_goals_that_cannot_be_served_move_nothing(goal: DockGoal, error: type[Exception]) -> None:
    run = charger()
    with pytest.raises(error):
        run.begin(goal)
    run.run(0.5)
    assert math.dist(run.world.snapshot().position, run.parameters.home) < MILLIMETRE


def test_a_second_goal_is_refused_and_leaves_the_first_alone() -> None:
    run = charger()
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is State.CONTACT, 60.0)
    with pytest.raises(Busy):
        run.machine.start_dock(DockGoal(GOAL), run.observe())
    with pytest.raises(Busy):
        run.machine.start_undock("", run.observe())
    assert run.finish(120.0).success


def test_docking_when_docked_and_undocking_when_undocked_succeed_at_once() -> None:
    run = charger()
    assert run.dock().success
    contacts, start = run.world.record.contacts, run.now
    assert run.dock().success
    assert run.now - start < 0.1
    assert run.world.record.contacts == contacts
    assert run.undock().success
    assert run.undock().success
    assert_safe_at_home(run)


def test_stop_after_ends_charging_and_keeps_the_contact() -> None:
    run = charger()
    outcome = run.dock(DockGoal(GOAL, hold=True, stop_after=3.0))
    assert outcome.success
    assert outcome.energy > 0.0
    truth = run.world.snapshot()
    assert not truth.contactor_closed
    assert truth.contact_force > 0.0


def test_stop_energy_ends_charging() -> None:
    run = charger()
    outcome = run.dock(DockGoal(GOAL, hold=True, stop_energy=500.0))
    assert outcome.success
    assert 500.0 <= outcome.energy < 600.0


def test_emergency_leaves_everything_off() -> None:
    run = charger()
    assert run.dock().success
    command = run.machine.emergency()
    assert not command.energise
    assert command.trajectory == ()
    assert not run.machine.busy


def test_the_camera_is_asked_when_no_pose_is_given() -> None:
    run = charger()
    assert run.dock(DockGoal(None)).success
    assert run.states[0] is State.LOCATE


@pytest.mark.parametrize(
    ("reply", "code"),
    [
        (Reply(0, False, "nothing seen"), Code.ELECTRODES_NOT_FOUND),
        (Reply(0, True, detection=Detection((0, 0, 0.08), 0.0, 0.0, 9.0)), Code.DETECTION_STALE),
        (Reply(0, True, detection=Detection((0, 0.2, 0.3), 0.0)), Code.UNREACHABLE),
        (None, Code.ELECTRODES_NOT_FOUND),
    ],
)
def test_what_the_camera_cannot_support_leaves_the_arm_unmoved(reply: Reply | None, code: Code) -> None:
    run = charger()
    run.answer[Service.DETECT] = lambda asked: None if reply is None else replace(reply, number=asked.number)
    outcome = run.dock(DockGoal(None))
    assert outcome.code is code
    assert math.dist(run.world.snapshot().position, run.parameters.home) < MILLIMETRE
    if code is Code.UNREACHABLE:
        assert outcome.suggested_base == pytest.approx((0.0, 0.2, 0.22))


def test_every_observation_is_survived() -> None:
    """Whatever the topics say, the machine answers; a machine that raises would leave a goal hanging."""
    blank = Observation(time=0.0)
    run = charger()
    run.begin(DockGoal(GOAL))
    run.distort = lambda observation: replace(blank, time=observation.time, replies=observation.replies)
    outcome = run.finish(60.0)
    assert outcome.code is Code.SERVO_FAULT
