# SPDX-License-Identifier: Apache-2.0
"""Docking scenarios in virtual time: what happens and how it ends."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import pytest

from deltacharger_docking.codes import Code, Rejected, State, Unreachable
from deltacharger_docking.observation import BasePose, DockGoal, ElectrodePose, Reply, Service
from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.campaigns.virtual_charger import GOAL, VirtualCharger
from deltacharger_sim.parameters import ServoParameters, TargetParameters, WorldParameters

from ..marks import rest
from .dockings import MILLIMETRE, assert_safe_at_home, charger


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
    horizontal, vertical = truth.misalignment[:2]
    assert abs(vertical) < 2.5 * MILLIMETRE, "tolerance and half a millimetre of estimate, and a millimetre of jitter"
    assert abs(horizontal) < 5.0 * MILLIMETRE, "tolerance and three standard deviations of the estimate"
    assert run.undock().success
    assert_safe_at_home(run)
    assert run.states[-4:] == [State.ENERGISE, State.CHARGING, State.RETRACT, State.IDLE]


@pytest.mark.parametrize(("x", "y"), [(8, 8), rest(-8, 8), rest(-8, -8), rest(8, -8)])
def test_targets_in_the_four_quadrants_converge(x: float, y: float) -> None:
    run = charger(x, y)
    outcome = run.dock()
    assert outcome.success, outcome.message
    assert outcome.aligned
    truth = run.world.snapshot()
    assert max(abs(value) for value in truth.misalignment[:2]) < 3.5 * MILLIMETRE


@pytest.mark.parametrize("degrees", [0, rest(1), rest(-2), rest(3), rest(-4), rest(5), rest(-6), 7, rest(-7)])
def test_up_to_seven_degrees_charges(degrees: float) -> None:
    run = charger(degrees=degrees, seed=11)
    outcome = run.dock()
    assert outcome.success, outcome.message
    assert run.world.record.energised_unsafe == 0.0


@pytest.mark.parametrize("degrees", [8, rest(-9), rest(10), rest(-11), 11.5])
def test_between_eight_and_twelve_degrees_charges_or_refuses_but_never_shorts(degrees: float) -> None:
    run = charger(degrees=degrees, seed=12)
    outcome = run.dock()
    assert run.world.record.energised_shorts == 0
    assert run.world.record.energised_unsafe == 0.0
    if not outcome.success:
        assert outcome.code in (Code.CRITICAL_ANGLE, Code.MISALIGNED)
        assert_safe_at_home(run)


@pytest.mark.parametrize("degrees", [12, -12, rest(13), rest(-15), rest(19), -24])
def test_targets_from_twelve_degrees_on_are_refused_with_the_arm_home(degrees: float) -> None:
    run = charger(degrees=degrees, seed=13)
    outcome = run.dock()
    assert not outcome.success
    assert outcome.code in (Code.CRITICAL_ANGLE, Code.ESTIMATE_UNSURE, Code.NO_TACTILE_CONTACT)
    assert run.world.record.energised == 0.0
    assert_safe_at_home(run)


def test_a_rolled_detection_is_refused_before_contact() -> None:
    run = charger()
    outcome = run.dock(DockGoal(ElectrodePose((0.0, 0.0, 0.080), math.radians(10), math.radians(1.2))))
    assert outcome.code is Code.CRITICAL_ANGLE
    assert run.world.record.contacts == 0
    assert_safe_at_home(run)


def test_a_lowered_critical_angle_refuses_what_would_charge() -> None:
    run = charger(degrees=5)
    assert run.dock(DockGoal(GOAL, critical_angle=math.radians(4))).code is Code.CRITICAL_ANGLE
    assert_safe_at_home(run)


@pytest.mark.parametrize(
    ("z", "stiffness"),
    [(-8.0, 20.0), (0.0, 10.0), (8.0, 2.5), *(rest(z, s) for z, s in product((-8.0, 0.0, 8.0), (2.5, 10.0, 20.0)))],
)
def test_the_guarded_approach_rests_in_the_band_whatever_the_stiffness_and_depth(stiffness: float, z: float) -> None:
    target = TargetParameters(z=0.080 + z * MILLIMETRE)
    run = VirtualCharger(WorldParameters(target=target, servo=ServoParameters(stiffness=stiffness)))
    outcome = run.dock(DockGoal(GOAL, start_charging=False))
    assert outcome.success, outcome.message
    assert 0.4 <= outcome.contact_current <= 0.5


@pytest.mark.rest
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


def test_the_arm_backs_off_once_from_a_target_nearer_than_given() -> None:
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
    assert_safe_at_home(run)


def test_pads_that_miss_give_no_tactile_contact() -> None:
    run = charger(y=18.0)
    outcome = run.dock()
    assert outcome.code is Code.NO_TACTILE_CONTACT
    assert run.world.record.energised == 0.0
    assert_safe_at_home(run)


@pytest.mark.parametrize("y", [14.0, -14.0])
def test_a_pad_that_lost_its_ridge_still_shows_the_direction_across_the_bars(y: float) -> None:
    run = charger(x=0.0, y=y)
    outcome = run.dock()
    assert outcome.success, outcome.message
    assert outcome.alignments >= 1
    assert max(abs(value) for value in run.world.snapshot().misalignment[:2]) < 3.5 * MILLIMETRE


@pytest.mark.parametrize("yaw_stddev", [math.radians(1.2), 0.0], ids=["may lean", "parallel"])
def test_a_pad_without_load_causes_no_move_along_the_bars_since_a_lean_may_empty_it(yaw_stddev: float) -> None:
    run = charger(x=25.0, y=0.0, parameters={"yaw_stddev": yaw_stddev})
    outcome = run.dock()
    assert outcome.code is Code.ESTIMATE_UNSURE  # this far away the magnets hardly pull, so it is not a lean
    assert outcome.alignments == 0
    assert run.world.record.energised == 0.0
    assert_safe_at_home(run)


def test_after_an_unsure_estimate_contact_is_repeated_once_and_then_fails() -> None:
    run = charger(0, 0)

    def doubt(reply: Reply) -> Reply:
        assert reply.estimate is not None
        return replace(reply, estimate=replace(reply.estimate, sure=False))

    run.answer[Service.ESTIMATE] = doubt
    assert run.dock().code is Code.ESTIMATE_UNSURE
    assert run.world.record.contacts == 2
    assert_safe_at_home(run)


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        (DockGoal(ElectrodePose((math.nan, 0, 0.08), 0.0)), Rejected),
        (DockGoal(ElectrodePose((0, 0, 0.08), math.nan)), Rejected),
        (DockGoal(ElectrodePose((0, 0, 0.08), 0.0, yaw=math.inf)), Rejected),
        (DockGoal(ElectrodePose((0, 0, 0.08), 0.0, pitch=-math.inf)), Rejected),
        (DockGoal(GOAL, critical_angle=-0.1), Rejected),
        (DockGoal(GOAL, critical_angle=math.nan), Rejected),
        (DockGoal(GOAL, critical_angle=0.3), Rejected),
        (DockGoal(GOAL, stop_energy=math.inf), Rejected),
        (DockGoal(GOAL, stop_after=-1.0), Rejected),
        (DockGoal(ElectrodePose((0.3, 0, 0.08), 0.0)), Unreachable),
        (DockGoal(ElectrodePose((0, 0, 0.5), 0.0)), Unreachable),
    ],
)
def test_impossible_goals_move_nothing(goal: DockGoal, error: type[Exception]) -> None:
    run = charger()
    with pytest.raises(error):
        run.begin(goal)
    run.run(0.5)
    assert math.dist(run.world.snapshot().position, run.parameters.home) < MILLIMETRE


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


def test_the_camera_is_asked_when_no_pose_is_given() -> None:
    run = charger()
    assert run.dock(DockGoal(None)).success
    assert run.states[0] is State.LOCATE


@pytest.mark.parametrize(
    ("reply", "code"),
    [
        (Reply(0, False, "nothing seen"), Code.ELECTRODES_NOT_FOUND),
        (Reply(0, True, detection=ElectrodePose((0, 0, 0.08), 0.0, 0.0, 9.0)), Code.DETECTION_STALE),
        (Reply(0, True, detection=ElectrodePose((0, 0.2, 0.3), 0.0)), Code.UNREACHABLE),
        (None, Code.ELECTRODES_NOT_FOUND),
    ],
)
def test_an_invalid_detection_moves_nothing(reply: Reply | None, code: Code) -> None:
    run = charger()
    run.answer[Service.DETECT] = lambda asked: None if reply is None else replace(reply, number=asked.number)
    outcome = run.dock(DockGoal(None))
    assert outcome.code is code
    assert math.dist(run.world.snapshot().position, run.parameters.home) < MILLIMETRE
    if code is Code.UNREACHABLE:
        assert outcome.suggested_base == BasePose(0.0, 0.2, pytest.approx(0.22))


def test_moves_are_reported_as_corrections_and_repeated_contacts() -> None:
    run = charger(seed=4, parameters={"redocking_gain_min": 0.0, "alignments_max": 4})
    outcome = run.dock()
    assert outcome.success, outcome.message
    assert (outcome.alignments + outcome.redockings, outcome.aligned) == (4, False), "no gain is too small"
    assert outcome.alignments >= 1
    assert outcome.redockings >= 1


@pytest.mark.parametrize(("degrees", "seed"), [(10.0, 3), (10.5, 2), (11.0, 5), (11.5, 1)])
def test_a_refused_target_is_never_aligned(degrees: float, seed: int) -> None:
    outcome = charger(degrees=degrees, seed=seed, parameters={"alignments_max": 3}).dock()
    assert outcome.code in (Code.MISALIGNED, Code.CRITICAL_ANGLE)
    assert not outcome.aligned


@pytest.mark.parametrize(
    ("service", "name"), [(Service.ESTIMATE, "predict_misalignment"), (Service.PROBE, "probe"), (Service.TARE, "tare")]
)
def test_docking_reports_what_it_waits_for(service: Service, name: str) -> None:
    run = charger()
    run.answer[service] = lambda reply: None
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.waiting_for == name, 30.0)
    run.run(1.0)
    assert run.machine.status.waiting_for == name
    run.machine.cancel()
    assert run.finish(30.0).code is Code.CANCELED
    assert run.machine.status.waiting_for == ""


def test_nodes_without_messages_are_awaited_by_name() -> None:
    run = charger()
    run.distort = lambda observation: replace(observation, servo_age=math.inf, servos_valid=False)
    run.begin(DockGoal(GOAL))
    run.run(1.0)
    assert run.machine.status.waiting_for == "servo_state and tactile_frame"
    run.distort = lambda observation: observation
    run.until(lambda: run.machine.status.waiting_for == "", 5.0)
    assert run.finish(60.0).success
