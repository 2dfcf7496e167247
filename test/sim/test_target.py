# SPDX-License-Identifier: Apache-2.0
"""The target: its magnets' law, their effects on the arm, and a target that moves under the electrodes."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from deltacharger_sim.parameters import ContactParameters, MagnetParameters, WorldParameters
from test.plain import plain_servo

FAR = (0.004, -0.003)
ArmFactory = Callable[..., Any]


def test_the_magnets_release_at_1_6_ampere_per_servo_and_not_before(arm: ArmFactory) -> None:
    pulling = arm()
    pulling.dock()
    strongest, command = 0.0, 0.0865
    while pulling.world.mechanics.contact_force > 0.0:
        strongest = min(strongest, pulling.contact_current)
        command -= 0.0005
        assert command > 0.04
        pulling.go((0.0, 0.0, command), 0.1)
    assert strongest == pytest.approx(-1.56, abs=0.04)  # 60 N · 38.15 mm / 1.463 N·m/A
    pulling.run(0.5)
    assert pulling.world.mechanics.gap > 0.005


def moved(arm: ArmFactory, friction: float, step: float, magnets: float = 60.0) -> tuple[Any, Any]:
    """Return a docked arm and its platform's position before the target moved by `FAR` in 0.2 s, a second ago."""
    contact = ContactParameters(friction=friction)
    servo = plain_servo(friction=0.0)
    docked = arm(WorldParameters(servo=servo, contact=contact, magnets=MagnetParameters(force=magnets)), step)
    docked.dock()
    docked.run(0.5)
    before = docked.world.mechanics.position
    docked.world.move_target(*FAR, 0.0, 0.2)
    docked.run(1.0)
    return docked.world, before


@pytest.mark.parametrize("step", [0.002, 0.01])
def test_sufficient_friction_drags_the_platform(arm: ArmFactory, step: float) -> None:
    world, before = moved(arm, 1.0, step)
    after = world.mechanics.position
    for axis in (0, 1):
        assert after[axis] - before[axis] == pytest.approx(FAR[axis], abs=1e-4)
    assert 1.0 < math.hypot(*world.mechanics.rub) < world.mechanics.contact_force


@pytest.mark.parametrize("step", [0.002, 0.01])
def test_insufficient_friction_lets_the_target_slide(arm: ArmFactory, step: float) -> None:
    world, before = moved(arm, 0.02, step, magnets=0.0)
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


def test_a_pure_rotation_affects_the_circuit_of_an_arm_at_rest(arm: ArmFactory) -> None:
    charging = arm()
    charging.charge(2.0)
    assert charging.world.mechanics.still
    before = charging.world.snapshot().clearance
    charging.world.move_target(0.0, 0.0, 0.25, 0.2)
    charging.run(0.4)
    assert charging.world.snapshot().clearance < 0.0 < before
    assert charging.world.record.energised_shorts == 1
