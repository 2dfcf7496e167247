# SPDX-License-Identifier: Apache-2.0
"""Electrodes wired to the battery (power: none): live at every touch, measured early, never reported as charging."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import pytest

from deltacharger_docking.codes import Code, Rejected, State
from deltacharger_docking.observation import Command, Decision, DockGoal, Service
from deltacharger_sim.parameters import CircuitParameters
from deltacharger_sim.virtual.virtual_charger import GOAL, VirtualCharger

from .dockings import (
    ends,
    quick_charger,
    spoil,
)

PRESSED = 0.3  # A of contact current that no touch reaches


class Wired:
    """A charger without a contactor, whose target is off by these mm and degrees, and whose commands are kept.

    Attributes:
        asked: the services that were called.
        decisions: in their order.
        pressed: largest contact current before retracting, A.
    """

    def __init__(
        self, *place: float, parameters: Mapping[str, Any] = MappingProxyType({}), coarse: bool = False, **world: Any
    ) -> None:
        given = {"parameters": {"power": "none", **parameters}, "circuit": CircuitParameters(wired=True), **world}
        self.run = quick_charger(*place, coarse=coarse, **given)
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


@pytest.mark.parametrize(
    ("wrong", "code", "within"),
    [
        ({"servo_age": 0.3}, Code.SERVO_STALE, 0.1),
        ({"thermal_reserve": 0.0}, Code.SERVO_FAULT, 0.1),
        ({"tactile_age": 1.0}, Code.TACTILE_STALE, 0.1),
        ({"currents": (0.0, 0.0, 0.0)}, Code.NO_CONTACT, 0.3),
    ],
)
def test_a_docked_charger_is_supervised_as_while_charging(wrong: dict[str, Any], code: Code, within: float) -> None:
    run = Wired().docked()
    spoil(run, **wrong)
    ends(run, code, within)


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
