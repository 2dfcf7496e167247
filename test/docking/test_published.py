# SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 as published: classes move the arm and zero ends the loop; clearance counts only if required."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import pytest

from deltacharger_docking.clearance import MisalignmentClasses
from deltacharger_docking.codes import Code, Rejected, State
from deltacharger_docking.observation import Command, Decision, DockGoal, Observation, Reply, Request, Service
from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.campaigns.virtual_charger import GOAL, VirtualCharger
from deltacharger_sim.parameters import TargetParameters, WorldParameters

from .dockings import MILLIMETRE, assert_safe_at_home, felt_as, quick_charger

Step = tuple[float, float]
ZERO: Step = (0.0, 0.0)
RULE = {"published_clearance_rule": True}


class Scripted:
    """Decisions and estimates of a docking; its estimates have scripted classes in place of the CNN's.

    Attributes:
        offsets: (horizontal, vertical) mm of successive estimates; the last one is repeated.
        degrees: of the angle's class.
        felt: replaces these values of each estimate.
        places: x, y of the platform (m) at each estimate.
        models: whose classes were requested.
    """

    def __init__(self, run: VirtualCharger, offsets: list[Step], degrees: float = 1.0, **felt: Any) -> None:
        self.run, self.offsets, self.degrees, self.felt = run, offsets, degrees, felt
        self.places: list[tuple[float, float]] = []
        self.models: list[str] = []
        self.decisions: list[Decision] = []
        run.answer[Service.ESTIMATE] = self._answer
        run._follow = self._follow  # type: ignore[method-assign]
        self._carry_out = type(run)._follow

    def _follow(self, command: Command) -> None:
        self.decisions.extend(command.decisions)
        self.models.extend(each.model for each in command.requests if each.service is Service.ESTIMATE)
        self._carry_out(self.run, command)

    def _answer(self, reply: Reply) -> Reply:
        assert reply.estimate is not None
        x, y, _ = self.run.world.snapshot().position
        self.places.append((x, y))
        horizontal, vertical = self.offsets.pop(0) if len(self.offsets) > 1 else self.offsets[0]
        classes = MisalignmentClasses(math.radians(self.degrees), vertical * MILLIMETRE, horizontal * MILLIMETRE)
        return replace(reply, estimate=felt_as(reply.estimate, classes=classes, **self.felt))

    def of(self, kind: str) -> list[Decision]:
        return [each for each in self.decisions if each.kind == kind]


def published(*offsets: Step, place: tuple[float, ...] = (0.0, 0.0, 2.0), **more: Any) -> Scripted:
    """A charger of `approach: published` with its scripted estimates and these parameters."""
    parameters = {"approach": "published", **more.pop("parameters", {})}
    return Scripted(quick_charger(*place, parameters=parameters), list(offsets) or [ZERO], **more)


def test_the_arm_moves_by_exactly_the_centres_until_both_classes_are_zero() -> None:
    scripted = published((5.0, -10.0), (-5.0, 0.0), ZERO, place=(0.0, -8.0, 1.0))
    outcome = scripted.run.dock()
    assert outcome.success, outcome.message
    assert (outcome.alignments, outcome.redockings, outcome.aligned) == (2, 0, True)
    moved = [tuple(value for _, value in each.values) for each in scripted.of("move")]
    assert moved == [(5 * MILLIMETRE, -10 * MILLIMETRE), (-5 * MILLIMETRE, 0.0)]
    (x, y), (a, b), (c, d) = scripted.places
    assert (a - x, b - y) == pytest.approx((0.005, -0.010), abs=0.6 * MILLIMETRE)
    assert (c - a, d - b) == pytest.approx((-0.005, 0.0), abs=0.6 * MILLIMETRE)
    assert set(scripted.models) == {"cnn"}


def test_zero_classes_at_first_cause_no_move_with_any_estimate() -> None:
    scripted = published(place=(4.0, 3.0, 2.0), sure=False, horizontal=0.004, vertical=0.003)
    outcome = scripted.run.dock()
    assert outcome.success, outcome.message
    assert (outcome.alignments, scripted.run.world.record.contacts, len(scripted.places)) == (0, 1, 1)


def test_after_fifteen_moves_charging_starts_despite_contradicting_estimates() -> None:
    scripted = published(*[(5.0, 0.0), (-5.0, 0.0)] * 8, (5.0, 0.0))
    outcome = scripted.run.dock()
    assert outcome.success, outcome.message
    assert (outcome.alignments, outcome.redockings, outcome.aligned) == (15, 0, False)
    assert not scripted.of("contradiction")
    assert not scripted.of("verdict")


def test_a_class_that_is_not_below_the_critical_angle_is_refused_before_any_move() -> None:
    scripted = published((5.0, 5.0), degrees=5.0)
    outcome = scripted.run.dock(DockGoal(GOAL, critical_angle=math.radians(4.0)))
    assert outcome.code is Code.CRITICAL_ANGLE
    assert outcome.alignments == 0
    assert scripted.run.world.record.energised == 0.0
    assert_safe_at_home(scripted.run)


def test_classes_end_at_five_degrees_so_only_the_probe_finds_the_short() -> None:
    scripted = published(place=(0.0, 0.0, 14.0), degrees=5.0)
    assert scripted.run.dock().code is Code.SHORT_CIRCUIT
    assert scripted.run.world.record.energised == 0.0
    assert_safe_at_home(scripted.run)


def test_all_zero_tactile_frames_end_it_before_and_while_charging() -> None:
    scripted = published(contact=False)
    assert scripted.run.dock().code is Code.NO_TACTILE_CONTACT
    assert_safe_at_home(scripted.run)
    scripted = published()
    assert scripted.run.dock().success
    scripted.run.distort = lambda observation: replace(observation, tactile_contact=False)
    scripted.run.until(lambda: scripted.run.machine.status.code is Code.NO_TACTILE_CONTACT, 3.0)
    scripted.run.distort = lambda observation: observation
    scripted.run.until(lambda: scripted.run.machine.status.state is State.IDLE, 20.0)
    assert_safe_at_home(scripted.run)


def test_missing_tactile_frames_end_charging() -> None:
    scripted = published()
    assert scripted.run.dock().success
    scripted.run.distort = lambda observation: replace(observation, tactile_age=1.0)
    scripted.run.until(lambda: scripted.run.machine.status.code is Code.TACTILE_STALE, 3.0)
    scripted.run.distort = lambda observation: observation
    scripted.run.until(lambda: scripted.run.machine.status.state is State.IDLE, 20.0)
    assert_safe_at_home(scripted.run)


@pytest.mark.parametrize("axis", [item.name for item in fields(MisalignmentClasses)])
def test_a_missing_class_is_refused_by_name(axis: str) -> None:
    scripted = published()

    def lose(reply: Reply) -> Reply:
        estimate = scripted._answer(reply).estimate
        assert estimate is not None
        assert estimate.classes is not None
        return replace(reply, estimate=replace(estimate, classes=replace(estimate.classes, **{axis: math.nan})))

    scripted.run.answer[Service.ESTIMATE] = lose
    outcome = scripted.run.dock()
    assert outcome.code is Code.ESTIMATE_UNSURE
    assert f"{axis}_probability" in outcome.message
    assert_safe_at_home(scripted.run)


def test_an_estimate_without_any_classes_is_refused() -> None:
    scripted = published()
    scripted.run.answer.clear()
    outcome = scripted.run.dock()
    assert outcome.code is Code.ESTIMATE_UNSURE
    assert "angle, vertical, horizontal" in outcome.message


def test_as_published_current_flows_even_without_clearance() -> None:
    wide = {"angle": math.radians(10.0), "vertical": 0.002}
    scripted = published(**wide)
    assert scripted.run.dock().success
    scripted.run.run(3.0 * scripted.run.parameters.clearance_period)
    assert scripted.run.machine.status.charging, "nor does a watch over clearance end it"
    assert len(scripted.places) == 1
    with_rule = published(parameters=RULE, **wide)
    outcome = with_rule.run.dock()
    assert outcome.code in (Code.MISALIGNED, Code.CRITICAL_ANGLE)
    assert with_rule.run.world.record.energised == 0.0
    assert_safe_at_home(with_rule.run)


@pytest.mark.parametrize(
    ("felt", "code", "contacts"),
    [
        ({"angle": 0.0, "vertical": 0.0}, Code.NONE, 1),
        ({"angle": math.radians(7.5), "vertical": 0.0, "angle_stddev": 0.013}, Code.NONE, 2),
        ({"angle": math.radians(7.0), "vertical": 0.004}, Code.MISALIGNED, 1),
        ({"angle": math.radians(13.0)}, Code.CRITICAL_ANGLE, 1),
        ({"sure": False}, Code.ESTIMATE_UNSURE, 1),
    ],
)
def test_with_our_rule_the_estimate_decides_about_clearance_not_the_classes(
    felt: dict[str, Any], code: Code, contacts: int
) -> None:
    scripted = published(parameters=RULE, **felt)
    outcome = scripted.run.dock()
    assert outcome.code is code, outcome.message
    assert scripted.run.world.record.contacts == contacts
    assert outcome.alignments == 0


def test_with_our_rule_lost_clearance_ends_charging() -> None:
    scripted = published(parameters=RULE)
    assert scripted.run.dock().success
    scripted.felt = {"vertical": 0.008}
    scripted.run.until(lambda: scripted.run.machine.status.code is Code.CRITICAL_ANGLE, 10.0)
    scripted.run.until(lambda: scripted.run.machine.status.state is State.IDLE, 20.0)
    assert_safe_at_home(scripted.run)


def unproven(observation: Observation) -> Observation:
    return replace(observation, simulated=False)


def real(scripted: Scripted) -> Scripted:
    """The same charger, not known to be simulated."""
    run, observe = scripted.run, scripted.run.observe
    run.observe = lambda: unproven(observe())  # type: ignore[method-assign]
    return scripted


def test_goals_that_charge_are_refused_if_hardware_is_not_proven_simulated() -> None:
    scripted = real(published())
    with pytest.raises(Rejected, match="published_clearance_rule"):
        scripted.run.begin(DockGoal(GOAL))
    scripted.run.run(0.5)
    assert math.dist(scripted.run.world.snapshot().position, scripted.run.parameters.home) < MILLIMETRE
    assert scripted.run.dock(DockGoal(GOAL, start_charging=False)).success
    with pytest.raises(Rejected):
        scripted.run.begin(DockGoal(GOAL))
    scripted.run.run(0.5)
    assert scripted.run.world.record.energised == 0.0
    assert scripted.run.machine.status.docked
    with_rule = real(published(parameters=RULE))
    assert with_rule.run.dock().success


def test_hardware_that_is_no_longer_proven_keeps_the_contactor_open() -> None:
    scripted = published()
    scripted.run.begin(DockGoal(GOAL))
    scripted.run.until(lambda: scripted.run.machine.status.state is State.MEASURE, 30.0)
    scripted.run.distort = unproven
    assert scripted.run.finish(60.0).code is Code.REJECTED
    assert scripted.run.world.record.energised == 0.0
    assert_safe_at_home(scripted.run)


CANCELS = (State.APPROACH, State.CONTACT, State.MEASURE, State.ALIGN, State.ENERGISE)
FAULTS = (State.CONTACT, State.ALIGN, State.ENERGISE, State.CHARGING)
ENDS = [
    *((state, {}, Code.CANCELED) for state in CANCELS),
    *((state, {"hardware_error": 32}, Code.SERVO_FAULT) for state in FAULTS),
]


@pytest.mark.parametrize(("state", "fault", "code"), ENDS)
def test_after_a_cancel_or_fault_in_any_phase_the_contactor_opens_before_the_torque_goes(
    state: State, fault: dict[str, Any], code: Code
) -> None:
    scripted = published((5.0, 0.0), ZERO)
    run, seen = scripted.run, list[tuple[bool, bool]]()
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is state, 60.0)
    if fault:
        run.distort = lambda observation: replace(observation, **fault)
    else:
        run.machine.cancel()
    accept = run._accept

    def note(request: Request) -> None:
        if request.service is Service.TORQUE_OFF:
            truth = run.world.snapshot()
            seen.append((truth.contactor_closed, truth.charge_current > 0.5))
        accept(request)

    run._accept = note  # type: ignore[method-assign]
    run.until(lambda: run.machine.status.code is code and run.machine.status.state is State.IDLE, 60.0)
    assert seen
    assert not any(map(any, seen))
    assert not run.world.snapshot().contactor_closed
    assert run.world.record.parted_live == 0


def test_a_goal_that_charges_a_docked_target_measures_its_classes_in_place() -> None:
    scripted = published((5.0, 0.0), ZERO)
    assert scripted.run.dock(DockGoal(GOAL, start_charging=False)).success
    contacts = scripted.run.world.record.contacts
    outcome = scripted.run.dock()
    assert outcome.success, outcome.message
    assert (scripted.run.world.record.contacts, len(scripted.places)) == (contacts, 3)


def test_a_goal_that_lowers_the_critical_angle_ends_charging_above_it() -> None:
    scripted = published(degrees=3.0)
    assert scripted.run.dock().success
    assert scripted.run.dock(DockGoal(GOAL, critical_angle=math.radians(4.0))).success
    assert scripted.run.dock(DockGoal(GOAL, critical_angle=math.radians(2.0))).code is Code.CRITICAL_ANGLE
    assert_safe_at_home(scripted.run)


def test_the_raw_sum_of_currents_reads_docked_in_free_air_here_too() -> None:
    nothing = WorldParameters(target=TargetParameters(present=False))
    run = VirtualCharger(nothing, DockingParameters(approach="published", current_signal="sum", current_min=0.3))
    assert run.dock().code is Code.NO_TACTILE_CONTACT
    assert_safe_at_home(run)
