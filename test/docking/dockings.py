# SPDX-License-Identifier: Apache-2.0
"""Chargers in virtual time for tests of the docking machine."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from deltacharger_docking.codes import State
from deltacharger_docking.observation import DockGoal
from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.campaigns.virtual_charger import GOAL, TICK, VirtualCharger
from deltacharger_sim.parameters import ServoParameters, TargetParameters, WorldParameters

MILLIMETRE = 1e-3
QUICK = {
    "servo_damping": 0.3,
    "home_z": 0.05,
    "standoff": 0.008,
    "coarse_step": 0.004,
    "contact_speed": 0.05,
    "lift": 0.008,
    "travel_speed": 0.3,
    "charge_stable_time": 0.2,
    "alignment_tolerance": 0.004,
    "landing_limit": 0.006,
}
"""Parameters with which a docking takes 5 s of virtual time in place of 25, for laws that hold at any speed."""
QUICK_DAMPING = QUICK["servo_damping"]


def charger(
    x: float = 3.0,
    y: float = -2.0,
    degrees: float = 2.0,
    seed: int = 1,
    parameters: Mapping[str, Any] = MappingProxyType({}),
    **world: Any,
) -> VirtualCharger:
    """A charger whose target is (x, y) mm and some degrees off from where the goal says."""
    target = TargetParameters(x=x * MILLIMETRE, y=y * MILLIMETRE, roll=math.radians(degrees))
    return VirtualCharger(WorldParameters(target=target, **world), DockingParameters(**parameters), seed)


def quick_charger(*place: float, parameters: Mapping[str, Any] = MappingProxyType({}), **world: Any) -> VirtualCharger:
    """The same with quick steps; servos that are given need `QUICK_DAMPING`."""
    servo = {"servo": ServoParameters(damping=QUICK_DAMPING)}
    return charger(*place, parameters={**QUICK, **parameters}, **{**servo, **world})


def assert_safe_at_home(run: VirtualCharger) -> None:
    """The contactor is open, nothing was ever shorted, the arm is back and its torque off."""
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
