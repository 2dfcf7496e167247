# SPDX-License-Identifier: Apache-2.0
"""A target that moves under the electrodes drags the platform by friction, and slides if friction is too low."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from deltacharger_sim.errors import TargetFixed
from deltacharger_sim.mujoco_world import mujoco_world
from deltacharger_sim.parameters import ContactParameters, WorldParameters

ArmFactory = Callable[..., Any]
FAR = (0.004, -0.003)


def moved(arm: ArmFactory, friction: float, step: float = 0.005, roll: float = 0.0) -> tuple[Any, Any]:
    """Return a docked arm and its platform's position before the target moved by `FAR` in 0.2 s, a second ago."""
    docked = arm(WorldParameters(contact=ContactParameters(friction=friction)), step)
    docked.dock()
    docked.run(0.5)
    before = docked.world.mechanics.position
    docked.world.move_target(*FAR, roll, 0.2)
    docked.run(1.0)
    return docked.world, before


@pytest.mark.parametrize("step", [0.002, 0.005, 0.01])
def test_sufficient_friction_drags_the_platform(arm: ArmFactory, step: float) -> None:
    world, before = moved(arm, 1.0, step)
    after = world.mechanics.position
    for axis in (0, 1):
        assert after[axis] - before[axis] == pytest.approx(FAR[axis], abs=1e-4)
    assert 1.0 < math.hypot(*world.mechanics.rub) < world.mechanics.contact_force


@pytest.mark.parametrize("step", [0.002, 0.005, 0.01])
def test_insufficient_friction_lets_the_target_slide(arm: ArmFactory, step: float) -> None:
    world, before = moved(arm, 0.02, step)
    after, lies = world.mechanics.position, world.misalignment
    came = after[0] - before[0], after[1] - before[1]
    assert 0.0001 < math.hypot(*came) < 0.003
    assert (lies[0], lies[1]) == pytest.approx((FAR[0] - after[0], FAR[1] - after[1]), abs=1e-9)
    pulled = world.mechanics.rub
    assert math.hypot(*pulled) <= 0.02 * world.mechanics.contact_force + 1e-6
    assert pulled[0] * FAR[0] > 0.0 > -pulled[1] * FAR[1]


def test_the_target_moves_at_constant_speed_and_only_by_the_given_distance(arm: ArmFactory) -> None:
    docked = arm()
    docked.dock()
    target, world = docked.world.parameters.target, docked.world
    world.move_target(0.002, 0.0, 0.05, 0.2)
    docked.run(0.1)
    assert world.parameters.target.x == pytest.approx(target.x + 0.001)
    docked.run(0.4)
    there = world.parameters.target
    assert (there.x, there.y, there.z, there.roll) == pytest.approx((0.002 + target.x, target.y, target.z, 0.05))
    assert world.misalignment[2] == pytest.approx(0.05)
    place = world.mechanics.position
    world.step(3.0)
    assert world.parameters.target == there
    assert world.mechanics.position == pytest.approx(place, abs=1e-6)


def test_a_pure_rotation_affects_the_circuit_of_an_arm_at_rest(arm: ArmFactory) -> None:
    charging = arm()
    charging.charge(2.0)
    assert charging.world.mechanics.still
    before = charging.world.snapshot().clearance
    charging.world.move_target(0.0, 0.0, 0.25, 0.2)
    charging.run(0.4)
    assert charging.world.snapshot().clearance < 0.0 < before
    assert charging.world.record.energised_shorts == 1


def test_without_contact_nothing_is_dragged(arm: ArmFactory) -> None:
    away = arm()
    away.go((0.0, 0.0, 0.06))
    before = away.world.mechanics.position
    away.world.move_target(0.004, 0.0, 0.0, 0.2)
    away.run(0.5)
    assert away.world.mechanics.position == pytest.approx(before, abs=1e-5)  # the magnets pull a little less
    assert away.world.parameters.target.x == pytest.approx(0.004)


def test_a_model_with_a_fixed_target_refuses_moves() -> None:
    pytest.importorskip("mujoco", reason="mujoco is not installed (extra sim)")
    with pytest.raises(TargetFixed, match="MujocoMechanics moves the arm: use a World of the light model"):
        mujoco_world(WorldParameters()).move_target(0.001, 0.0, 0.0, 0.2)
