# SPDX-License-Identifier: Apache-2.0
"""Electrodes wired to the battery (power: none): live at every touch, measured early, never reported as charging."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import pytest

from deltacharger_core.parameters import ParameterError
from deltacharger_docking.codes import Code, State
from deltacharger_docking.observation import Command, Decision, DockGoal, Observation, Reply, Service
from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.campaigns.virtual_charger import GOAL, VirtualCharger
from deltacharger_sim.parameters import CircuitParameters

from .dockings import felt_as, quick_charger

NONE = {"power": "none"}
PRESSED = 0.3  # A of contact current that no touch reaches


def wired(*place: float, parameters: Mapping[str, Any] = MappingProxyType({}), **circuit: Any) -> Watched:
    """A charger without a contactor; its target is off by these mm and degrees."""
    run = quick_charger(*place, parameters={**NONE, **parameters}, circuit=CircuitParameters(wired=True, **circuit))
    return Watched(run)


class Watched:
    """A charger whose commands are kept.

    Attributes:
        run: the charger.
        asked: the services that were called.
        decisions: in their order.
        pressed: largest contact current before retracting, A.
    """

    def __init__(self, run: VirtualCharger) -> None:
        self.run = run
        self.asked: list[Service] = []
        self.decisions: list[Decision] = []
        self.pressed = -math.inf
        follow = run._follow

        def keep(command: Command) -> None:
            assert not command.energise
            self.asked += [request.service for request in command.requests]
            self.decisions += command.decisions
            self.pressed = max(self.pressed, run.machine.status.contact_current)
            assert not run.machine.status.charging
            follow(command)

        run._follow = keep  # type: ignore[method-assign]

    @property
    def kinds(self) -> list[str]:
        """Texts of the decisions."""
        return [decision.kind for decision in self.decisions]

    def docked(self) -> VirtualCharger:
        """Dock; then current flows between two batteries."""
        outcome = self.run.dock()
        assert outcome.success, outcome
        assert self.run.world.snapshot().charge_current > 1.0
        return self.run

    def ends(self, code: Code, within: float) -> None:
        """Check that the arm retracts for this reason, begins within this time (s), and reaches home."""
        run = self.run
        run.until(lambda: run.machine.status.state is State.RETRACT, within)
        run.until(lambda: run.machine.status.state is State.IDLE, 30.0)
        assert run.machine.status.code is code, run.machine.status.message
        assert_home(run)


def assert_home(run: VirtualCharger) -> None:
    """The arm is home and limp, without contact."""
    truth = run.world.snapshot()
    assert truth.charge_current == 0.0
    assert math.dist(truth.position, run.parameters.home) < 0.003
    assert not run.observe().torque_enabled
    assert not run.machine.status.docked


def test_it_docks_and_aligns_and_reports_only_known_values() -> None:
    watched = wired(parameters={"overlap_loss_max": 0.004, "landing_limit": 0.0025})  # as by default
    run = watched.docked()
    outcome, status = run.outcome, run.machine.status
    assert outcome is not None
    assert outcome.aligned
    assert 0.4 <= outcome.contact_current <= 0.5
    assert math.isnan(outcome.charge_current)
    assert math.isnan(outcome.energy)
    for words in ("power: none", "does not measure, limit or interrupt", "undock ends it"):
        assert words in outcome.notice
    assert (status.docked, status.charging, status.state) == (True, False, State.IDLE)
    assert not {Service.PROBE, Service.OPEN} & set(watched.asked)
    run.run(30.0)
    assert status.docked, "watched over, nothing is wrong"
    assert run.undock().success
    assert_home(run)
    record = run.world.record
    assert record.energised_shorts == 0
    assert record.parted_live == record.contacts
    assert record.broken_current > 1.0, "nothing but the electrodes interrupts it"
    assert record.unpowered_live == 0


def test_each_first_touch_is_measured_before_pressing() -> None:
    watched = wired(6.0, 2.0)
    watched.docked()
    order = [kind for kind in watched.kinds if kind in ("touched", "contact")]
    assert order == ["touched", "contact"] * (len(order) // 2)
    assert len(order) >= 4, "more than one contact"


def test_a_tilt_measured_at_first_touch_is_not_pressed() -> None:
    watched = wired(0.0, 0.0, 13.0)
    outcome = watched.run.dock()
    assert outcome.code is Code.CRITICAL_ANGLE
    assert math.isnan(outcome.energy)
    assert watched.run.world.record.contacts == 1
    assert watched.pressed < PRESSED
    assert "contact" not in watched.kinds
    assert_home(watched.run)


def test_an_offset_across_the_bars_is_corrected_before_pressing() -> None:
    watched = wired(0.0, 6.0, 4.0)
    run = watched.run
    run.begin(DockGoal(GOAL))
    run.until(lambda: "move" in watched.kinds, 60.0)
    assert watched.pressed < PRESSED
    assert "contact" not in watched.kinds
    assert run.finish(120.0).success


def spoil(run: VirtualCharger, change: Callable[[Reply], Reply], times: int = 1) -> None:
    """Change the estimator's next answers."""
    left = [times]

    def answer(reply: Reply) -> Reply:
        left[0] -= 1
        return change(reply) if left[0] >= 0 else reply

    run.answer[Service.ESTIMATE] = answer


def unsure(degrees: float) -> Callable[[Reply], Reply]:
    """Make an estimate unsure, with this angle."""

    def change(reply: Reply) -> Reply:
        assert reply.estimate is not None
        return replace(reply, estimate=replace(felt_as(reply.estimate, angle=math.radians(degrees)), sure=False))

    return change


def test_after_an_unsure_first_touch_it_presses_and_judges_then() -> None:
    watched = wired(0.0, 0.0)
    spoil(watched.run, unsure(2.0))
    watched.docked()
    assert watched.kinds.index("contact") == watched.kinds.index("touched") + 1, "no verdict between"


def test_a_first_touch_with_a_tilt_beyond_the_limit_is_never_pressed_even_if_unsure() -> None:
    watched = wired(0.0, 0.0)
    spoil(watched.run, unsure(14.0), 10)
    outcome = watched.run.dock()
    assert outcome.code is Code.CRITICAL_ANGLE
    assert watched.run.world.record.contacts == 2, "one repeated contact"
    assert watched.pressed < PRESSED
    assert_home(watched.run)


def test_an_estimator_failure_at_first_touch_retracts_the_arm() -> None:
    watched = wired()
    watched.run.answer[Service.ESTIMATE] = lambda reply: Reply(reply.number, False, "out of order")
    assert watched.run.dock().code is Code.TACTILE_STALE
    assert watched.pressed < PRESSED
    assert_home(watched.run)


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (DockGoal(GOAL, start_charging=False), "contact without current is impossible"),
        (DockGoal(GOAL, stop_energy=100.0), "does not measure energy"),
    ],
)
@pytest.mark.parametrize("docked", [False, True])
def test_goals_that_need_a_contactor_are_refused(goal: DockGoal, words: str, docked: bool) -> None:
    watched = wired()
    run = watched.docked() if docked else watched.run
    before = run.world.snapshot().position
    with pytest.raises(Exception, match=words) as refused:
        run.begin(goal)
    assert "power: none" in str(refused.value)
    assert refused.value.code is Code.REJECTED  # type: ignore[attr-defined]
    run.run(1.0)
    assert math.dist(run.world.snapshot().position, before) < 1e-4
    assert run.machine.status.docked == docked


def test_a_given_roll_beyond_the_limit_is_refused_before_any_motion() -> None:
    watched = wired()
    outcome = watched.run.dock(DockGoal(replace(GOAL, roll=math.radians(12.5))))
    assert outcome.code is Code.CRITICAL_ANGLE
    assert watched.run.world.record.contacts == 0


@pytest.mark.parametrize("approach", ["paper", "published"])
def test_only_the_guarded_approach_may_dock_without_a_contactor(approach: str) -> None:
    with pytest.raises(ParameterError, match="set approach guarded"):
        DockingParameters(power="none", approach=approach)


@pytest.mark.parametrize(
    ("wrong", "code", "within"),
    [
        ({"servo_age": 0.3}, Code.SERVO_FAULT, 0.1),
        ({"hardware_error": 32}, Code.SERVO_FAULT, 0.1),
        ({"torque_enabled": False}, Code.SERVO_FAULT, 0.1),
        ({"thermal_reserve": 0.0}, Code.SERVO_FAULT, 0.1),
        ({"tactile_age": 1.0}, Code.TACTILE_STALE, 0.1),
        ({"currents": (0.0, 0.0, 0.0)}, Code.NO_CONTACT, 0.3),
    ],
)
def test_a_docked_charger_is_supervised_as_while_charging(wrong: dict[str, Any], code: Code, within: float) -> None:
    watched = wired()
    run = watched.docked()
    run.distort = lambda observation: replace(observation, **wrong)
    run.until(lambda: run.machine.status.state is State.RETRACT, within)
    run.distort = lambda observation: observation
    run.until(lambda: run.machine.status.state is State.IDLE, 30.0)
    assert run.machine.status.code is code


def test_missing_charger_power_ends_nothing_since_it_measures_nothing() -> None:
    run = wired().docked()
    run.distort = lambda observation: replace(observation, power_age=math.inf)
    run.run(10.0)
    assert run.machine.status.docked


def test_the_arm_retracts_after_docking_was_suspended() -> None:
    watched = wired()
    run = watched.docked()
    run.now += run.parameters.clearance_period + 2.0
    watched.ends(Code.POWER_STALE, 0.1)


def test_the_arm_retracts_if_clearance_is_lost_while_docked() -> None:
    watched = wired()
    run = watched.docked()

    def tilted(reply: Reply) -> Reply:
        assert reply.estimate is not None
        return replace(reply, estimate=felt_as(reply.estimate, angle=math.radians(11.0)))

    run.answer[Service.ESTIMATE] = tilted
    watched.ends(Code.CRITICAL_ANGLE, 2.5 * run.parameters.clearance_period)


def second_source(observation: Observation) -> Observation:
    return replace(observation, duplicate_sources="servo_state: a and b")


def test_with_a_second_source_it_does_not_touch() -> None:
    watched = wired(parameters={"duplicate_source_timeout": 2.0})
    run = watched.run
    run.distort = second_source
    assert run.dock().code is Code.DUPLICATE_SOURCE
    assert run.world.record.contacts == 0
    assert State.MEASURE not in run.states
    assert_home(run)


def test_it_touches_after_the_second_source_has_disappeared() -> None:
    watched = wired()
    run = watched.run
    run.distort = second_source
    run.begin(DockGoal(GOAL))
    run.until(lambda: "wait" in watched.kinds, 30.0)
    run.run(1.0)
    assert run.world.record.contacts == 0
    run.distort = lambda observation: observation
    assert run.finish(60.0).success


def test_an_estimate_made_during_a_second_source_is_repeated() -> None:
    watched = wired()
    run = watched.run
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is State.MEASURE, 30.0)
    run.distort = second_source
    run.until(lambda: "wait" in watched.kinds, 30.0)
    assert run.outcome is None
    run.distort = lambda observation: observation
    before = watched.kinds.count("measured")
    assert run.finish(60.0).success
    assert watched.kinds.count("measured") > before


@pytest.mark.parametrize("hold", [False, True])
def test_a_stop_condition_undocks_since_nothing_else_ends_the_current(hold: bool) -> None:
    run = wired().run
    outcome = run.dock(DockGoal(GOAL, hold=hold, stop_after=5.0))
    assert outcome.success
    assert ("taken off" in outcome.notice) == hold
    assert run.machine.status.docked != hold
    run.until(lambda: not run.machine.status.docked and run.machine.status.state is State.IDLE, 20.0)
    assert run.machine.status.code is Code.NONE
    assert_home(run)
    assert run.world.record.energised > 5.0
    assert run.dock().success, "the next goal is served"


def test_a_held_goal_lasts_until_it_is_cancelled() -> None:
    run = wired().run
    run.begin(DockGoal(GOAL, hold=True))
    run.until(lambda: run.machine.status.docked, 60.0)
    run.run(20.0)
    assert run.outcome is None
    run.machine.cancel()
    assert run.finish(30.0).code is Code.CANCELED
    assert_home(run)


def test_a_further_goal_on_the_docked_target_moves_nothing() -> None:
    watched = wired()
    run = watched.docked()
    before, contacts = len(watched.decisions), run.world.record.contacts
    outcome = run.dock()
    assert outcome.success
    assert "undock ends it" in outcome.notice
    assert run.world.record.contacts == contacts
    assert {decision.kind for decision in watched.decisions[before:]} <= {"accepted", "ended"}


def test_a_lower_critical_angle_on_the_docked_target_applies_at_once() -> None:
    watched = wired(0.0, 0.0, 4.0)
    run = watched.docked()
    assert run.dock(DockGoal(GOAL, critical_angle=math.radians(2.0))).code is Code.CRITICAL_ANGLE
    assert_home(run)


def test_a_target_of_higher_voltage_feeds_back_unnoticed() -> None:
    """The documentation warns of this: nothing is measured, so nothing is reported."""
    run = wired(target_voltage=29.0).run
    outcome = run.dock()
    assert outcome.success
    assert run.world.snapshot().charge_current < -1.0
    assert math.isnan(outcome.charge_current)
