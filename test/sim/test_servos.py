# SPDX-License-Identifier: Apache-2.0
"""The world's servos: gains that multiply the stiffness, and delayed commands and readings."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.servos.control_table import OK
from deltacharger_driver.servos.mx64 import REGISTERS
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_sim.parameters import ServoParameters, TargetParameters, WorldParameters
from deltacharger_sim.shared_world import SharedWorld
from deltacharger_sim.world import World

DELTA = ScalarDelta()
ALONE = TargetParameters(present=False)
QUIET = ServoParameters(current_noise=0.0, friction=0.0)
STEP = 0.005


def settled(world: World, gains: Vector = (1.0, 1.0, 1.0), seconds: float = 3.0) -> World:
    for index, (goal, gain) in enumerate(zip((0.1, 0.2, 0.15), gains, strict=True)):
        world.command(index, True, goal, 4.1, gain)
    for _ in range(round(seconds / 0.005)):
        world.step(0.005)
    return world


def torques_over(world: World, goals: Vector = (0.1, 0.2, 0.15)) -> list[float]:
    """Return N·m/rad of each servo."""
    mechanics = world.mechanics
    return [
        torque / (goal - angle) for torque, goal, angle in zip(mechanics.torques, goals, mechanics.angles, strict=True)
    ]


def docked(stiffness: float, gains: Vector, **servo: Any) -> tuple[Any, ...]:
    """Strike the target and press on it; return all results."""
    world = World(WorldParameters(servo=ServoParameters(stiffness=stiffness, current_noise=0.0, **servo)))
    for z, seconds in ((0.070, 0.5), (0.088, 0.5), (0.060, 0.5)):
        for index, (angle, gain) in enumerate(zip(DELTA.inverse(0.0, 0.002, z), gains, strict=True)):
            world.command(index, True, angle, 4.1, gain)
        for _ in range(round(seconds / 0.005)):
            world.step(0.005)
    record = world.record
    return world.mechanics.position, world.mechanics.torques, (record.peak_force, record.peak_push, record.contacts)


@pytest.mark.parametrize("servo", [{}, {"backlash": 0.008}, {"command_latency": 0.02}], ids=str)
def test_an_equal_gain_of_all_servos_equals_another_stiffness(servo: dict[str, float]) -> None:
    for found, expected in zip(
        docked(10.0, (1.5, 1.5, 1.5), **servo), docked(15.0, (1.0, 1.0, 1.0), **servo), strict=True
    ):
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_each_servo_has_its_own_gain() -> None:
    world = settled(World(WorldParameters(servo=QUIET, target=ALONE)), (1.0, 0.5, 2.0))
    assert torques_over(world) == pytest.approx([15.0, 7.5, 30.0], rel=1e-6)


def test_a_gain_that_changes_at_rest_moves_the_arm() -> None:
    world = settled(World(WorldParameters(servo=QUIET, target=ALONE)))
    before = [goal - angle for goal, angle in zip((0.1, 0.2, 0.15), world.mechanics.angles, strict=True)]
    settled(world, (0.5, 0.5, 0.5))
    after = [goal - angle for goal, angle in zip((0.1, 0.2, 0.15), world.mechanics.angles, strict=True)]
    assert after[1:] == pytest.approx([2.0 * value for value in before[1:]], rel=0.05)  # the load rotates with the arm


def test_the_register_reaches_the_world() -> None:
    now = 0.0
    world = World(WorldParameters(servo=QUIET, target=ALONE))
    plant = SharedWorld(world, lambda: now)
    bus = ServoBusEmulator(plant)
    register = REGISTERS["position_p_gain"]
    for servo in (1, 2, 3):
        assert bus.servo(servo).write(register.address, register.to_bytes(217 * servo), now) == OK
    assert world.mechanics.gains == (0.5, 1.0, 1.5)
    bus.servo(3).reboot(now)
    assert world.mechanics.gains[2] == pytest.approx(850 / 434)


@pytest.mark.rest
def test_mujoco_has_the_same_gains() -> None:
    pytest.importorskip("mujoco")
    from deltacharger_sim.mujoco_world import mujoco_world

    parameters = WorldParameters(servo=dataclasses.replace(QUIET, friction=0.001), target=ALONE)
    world = settled(mujoco_world(parameters), (1.0, 0.5, 2.0))
    assert torques_over(world) == pytest.approx([15.0, 7.5, 30.0], rel=1e-3)


def moving(**servo: float) -> World:
    """A world whose servo 0 has just been commanded to turn by 0.3 rad."""
    world = World(WorldParameters(servo=ServoParameters(current_noise=0.0, **servo)))
    for _ in range(100):
        world.step(STEP)
    for index in range(3):
        world.command(index, True, world.mechanics.angles[index], 4.1)
    for _ in range(100):
        world.step(STEP)
    world.command(0, True, world.mechanics.angles[0] + 0.3, 4.1)
    return world


@pytest.mark.parametrize("late", [0.005, 0.1])
def test_a_command_acts_after_its_latency_as_without_latency(late: float) -> None:
    prompt, slow = moving(), moving(command_latency=late)
    first = [prompt.mechanics.angles]
    second = [slow.mechanics.angles]
    for _ in range(100):
        prompt.step(STEP)
        slow.step(STEP)
        first.append(prompt.mechanics.angles)
        second.append(slow.mechanics.angles)
    behind = round(late / STEP)
    assert max(abs(angles[0] - first[0][0]) for angles in second[: behind + 1]) < 1e-6
    for angles, later in zip(first, second[behind:], strict=False):
        assert angles == pytest.approx(later, abs=1e-6)


@pytest.mark.parametrize("old", [0.005, 0.1])
def test_a_reading_has_its_latency(old: float) -> None:
    world = moving(reading_latency=old)
    states = [(world.mechanics.angles[0], world.mechanics.rates[0], world.mechanics.torques[0])]
    behind = round(old / STEP)
    for step in range(60):
        world.step(STEP)
        mechanics = world.mechanics
        states.append((mechanics.angles[0], mechanics.rates[0], mechanics.torques[0]))
        if step >= behind:
            angle, rate, current, _, _ = world.servo(0)
            true = states[-1 - behind]
            assert (angle, rate) == true[:2]
            assert current == pytest.approx(true[2] / (6.0 / 4.1))


def test_the_order_of_commands_is_kept() -> None:
    world = moving(command_latency=0.02)
    world.command(0, False, 0.0, 0.0)
    world.command(0, True, 0.1, 2.0)
    for _ in range(10):
        world.step(STEP)
    assert world._enabled[0]
    assert world._reference[0] == 0.1
