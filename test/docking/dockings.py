# SPDX-License-Identifier: Apache-2.0
"""Chargers in virtual time for tests of the docking machine."""

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from deltacharger_docking import clearance, codes, observation
from deltacharger_docking.parameters import DockingParameters
from deltacharger_sim.pads import ContactSource
from deltacharger_sim.parameters import TargetParameters, WorldParameters
from deltacharger_sim.virtual.quick_charger import QuickCharger
from deltacharger_sim.virtual.virtual_charger import GOAL, VirtualCharger

from .. import quick

MILLIMETRE = 1e-3
RIG_SEED = 900


def charger(
    x: float = 3.0,
    y: float = -2.0,
    degrees: float = 2.0,
    seed: int = 1,
    parameters: Mapping[str, Any] = MappingProxyType({}),
    coarse: bool = False,
    **world: Any,
) -> VirtualCharger:
    """A charger whose target differs from the goal's place by (x, y) mm and by degrees.

    A coarse one is six times as fast and decides the same, but its steps are up to 130 ms long.
    """
    target = TargetParameters(x=x * MILLIMETRE, y=y * MILLIMETRE, roll=math.radians(degrees))
    given, docking = WorldParameters(**{"target": target, **world}), DockingParameters(**parameters)
    if coarse:
        return QuickCharger(given, docking, ContactSource(None, RIG_SEED, seed), seed, RIG_SEED)
    return VirtualCharger(given, docking, seed, RIG_SEED)


def quick_charger(*place: float, parameters: Mapping[str, Any] = MappingProxyType({}), **more: Any) -> VirtualCharger:
    """The same with quick steps."""
    return charger(*place, parameters={**quick.STEPS, **parameters}, **more)


def docked(*place: float, start_charging: bool = True, **kwargs: Any) -> VirtualCharger:
    """A quick charger that has docked."""
    run = quick_charger(*place, **kwargs)
    outcome = run.dock(observation.DockGoal(GOAL, start_charging=start_charging))
    assert outcome.success, outcome.message
    assert run.world.snapshot().contactor_closed is (start_charging and not run.parameters.always_live)
    return run


def reach(run: VirtualCharger, state: codes.State, goal: observation.DockGoal | None = None) -> None:
    """Begin a goal and step until this state."""
    run.begin(goal or observation.DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is state, 120.0)


def spoil(run: VirtualCharger, **values: Any) -> None:
    """Replace these values of every observation from now on; without values, none."""
    run.distort = lambda seen: replace(seen, **{"earlier": (), **values}) if values else seen


def feel(run: VirtualCharger, times: int = 10**9, **values: Any) -> None:
    """Replace these values of the next estimates."""
    left = [times]

    def change(reply: observation.Reply) -> observation.Reply:
        assert reply.estimate is not None
        left[0] -= 1
        return replace(reply, estimate=felt_as(reply.estimate, **values)) if left[0] >= 0 else reply

    run.answer[observation.Service.ESTIMATE] = change


def until_open(run: VirtualCharger, limit: float = 30.0) -> float:
    """Return how long (s) the contactor stayed closed from now on."""
    start = run.now
    run.until(lambda: not run.world.snapshot().contactor_closed, limit)
    return float(run.now - start)


def ends(run: VirtualCharger, code: codes.Code, within: float = 15.0) -> None:
    """Step until docking reports this code, and then until the arm is back or stopped, with its observations mended."""
    run.until(lambda: run.machine.status.code is not codes.Code.NONE, within)
    spoil(run)
    run.until(lambda: run.machine.status.state is codes.State.IDLE, 40.0)
    assert run.machine.status.code is code, run.machine.status.message


def commands(run: VirtualCharger) -> list[observation.Command]:
    """Collect the machine's commands from now on."""
    found: list[observation.Command] = []
    follow = run._follow

    def keep(command: observation.Command) -> None:
        found.append(command)
        follow(command)

    run._follow = keep  # type: ignore[method-assign]
    return found


def decisions(found: list[observation.Command], kind: str = "") -> list[observation.Decision]:
    """Return the decisions of collected commands, of one kind or of all."""
    return [each for command in found for each in command.decisions if kind in ("", each.kind)]


def felt_as(felt: clearance.MisalignmentEstimate, **values: Any) -> clearance.MisalignmentEstimate:
    """The same estimate with other values; the offset across the bars follows the pose, its error stays."""
    other = replace(felt, **values)
    across = other.vertical * math.cos(other.angle) - other.horizontal * math.sin(other.angle)
    return replace(other, across=across) if values.keys() & {"angle", "vertical", "horizontal"} else other


def assert_safe_at_home(run: VirtualCharger) -> None:
    """The contactor is open, there was never a short, the arm is home and its torque off."""
    truth, record = run.world.snapshot(), run.world.record
    assert not truth.contactor_closed
    assert truth.charge_current == 0.0
    assert record.energised_shorts == 0
    assert record.energised_unsafe == 0.0
    servo = run.world.parameters.servo
    held = 0.12 * servo.friction / servo.stiffness  # m from home, where its gears hold an arm with levers of 0.12 m
    assert math.dist(truth.position, run.parameters.home) < max(3 * MILLIMETRE, held)
    assert not run.observe().torque_enabled
    assert run.machine.status.state is codes.State.IDLE


def moves(run: VirtualCharger, seconds: float) -> bool:
    """Whether the platform moves by more than 5 mm/s in the `seconds` to come."""
    before = run.world.snapshot().position
    run.run(seconds)
    return math.dist(before, run.world.snapshot().position) > 0.005 * seconds
