# SPDX-License-Identifier: Apache-2.0
"""Goals on a docked target: each is fulfilled, none moves electrodes that rest well or weakens the supervision.

No attack leaves current on, an arm stuck or an endless goal.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from deltacharger_docking import charging, codes, energy
from deltacharger_docking.observation import DockGoal, Observation, Reply, Service
from deltacharger_sim.parameters import CircuitParameters
from deltacharger_sim.virtual.virtual_charger import GOAL, VirtualCharger

from ..marks import rest
from .dockings import (
    assert_safe_at_home,
    commands,
    decisions,
    docked,
    ends,
    feel,
    quick_charger,
    reach,
    spoil,
    until_open,
)

WIRED = {"parameters": {"power": "none"}, "circuit": CircuitParameters(wired=True)}
CONTACT_ONLY = DockGoal(GOAL, start_charging=False)


def test_a_stop_condition_counts_from_its_own_goal() -> None:
    run = docked(coarse=True)
    run.run(5.0)
    contacts, before = run.world.record.contacts, run.now
    outcome = run.dock(DockGoal(GOAL, hold=True, stop_energy=700.0))
    assert outcome.success
    assert 700.0 <= outcome.energy < 800.0
    assert run.now - before > 2.0, "the energy before the goal is not its own"
    assert run.dock(DockGoal(GOAL, hold=True, stop_after=2.0)).success
    assert not run.world.snapshot().contactor_closed
    assert run.world.record.contacts == contacts
    assert run.machine.status.docked
    assert run.dock(DockGoal(GOAL, stop_after=3.0)).success, "without hold it ends under supervision"
    until_open(run, 4.0)
    assert (run.machine.status.docked, run.machine.status.code) == (True, codes.Code.NONE)


def test_a_goal_without_charging_ends_charging_and_keeps_the_contact() -> None:
    run = docked()
    contacts = run.world.record.contacts
    assert run.dock(CONTACT_ONLY).success
    assert not run.world.snapshot().contactor_closed
    assert run.machine.status.docked
    assert run.world.record.contacts == contacts
    assert run.world.record.broken_current < 1.5, "it was ramped down first"


def test_a_docked_target_is_energised_in_place_after_a_new_clearance_measurement() -> None:
    run = docked(start_charging=False)
    contacts, sent = run.world.record.contacts, commands(run)
    assert run.dock().success
    asked = [request.service for command in sent for request in command.requests]
    assert run.world.record.contacts == contacts
    assert asked[0] is Service.ESTIMATE
    assert asked.count(Service.PROBE) == 1
    assert Service.TARE not in asked
    assert run.machine.status.charging


def test_a_target_that_turned_while_docked_is_not_energised_in_place() -> None:
    run = docked(start_charging=False, coarse=True)
    feel(run, angle=math.radians(12.5))
    assert run.dock().code is codes.Code.CRITICAL_ANGLE
    assert run.world.record.energised == 0.0
    assert_safe_at_home(run)


def test_repeated_goals_do_not_delay_the_clearance_check() -> None:
    run = docked(coarse=True)
    feel(run, angle=math.radians(12.5))
    start = run.now
    while run.world.snapshot().contactor_closed and run.now < start + 20.0:
        assert run.dock().success
        run.run(0.5)
    assert run.now - start < 3.0 * charging.CLEARANCE_PERIOD + 1.0
    assert run.machine.status.code is codes.Code.CRITICAL_ANGLE


def test_the_lowest_critical_angle_of_all_goals_applies() -> None:
    run = quick_charger(coarse=True)
    assert run.dock(DockGoal(GOAL, critical_angle=math.radians(8.0))).success
    assert run.dock().success, "a goal without a limit of its own"
    feel(run, angle=math.radians(9.0))
    ends(run, codes.Code.CRITICAL_ANGLE)


@pytest.mark.parametrize("kind", [{}, WIRED], ids=["contactor", "wired"])
def test_a_goal_with_a_limit_below_the_measured_angle_ends_charging(kind: dict[str, Any]) -> None:
    run = docked(3.0, -2.0, 5.0, **kind)
    assert run.dock(DockGoal(GOAL, critical_angle=math.radians(3.0))).code is codes.Code.CRITICAL_ANGLE
    assert away(run) < 0.003
    assert not run.observe().torque_enabled


@pytest.mark.parametrize(
    "goal",
    [CONTACT_ONLY, DockGoal(GOAL, start_charging=False, hold=True, stop_energy=9.0), DockGoal(GOAL, hold=True)],
    ids=["no client", "nothing to count", "held while charging"],
)
def test_a_rest_ends_after_hold_max_with_or_without_a_client(goal: DockGoal) -> None:
    run = quick_charger(parameters={"hold_max": 2.0}, coarse=True)
    assert run.dock(goal).success
    run.until(lambda: not run.machine.busy and run.machine.status.state is codes.State.IDLE and not run._torque, 6.0)
    assert ("hold_max" in run.outcome.message) is goal.hold  # type: ignore[union-attr]
    assert not run.machine.status.docked
    assert run.machine.status.code is codes.Code.NONE
    assert_safe_at_home(run)


@pytest.mark.parametrize("period", [10**6, 12], ids=["one gap", "gaps with good samples between"])
def test_energy_that_was_not_all_measured_is_unknown_and_never_more_than_ordered(period: int) -> None:
    run = quick_charger()
    run.begin(DockGoal(GOAL, hold=True, stop_energy=1000.0))
    run.until(lambda: run.machine.status.charging, 60.0)
    ticks = itertools.count()
    run.distort = lambda seen: replace(seen, target_voltage=math.nan) if next(ticks) % period < 8 else seen
    delivered, before = 0.0, run.now
    while run.outcome is None and run.now < before + 10.0:
        now = run.now
        run.tick()
        seen = run.plant.read_power()
        delivered += seen.target * seen.current * (run.now - now) if seen.closed else 0.0
    assert run.outcome is not None
    assert run.outcome.success, run.outcome.message
    assert "at most" in run.outcome.message
    assert math.isnan(run.outcome.energy)
    assert 100.0 < delivered < 1000.0


@pytest.mark.parametrize("seconds", [3600.0, -3600.0])
def test_a_clock_that_jumps_opens_the_contactor(seconds: float) -> None:
    run = docked()
    run.distort = lambda seen: replace(seen, time=seen.time + seconds)
    run.tick()
    assert not run._energised
    run.until(lambda: run.machine.status.state is codes.State.IDLE, 30.0)
    assert run.machine.status.code is codes.Code.POWER_STALE
    assert_safe_at_home(run)


NAMES = "servo_state from /servo_node and /stranger"


def until_idle(run: VirtualCharger) -> None:
    run.until(lambda: run.machine.status.state is codes.State.IDLE, 40.0)


def away(run: VirtualCharger) -> float:
    """Return the platform's distance (m) from home."""
    return math.dist(run.world.snapshot().position, run.parameters.home)


def test_a_failure_right_after_the_close_waits_until_the_contactor_is_open() -> None:
    """Closing takes time and charger_power is late, so the first messages still report an open contactor."""
    run = quick_charger()
    late: list[tuple[float, Callable[[], None]]] = []
    circuit, drive = run.world.circuit, run.world.circuit.drive
    circuit.drive = lambda outputs: late.append((run.now + 0.04, lambda: drive(outputs)))
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
    assert run.finish(30.0).code is codes.Code.CANCELED
    assert run.world.record.parted_live == 0
    assert run.world.record.unpowered_live == 0


def test_undocking_fails_while_the_torque_stays_on() -> None:
    run = docked()
    serve = run._reply
    refused = lambda pending: Reply(pending.request.number, False, "out of order")  # noqa: E731
    run._reply = lambda pending: (refused if pending.request.service is Service.TORQUE_OFF else serve)(pending)
    assert run.undock().code is codes.Code.SERVO_FAULT, "it was refused"
    run._reply = serve
    spoil(run, torque_enabled=True)
    outcome = run.undock()
    assert outcome.code is codes.Code.SERVO_FAULT
    assert "still reports" in outcome.message


@pytest.mark.parametrize(
    ("fault", "code"), [(1, codes.Code.NO_CHARGE_CURRENT), (2, codes.Code.SHORT_CIRCUIT), (0, codes.Code.POWER_STALE)]
)
def test_a_refused_renewal_opens_at_once_and_the_next_fault_gives_the_code(fault: int, code: codes.Code) -> None:
    run = docked()
    refused_at = run.now
    run.distort = lambda seen: replace(
        seen, contactor_refusal="refused", power_fault=fault if run.now - refused_at > 0.1 else 0
    )
    assert until_open(run) <= 0.1
    run.run(0.5)
    assert run.machine.status.code is code


@pytest.mark.parametrize("begins", [rest(codes.State.APPROACH), codes.State.MEASURE, rest(codes.State.ENERGISE)])
def test_the_contactor_stays_open_while_there_is_a_second_source(
    monkeypatch: pytest.MonkeyPatch, begins: codes.State
) -> None:
    """At any time: docking continues up to closing, waits for it to disappear, reports it and retracts."""
    monkeypatch.setattr(energy, "_DUPLICATE_SOURCE_TIMEOUT", 2.0)
    run = quick_charger()
    reach(run, begins)
    spoil(run, duplicate_sources=NAMES)
    outcome = run.finish(120.0)
    assert (outcome.code, outcome.retriable) == (codes.Code.DUPLICATE_SOURCE, True)
    assert NAMES in outcome.message
    assert run.machine.status.duplicate_sources == NAMES
    assert run.world.record.energised == 0.0
    until_idle(run)


@pytest.mark.parametrize("begins", [rest(codes.State.CONTACT), codes.State.MEASURE])
def test_an_estimate_made_during_a_second_source_allows_no_current(begins: codes.State) -> None:
    """A second source that has disappeared before closing may have sent the estimate, so it is repeated."""
    run = quick_charger(coarse=True)
    sent = commands(run)
    reach(run, begins)
    spoil(run, duplicate_sources=NAMES)
    run.until(lambda: bool(decisions(sent, "wait")), 60.0)
    spoil(run)
    before = len(decisions(sent, "measured"))
    assert run.finish(120.0).success
    assert len(decisions(sent, "measured")) > before
    run.until(lambda: run.world.snapshot().contactor_closed, 1.0)
