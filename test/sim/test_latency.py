# SPDX-License-Identifier: Apache-2.0
"""Delayed commands and readings."""

from __future__ import annotations

import pytest

from deltacharger_sim.parameters import ServoParameters, WorldParameters
from deltacharger_sim.world import World

STEP = 0.005


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


@pytest.mark.parametrize("late", [0.005, 0.02, 0.1])
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


@pytest.mark.parametrize("old", [0.005, 0.02, 0.1])
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
