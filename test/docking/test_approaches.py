# SPDX-License-Identifier: Apache-2.0
"""Docking otherwise: Algorithm 1 as published, and electrodes wired to the battery.

As published, classes move the arm and zero ends the loop; clearance counts only if required. Wired electrodes (power:
none) are live at every touch, measured early, and never reported as charging.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import pytest

from deltacharger_core.parameters import ParameterError
from deltacharger_docking.clearance import MisalignmentClasses
from deltacharger_docking.codes import Code, Rejected, State
from deltacharger_docking.observation import Command, Decision, DockGoal, Observation, Reply, Service
from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.campaigns.virtual_charger import GOAL, VirtualCharger
from deltacharger_sim.parameters import CircuitParameters, MagnetParameters, ServoParameters

from .dockings import (
    MILLIMETRE,
    assert_safe_at_home,
    commands,
    decisions,
    ends,
    feel,
    felt_as,
    quick_charger,
    reach,
    spoil,
)

Step = tuple[float, float]
ZERO: Step = (0.0, 0.0)
RULE = {"published_clearance_rule": True}


class Scripted:
    """A charger of `approach: published` whose estimates have scripted classes in place of the CNN's.

    Attributes:
        felt: replaces these values of each estimate.
        places: x, y of the platform (m) at each estimate.
        sent: the machine's commands.
    """

    def __init__(
        self, *offsets: Step, place: tuple[float, ...] = (0.0, 0.0, 2.0), degrees: float = 1.0, **more: Any
    ) -> None:
        parameters, coarse = {"approach": "published", **more.pop("parameters", {})}, more.pop("coarse", False)
        self.run = quick_charger(*place, parameters=parameters, coarse=coarse, **more.pop("world", {}))
        self._offsets, self._degrees, self.felt = list(offsets) or [ZERO], degrees, more
        self.places: list[tuple[float, float]] = []
        self.sent = commands(self.run)
        self.run.answer[Service.ESTIMATE] = self._answer

    def _answer(self, reply: Reply) -> Reply:
        assert reply.estimate is not None
        x, y, _ = self.run.world.snapshot().position
        self.places.append((x, y))
        horizontal, vertical = self._offsets.pop(0) if len(self._offsets) > 1 else self._offsets[0]
        classes = MisalignmentClasses(math.radians(self._degrees), vertical * MILLIMETRE, horizontal * MILLIMETRE)
        return replace(reply, estimate=felt_as(reply.estimate, **{"classes": classes, **self.felt}))


def test_the_arm_moves_by_exactly_the_centres_until_both_classes_are_zero() -> None:
    # The platform follows its command where gears do not hold it and wide magnets do not draw it aside.
    world = {"servo": ServoParameters(friction=0.0, friction_share=0.0), "magnets": MagnetParameters(width=0.1)}
    scripted = Scripted((5.0, -10.0), (-5.0, 0.0), ZERO, place=(0.0, -8.0, 1.0), coarse=True, world=world)
    outcome = scripted.run.dock()
    assert outcome.success, outcome.message
    assert (outcome.alignments, outcome.redockings, outcome.aligned) == (2, 0, True)
    moved = [tuple(value for _, value in each.values) for each in decisions(scripted.sent, "move")]
    assert moved == [(5 * MILLIMETRE, -10 * MILLIMETRE), (-5 * MILLIMETRE, 0.0)]
    (x, y), (a, b), (c, d) = scripted.places
    assert (a - x, b - y) == pytest.approx((0.005, -0.010), abs=0.6 * MILLIMETRE)
    assert (c - a, d - b) == pytest.approx((-0.005, 0.0), abs=0.6 * MILLIMETRE)
    asked = [each for command in scripted.sent for each in command.requests if each.service is Service.ESTIMATE]
    assert {each.model for each in asked} == {"cnn"}


def test_zero_classes_cause_no_move_with_any_estimate() -> None:
    scripted = Scripted(place=(4.0, 3.0, 2.0), sure=False, horizontal=0.004, vertical=0.003)
    outcome = scripted.run.dock()
    assert outcome.success, outcome.message
    assert (outcome.alignments, scripted.run.world.record.contacts, len(scripted.places)) == (0, 1, 1)


def test_after_its_moves_charging_starts_despite_contradicting_estimates() -> None:
    scripted = Scripted((5.0, 0.0), (-5.0, 0.0), (5.0, 0.0), parameters={"alignments_max": 2}, coarse=True)
    outcome = scripted.run.dock()
    assert outcome.success, outcome.message
    assert (outcome.alignments, outcome.redockings, outcome.aligned) == (2, 0, False)
    assert not {"contradiction", "verdict"} & {each.kind for each in decisions(scripted.sent)}


NAMES = ("angle", "vertical", "horizontal")
UNKNOWN = [replace(MisalignmentClasses(0.0, 0.0, 0.0), **{name: math.nan}) for name in NAMES]


@pytest.mark.parametrize(
    ("how", "limit", "code"),
    [
        ({"degrees": 5.0}, 4.0, Code.CRITICAL_ANGLE),
        ({"degrees": 5.0, "place": (0.0, 0.0, 14.0)}, 0.0, Code.SHORT_CIRCUIT),  # classes end at 5°: the probe finds it
        ({"contact": False}, 0.0, Code.NO_TACTILE_CONTACT),
        ({"classes": None}, 0.0, Code.ESTIMATE_UNSURE),
        *(({"classes": each}, 0.0, Code.ESTIMATE_UNSURE) for each in UNKNOWN),
    ],
)
def test_a_target_whose_classes_are_not_good_is_refused_without_a_move(
    how: dict[str, Any], limit: float, code: Code
) -> None:
    scripted = Scripted((5.0, 5.0) if limit else ZERO, **how)
    outcome = scripted.run.dock(DockGoal(GOAL, critical_angle=math.radians(limit)))
    assert (outcome.code, outcome.alignments) == (code, 0)
    assert scripted.run.world.record.energised == 0.0
    assert_safe_at_home(scripted.run)


@pytest.mark.parametrize(
    ("fault", "code"),
    [({"tactile_contact": False}, Code.NO_TACTILE_CONTACT), ({"tactile_age": 1.0}, Code.TACTILE_STALE)],
)
def test_pads_without_contact_or_frames_end_charging(fault: dict[str, Any], code: Code) -> None:
    scripted = Scripted()
    assert scripted.run.dock().success
    spoil(scripted.run, **fault)
    ends(scripted.run, code, 3.0)
    assert_safe_at_home(scripted.run)


def test_as_published_current_flows_even_without_clearance() -> None:
    scripted = Scripted(angle=math.radians(10.0), vertical=0.002)
    assert scripted.run.dock().success
    scripted.run.run(2.0 * scripted.run.parameters.clearance_period)
    assert scripted.run.machine.status.charging, "nor does a watch over clearance end it"
    assert len(scripted.places) == 1


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
    run = Scripted(parameters=RULE, **felt).run
    outcome = run.dock()
    assert outcome.code is code, outcome.message
    assert run.world.record.contacts == contacts
    assert outcome.alignments == 0
    assert outcome.success or run.world.record.energised == 0.0


def test_with_our_rule_lost_clearance_ends_charging() -> None:
    scripted = Scripted(parameters=RULE)
    assert scripted.run.dock().success
    scripted.felt = {"vertical": 0.008}
    ends(scripted.run, Code.CRITICAL_ANGLE)
    assert_safe_at_home(scripted.run)


def unproven(seen: Observation) -> Observation:
    return replace(seen, simulated=False)


def test_goals_that_charge_are_refused_if_hardware_is_not_proven_simulated() -> None:
    for parameters, refused in (({}, True), (RULE, False)):
        run = Scripted(parameters=parameters).run
        observe = run.observe
        run.observe = lambda observe=observe: unproven(observe())  # type: ignore[method-assign, misc]
        if not refused:
            assert run.dock().success
            continue
        with pytest.raises(Rejected, match="published_clearance_rule"):
            run.begin(DockGoal(GOAL))
        assert run.dock(DockGoal(GOAL, start_charging=False)).success
        with pytest.raises(Rejected):
            run.begin(DockGoal(GOAL))
        run.run(0.5)
        assert run.world.record.energised == 0.0
        assert run.machine.status.docked


def test_hardware_that_is_no_longer_proven_keeps_the_contactor_open() -> None:
    run = Scripted().run
    reach(run, State.MEASURE)
    run.distort = unproven
    assert run.finish(60.0).code is Code.REJECTED
    assert run.world.record.energised == 0.0
    assert_safe_at_home(run)


PRESSED = 0.3  # A of contact current that no touch reaches


class Wired:
    """A charger without a contactor, whose target is off by these mm and degrees, and whose commands are kept.

    Attributes:
        asked: the services that were called.
        decisions: in their order.
        pressed: largest contact current before retracting, A.
    """

    def __init__(
        self, *place: float, parameters: Mapping[str, Any] = MappingProxyType({}), coarse: bool = False, **circuit: Any
    ) -> None:
        wires = CircuitParameters(wired=True, **circuit)
        self.run = quick_charger(*place, parameters={"power": "none", **parameters}, circuit=wires, coarse=coarse)
        self.asked: list[Service] = []
        self.decisions: list[Decision] = []
        self.pressed = -math.inf
        self._follow = self.run._follow
        self.run._follow = self._keep  # type: ignore[method-assign]

    def _keep(self, command: Command) -> None:
        assert not command.energise
        self.asked += [request.service for request in command.requests]
        self.decisions += command.decisions
        self.pressed = max(self.pressed, self.run.machine.status.contact_current)
        assert not self.run.machine.status.charging
        self._follow(command)

    @property
    def kinds(self) -> list[str]:
        """Kinds of the decisions."""
        return [decision.kind for decision in self.decisions]

    def docked(self) -> VirtualCharger:
        """Dock; then current flows between two batteries."""
        outcome = self.run.dock()
        assert outcome.success, outcome
        assert self.run.world.snapshot().charge_current > 1.0
        return self.run


def assert_home(run: VirtualCharger) -> None:
    """The arm is home and limp, without contact."""
    truth = run.world.snapshot()
    assert truth.charge_current == 0.0
    assert math.dist(truth.position, run.parameters.home) < 0.003
    assert not run.observe().torque_enabled
    assert not run.machine.status.docked


def test_it_docks_and_aligns_and_reports_only_known_values() -> None:
    wired = Wired(
        6.0, 2.0, parameters={"overlap_loss_max": 0.004, "landing_limit": 0.0025}, coarse=True
    )  # as by default
    run = wired.docked()
    order = [kind for kind in wired.kinds if kind in ("touched", "contact")]
    assert order == ["touched", "contact"] * (len(order) // 2), "each first touch is measured before pressing"
    assert len(order) >= 4, "more than one contact"
    outcome, status = run.outcome, run.machine.status
    assert outcome is not None
    assert outcome.aligned
    assert 0.4 <= outcome.contact_current <= 0.5
    assert math.isnan(outcome.charge_current)
    assert math.isnan(outcome.energy)
    assert "power: none" in outcome.notice
    assert (status.docked, status.charging, status.state) == (True, False, State.IDLE)
    assert not {Service.PROBE, Service.OPEN} & set(wired.asked)
    spoil(run, power_age=math.inf)
    run.run(6.0)
    assert status.docked, "watched over, nothing is wrong, also without charger_power, which measures nothing"
    before, contacts = len(wired.decisions), run.world.record.contacts
    assert run.dock().success, "a further goal moves nothing"
    assert run.world.record.contacts == contacts
    assert set(wired.kinds[before:]) <= {"accepted", "ended"}
    assert run.undock().success
    assert_home(run)
    record = run.world.record
    assert record.energised_shorts == 0
    assert record.parted_live == record.contacts
    assert record.broken_current > 1.0, "nothing but the electrodes interrupts it"
    assert record.unpowered_live == 0


def test_a_tilt_measured_at_first_touch_is_not_pressed() -> None:
    wired = Wired(0.0, 0.0, 13.0)
    outcome = wired.run.dock()
    assert outcome.code is Code.CRITICAL_ANGLE
    assert math.isnan(outcome.energy)
    assert wired.run.world.record.contacts == 1
    assert wired.pressed < PRESSED
    assert "contact" not in wired.kinds
    assert_home(wired.run)


def test_an_offset_across_the_bars_is_corrected_before_pressing() -> None:
    wired = Wired(0.0, 12.0, 4.0)  # the magnets draw the electrodes to 9 mm
    wired.run.begin(DockGoal(GOAL))
    wired.run.until(lambda: "move" in wired.kinds, 60.0)
    assert wired.pressed < PRESSED
    assert "contact" not in wired.kinds
    assert wired.run.finish(120.0).success


def test_after_an_unsure_first_touch_it_presses_and_judges_then() -> None:
    wired = Wired(0.0, 0.0)
    feel(wired.run, times=1, angle=math.radians(2.0), sure=False)
    wired.docked()
    assert wired.kinds.index("contact") == wired.kinds.index("touched") + 1, "no verdict between"


def test_a_first_touch_with_a_tilt_beyond_the_limit_is_never_pressed_even_if_unsure() -> None:
    wired = Wired(0.0, 0.0)
    feel(wired.run, angle=math.radians(14.0), horizontal=0.0, vertical=0.0, sure=False)  # no place to look elsewhere
    assert wired.run.dock().code is Code.CRITICAL_ANGLE
    assert wired.run.world.record.contacts == 2, "one repeated contact"
    assert wired.pressed < PRESSED
    assert_home(wired.run)


def test_an_estimator_failure_at_first_touch_retracts_the_arm() -> None:
    wired = Wired()
    wired.run.answer[Service.ESTIMATE] = lambda reply: Reply(reply.number, False, "out of order")
    assert wired.run.dock().code is Code.TACTILE_STALE
    assert wired.pressed < PRESSED
    assert_home(wired.run)


@pytest.mark.parametrize("goal", [DockGoal(GOAL, start_charging=False), DockGoal(GOAL, stop_energy=100.0)])
@pytest.mark.parametrize("docked", [False, True])
def test_goals_that_need_a_contactor_are_refused(goal: DockGoal, docked: bool) -> None:
    wired = Wired()
    run = wired.docked() if docked else wired.run
    before = run.world.snapshot().position
    with pytest.raises(Rejected, match="power: none"):
        run.begin(goal)
    run.run(0.5)
    assert math.dist(run.world.snapshot().position, before) < 1e-4
    assert run.machine.status.docked == docked


@pytest.mark.parametrize("approach", ["paper", "published"])
def test_only_the_guarded_approach_may_dock_without_a_contactor(approach: str) -> None:
    with pytest.raises(ParameterError, match="guarded"):
        DockingParameters(power="none", approach=approach)


@pytest.mark.parametrize(
    ("wrong", "code", "within"),
    [
        ({"servo_age": 0.3}, Code.SERVO_FAULT, 0.1),
        ({"thermal_reserve": 0.0}, Code.SERVO_FAULT, 0.1),
        ({"tactile_age": 1.0}, Code.TACTILE_STALE, 0.1),
        ({"currents": (0.0, 0.0, 0.0)}, Code.NO_CONTACT, 0.3),
    ],
)
def test_a_docked_charger_is_supervised_as_while_charging(wrong: dict[str, Any], code: Code, within: float) -> None:
    run = Wired().docked()
    spoil(run, **wrong)
    ends(run, code, within)


def test_the_arm_retracts_after_docking_was_suspended_or_clearance_is_lost() -> None:
    run = Wired(coarse=True).docked()
    run.now += run.parameters.clearance_period + 2.0
    ends(run, Code.POWER_STALE, 0.1)
    assert_home(run)
    assert run.dock().success
    feel(run, angle=math.radians(11.0))
    ends(run, Code.CRITICAL_ANGLE, 2.5 * run.parameters.clearance_period)
    assert_home(run)


def test_with_a_second_source_it_does_not_touch() -> None:
    run = Wired(parameters={"duplicate_source_timeout": 2.0}).run
    spoil(run, duplicate_sources="servo_state: a and b")
    assert run.dock().code is Code.DUPLICATE_SOURCE
    assert run.world.record.contacts == 0
    assert State.MEASURE not in run.states
    assert_home(run)


@pytest.mark.parametrize("hold", [False, True])
def test_a_stop_condition_undocks_since_nothing_else_ends_the_current(hold: bool) -> None:
    run = Wired(coarse=True).run
    outcome = run.dock(DockGoal(GOAL, hold=hold, stop_after=3.0))
    assert outcome.success
    assert ("taken off" in outcome.notice) == hold
    assert run.machine.status.docked != hold
    run.until(lambda: not run.machine.status.docked and run.machine.status.state is State.IDLE, 20.0)
    assert run.machine.status.code is Code.NONE
    assert_home(run)
    assert run.world.record.energised > 3.0
    run.begin(DockGoal(GOAL, hold=True))
    run.until(lambda: run.machine.status.docked, 60.0)
    run.run(2.0)
    assert run.outcome is None, "without a stop condition it is held until it is cancelled"
    run.machine.cancel()
    assert run.finish(30.0).code is Code.CANCELED
    assert_home(run)


def test_a_target_of_higher_voltage_feeds_back_unnoticed() -> None:
    """The documentation warns of this: nothing is measured, so nothing is reported."""
    run = Wired(target_voltage=29.0).run
    outcome = run.dock()
    assert outcome.success
    assert run.world.snapshot().charge_current < -1.0
    assert math.isnan(outcome.charge_current)
