# SPDX-License-Identifier: Apache-2.0
"""Profiles of targets: which goals are refused, what may be charged, and what ends it."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from deltacharger_core.machine import ChargeLimits
from deltacharger_docking import codes, observation, parameters
from deltacharger_sim.virtual.virtual_charger import GOAL, VirtualCharger

from .dockings import assert_safe_at_home, commands, docked, quick_charger, reach, spoil

SEVEN = parameters.TargetProfile(19.0, 29.4, 10.0, 0.5)
LATE = replace(SEVEN, port="dead", start_time=10.0, gap_time=2.0, full_voltage=28.8, current=4.0)
PROFILES = {"seven": SEVEN, "late": LATE}


def charger(profiles: Mapping[str, parameters.TargetProfile] = PROFILES, **more: Any) -> VirtualCharger:
    """A quick charger with these profiles."""
    run = quick_charger(coarse=True, **more)
    run.machine._context.profiles = profiles
    return run


def refusal(run: VirtualCharger, goal: observation.DockGoal) -> str:
    with pytest.raises(codes.Rejected) as refused:
        run.begin(goal)
    assert not run.machine.busy or run.machine.status.charging
    return str(refused.value)


def probed(run: VirtualCharger, resistance: float, volts: float) -> observation.DockingOutcome:
    """Dock at a port at which the probe finds this."""
    run.answer[observation.Service.PROBE] = lambda reply: replace(reply, resistance=resistance, target_voltage=volts)
    outcome = run.dock()
    assert run.world.record.energised == 0.0
    assert_safe_at_home(run)
    return outcome


def test_goals_without_a_known_profile_are_rejected_by_name_before_anything_moves() -> None:
    assert "docs/targets.md" in refusal(charger({}), observation.DockGoal(GOAL))
    assert "did you mean 'seven'?" in refusal(charger(), observation.DockGoal(GOAL, target_profile="sevn"))
    assert "known are seven, late" in refusal(
        charger(), observation.DockGoal(GOAL, start_charging=False, target_profile="?")
    )
    wired = charger(parameters={"power": "none"})
    assert "power: none" in refusal(wired, observation.DockGoal(GOAL, target_profile="seven"))
    wired.begin(observation.DockGoal(GOAL))
    assert charger({}).dock(observation.DockGoal(GOAL, start_charging=False)).success, "contact alone needs none"


def test_the_contactor_closes_within_the_limits_of_the_goal_s_profile() -> None:
    run = charger()
    sent = commands(run)
    assert run.dock(observation.DockGoal(GOAL, target_profile="late")).success
    assert {command.limits for command in sent} == {None, ChargeLimits(4.0, 28.8, True, 11.0, 2.3)}
    assert all((command.limits is not None) is command.energise for command in sent)


def test_a_later_goal_with_another_profile_is_refused_while_charging_and_taken_afterwards() -> None:
    run = docked(coarse=True)
    run.machine._context.profiles = {"lithium_7s": SEVEN, **PROFILES}
    told = refusal(run, observation.DockGoal(GOAL, target_profile="late"))
    assert "'lithium_7s', not 'late'" in told
    assert run.machine.status.charging
    assert run.dock(observation.DockGoal(GOAL, start_charging=False, target_profile="late")).success
    sent = commands(run)
    assert run.dock(observation.DockGoal(GOAL, target_profile="late")).success
    assert {command.limits.current for command in sent if command.limits} == {4.0}


@pytest.mark.parametrize(
    ("resistance", "volts", "code", "told"),
    [
        (
            math.nan,
            12.6,
            codes.Code.VOLTAGE_OUT_OF_RANGE,
            "has 12.6 V; profile seven allows 19.0 to 29.4 V: wrong robot",
        ),
        (math.nan, 29.6, codes.Code.VOLTAGE_OUT_OF_RANGE, "wrong robot or profile"),
        (math.nan, -24.0, codes.Code.REVERSE_POLARITY, "swapped"),
        (0.05, 0.0, codes.Code.SHORT_CIRCUIT, "0.05 Ω"),
        (math.inf, 0.0, codes.Code.NO_CHARGE_CURRENT, "port: dead in the profile, or clean the electrodes"),
        (49800.0, 0.0, codes.Code.NO_CHARGE_CURRENT, "wake the target"),
        (math.nan, math.nan, codes.Code.POWER_STALE, "measured nothing"),
    ],
)
def test_what_the_probe_finds_at_a_live_port_is_judged_by_the_profile(
    resistance: float, volts: float, code: codes.Code, told: str
) -> None:
    outcome = probed(charger(), resistance, volts)
    assert outcome.code is code
    assert told in outcome.message


@pytest.mark.parametrize("found", [(math.inf, 0.0), (2000.0, 0.0), (math.nan, 24.0)])
def test_a_dead_port_is_energised_without_a_voltage(found: tuple[float, float]) -> None:
    run = charger({"late": LATE})
    run.answer[observation.Service.PROBE] = lambda reply: observation.Reply(
        reply.number, True, resistance=found[0], target_voltage=found[1]
    )
    assert run.dock().success


def test_a_target_that_does_not_connect_ends_after_its_start_time_and_one_that_connects_late_is_charged() -> None:
    run = charger({"late": LATE})
    reach(run, codes.State.ENERGISE)
    run.until(lambda: run.observe().contactor_closed, 5.0)
    closed = run.now
    spoil(run, charge_current=0.0, least_current=0.0)
    run.run(9.5)
    assert run.machine.status.state is codes.State.ENERGISE
    spoil(run, charge_current=4.0, least_current=4.0)
    assert run.finish(2.0).success
    run = charger({"late": LATE})
    reach(run, codes.State.ENERGISE)
    spoil(run, charge_current=0.0, least_current=0.0)
    outcome = run.finish(40.0)
    assert (outcome.code, outcome.retriable) == (codes.Code.NO_CHARGE_CURRENT, True)
    assert outcome.message.startswith("No current 10 s after closing: the target has not connected")
    assert run.now - closed > 10.0


@pytest.mark.parametrize("unfit", [{"battery_voltage": math.nan}, {"battery_voltage": 23.6}, {"stage_voltage": 30.0}])
def test_an_unfit_battery_or_stage_is_refused_before_anything_touches(unfit: dict[str, float]) -> None:
    run = charger()
    spoil(run, **unfit)
    assert run.dock().code in (codes.Code.POWER_STALE, codes.Code.VOLTAGE_OUT_OF_RANGE)
    assert run.world.record.contacts == 0
    assert_safe_at_home(run)


def test_a_bar_that_bridges_a_live_port_is_lifted_at_once() -> None:
    run = charger()
    reach(run, codes.State.MEASURE)
    assert run.observe().target_voltage == pytest.approx(24.0)
    spoil(run, target_voltage=0.3)
    begun = run.now
    run.until(lambda: run.machine.status.code is not codes.Code.NONE, 1.0)
    assert run.now - begun < 0.3, "steps of the quick charger; two charger_power"
    assert run.machine.status.code is codes.Code.SHORT_CIRCUIT
    assert run.machine.status.state is codes.State.RETRACT
    run.until(lambda: run.world.misalignment is None, 0.3)
    spoil(run)
    assert run.finish(30.0).code is codes.Code.SHORT_CIRCUIT
    assert_safe_at_home(run)


@pytest.mark.parametrize(
    ("seen", "retriable"),
    [
        ({"charge_current": -0.6}, True),
        ({"charge_current": -6.0}, False),
        ({"power_fault": 6}, True),
        ({"power_fault": 6, "least_current": -9.0}, False),
    ],
)
def test_after_much_reverse_current_the_goal_is_not_tried_again(seen: dict[str, Any], retriable: bool) -> None:
    run = charger()
    run.begin(observation.DockGoal(GOAL, hold=True))
    run.until(lambda: run.machine.status.charging, 60.0)
    spoil(run, **seen)
    run.run(0.4)
    spoil(run)
    outcome = run.finish(30.0)
    assert (outcome.code, outcome.retriable) == (codes.Code.REVERSE_CURRENT, retriable)
    assert outcome.charge_end == "REVERSE_CURRENT"
