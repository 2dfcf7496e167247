# SPDX-License-Identifier: Apache-2.0
"""Chargers in virtual time for tests of the docking machine."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from deltacharger_docking.clearance import MisalignmentEstimate
from deltacharger_docking.codes import State
from deltacharger_docking.observation import DockGoal
from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.campaigns.virtual_charger import GOAL, TICK, VirtualCharger
from deltacharger_sim.parameters import ServoParameters, TargetParameters, WorldParameters

from .. import quick

MILLIMETRE = 1e-3


def charger(
    x: float = 3.0,
    y: float = -2.0,
    degrees: float = 2.0,
    seed: int = 1,
    parameters: Mapping[str, Any] = MappingProxyType({}),
    **world: Any,
) -> VirtualCharger:
    """A charger whose target differs from the goal's place by (x, y) mm and by degrees."""
    target = TargetParameters(x=x * MILLIMETRE, y=y * MILLIMETRE, roll=math.radians(degrees))
    return VirtualCharger(WorldParameters(target=target, **world), DockingParameters(**parameters), seed)


def quick_charger(*place: float, parameters: Mapping[str, Any] = MappingProxyType({}), **world: Any) -> VirtualCharger:
    """The same with quick steps; other servos need their damping."""
    servo = {"servo": ServoParameters(damping=quick.DAMPING)}
    return charger(*place, parameters={**quick.STEPS, **parameters}, **{**servo, **world})


def felt_as(felt: MisalignmentEstimate, **values: Any) -> MisalignmentEstimate:
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
    assert math.dist(truth.position, run.parameters.home) < 3 * MILLIMETRE
    assert not run.observe().torque_enabled
    assert run.machine.status.state is State.IDLE


def moving_in(state: State, **world: Any) -> VirtualCharger:
    """A charger whose platform has just begun to move in that state; in ALIGN sideways, off the magnets."""
    run = charger(6, 6, seed=2, **world)
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
