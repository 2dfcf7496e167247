# SPDX-License-Identifier: Apache-2.0
"""Electrodes wired to the battery (power: none): live at every touch, measured early, never reported as charging."""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import pytest

from deltacharger_docking import codes, observation
from deltacharger_sim.parameters import CircuitParameters
from deltacharger_sim.virtual.virtual_charger import GOAL, VirtualCharger

from .dockings import commands, decisions, ends, quick_charger, spoil

PRESSED = 0.3  # A of contact current that no touch reaches


def wired(*place: float, parameters: Mapping[str, Any] = MappingProxyType({}), coarse: bool = False) -> VirtualCharger:
    """A charger without a contactor, whose target is off by these mm and degrees."""
    given = {"power": "none", **parameters}
    return quick_charger(*place, parameters=given, circuit=CircuitParameters(wired=True), coarse=coarse)


def wired_docked() -> VirtualCharger:
    """One that has docked; then current flows between two batteries."""
    run = wired()
    assert run.dock().success
    assert run.world.snapshot().charge_current > 1.0
    return run


def assert_home(run: VirtualCharger) -> None:
    """The arm is home and limp, without contact."""
    truth = run.world.snapshot()
    assert truth.charge_current == 0.0
    assert math.dist(truth.position, run.parameters.home) < 0.003
    assert not run.observe().torque_enabled
    assert not run.machine.status.docked


def test_it_docks_and_aligns_and_reports_only_known_values() -> None:
    usual = {"overlap_loss_max": 0.004, "landing_limit": 0.0025}
    run = wired(6.0, 2.0, parameters=usual, coarse=True)
    sent = commands(run)
    assert run.dock().success
    order = [each.kind for each in decisions(sent) if each.kind in ("touched", "contact")]
    assert order == ["touched", "contact"] * (len(order) // 2), "each first touch is measured before pressing"
    assert len(order) >= 4, "more than one contact"
    outcome, status = run.outcome, run.machine.status
    assert outcome is not None
    assert outcome.aligned
    assert 0.4 <= outcome.contact_current <= 0.5
    assert math.isnan(outcome.charge_current)
    assert math.isnan(outcome.energy)
    assert "power: none" in outcome.notice
    assert (status.docked, status.charging, status.state) == (True, False, codes.State.IDLE)
    assert not {observation.Service.PROBE, observation.Service.OPEN} & {
        request.service for command in sent for request in command.requests
    }
    spoil(run, power_age=math.inf)
    run.run(6.0)
    assert status.docked, "watched over, nothing is wrong, also without charger_power, which measures nothing"
    before, contacts = len(sent), run.world.record.contacts
    assert run.dock().success, "a further goal moves nothing"
    assert run.world.record.contacts == contacts
    assert {each.kind for each in decisions(sent[before:])} <= {"accepted", "ended"}
    assert run.undock().success
    assert_home(run)
    assert not any(command.energise for command in sent)
    assert codes.State.CHARGING not in run.states
    record = run.world.record
    assert record.energised_shorts == 0
    assert record.parted_live == record.contacts
    assert record.broken_current > 1.0, "nothing but the electrodes interrupts it"
    assert record.unpowered_live == 0


def test_a_tilt_measured_at_first_touch_is_not_pressed() -> None:
    run = wired(0.0, 0.0, 13.0)
    sent = commands(run)
    run.begin(observation.DockGoal(GOAL))
    while run.outcome is None:
        run.tick()
        assert run.machine.status.contact_current < PRESSED or run.machine.status.state is codes.State.RETRACT
    assert run.outcome.code is codes.Code.CRITICAL_ANGLE
    assert math.isnan(run.outcome.energy)
    assert run.world.record.contacts == 1
    assert not decisions(sent, "contact")
    assert_home(run)


@pytest.mark.parametrize(
    "goal", [observation.DockGoal(GOAL, start_charging=False), observation.DockGoal(GOAL, stop_energy=100.0)]
)
@pytest.mark.parametrize("docked", [False, True])
def test_goals_that_need_a_contactor_are_refused(goal: observation.DockGoal, docked: bool) -> None:
    run = wired_docked() if docked else wired()
    before = run.world.snapshot().position
    with pytest.raises(codes.Rejected, match="power: none"):
        run.begin(goal)
    run.run(0.5)
    assert math.dist(run.world.snapshot().position, before) < 1e-4
    assert run.machine.status.docked == docked


@pytest.mark.parametrize(
    ("wrong", "code", "within"),
    [
        ({"servo_age": 0.3}, codes.Code.SERVO_STALE, 0.1),
        ({"currents": (0.0, 0.0, 0.0)}, codes.Code.NO_CONTACT, 0.3),
    ],
)
def test_a_docked_charger_is_supervised_as_while_charging(
    wrong: dict[str, Any], code: codes.Code, within: float
) -> None:
    run = wired_docked()
    spoil(run, **wrong)
    ends(run, code, within)


@pytest.mark.parametrize("hold", [False, True])
def test_a_stop_condition_undocks_since_nothing_else_ends_the_current(hold: bool) -> None:
    run = wired(coarse=True)
    outcome = run.dock(observation.DockGoal(GOAL, hold=hold, stop_after=3.0))
    assert outcome.success
    assert ("taken off" in outcome.notice) == hold
    assert run.machine.status.docked != hold
    run.until(lambda: not run.machine.status.docked and run.machine.status.state is codes.State.IDLE, 20.0)
    assert run.machine.status.code is codes.Code.NONE
    assert_home(run)
    assert run.world.record.energised > 3.0
    run.begin(observation.DockGoal(GOAL, hold=True))
    run.until(lambda: run.machine.status.docked, 60.0)
    run.run(2.0)
    assert run.outcome is None, "without a stop condition it is held until it is cancelled"
    run.machine.cancel()
    assert run.finish(30.0).code is codes.Code.CANCELED
    assert_home(run)
