# SPDX-License-Identifier: Apache-2.0
"""Laws of an impact within a step: energy, the spring alone, rest, and independence of the step."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_sim.parameters import (
    ContactParameters,
    MagnetParameters,
    WorldParameters,
)
from deltacharger_sim.world import World
from test.plain import plain_servo

ArmFactory = Callable[..., Any]
NO_MAGNETS = MagnetParameters(force=0.0)
SLIPPERY = plain_servo(friction=0.0, unpowered_friction=0.0)
DELTA = ScalarDelta()
STEPS = (0.001, 0.005, 0.01, 0.02)


def mass_along_z(world: World, z: float) -> float:
    """Effective mass on the axis, kg: platform, rods, and rotors through the Jacobian."""
    geometry, turn = world.geometry, 1.0 / sum(DELTA.jacobian(0.0, 0.0, z)[6:])
    rotors = 3.0 * world.parameters.servo.inertia * turn * turn
    return geometry.platform_mass + 1.5 * geometry.rod_mass + rotors


def thrown(speed: float, stiffness: float, step: float, gap: float = 0.002, **changes: Any) -> World:
    """A limp arm without friction and weight that flies at its target, until after its bounce."""
    parameters = WorldParameters(
        servo=SLIPPERY, contact=ContactParameters(stiffness=stiffness), magnets=NO_MAGNETS, gravity_y=0.0, **changes
    )
    world = World(parameters, start=(0.0, 0.0, 0.08 - gap))
    mechanics: Any = world.mechanics
    turn = 1.0 / sum(DELTA.jacobian(0.0, 0.0, 0.08 - gap)[6:])
    mechanics.velocity = (0.0, 0.0, speed)
    mechanics.rates = mechanics._spin = (turn * speed,) * 3
    for _ in range(round(0.3 / step)):
        world.step(step)
    return world


class TestSpring:
    @pytest.mark.parametrize("stiffness", [1e5, 1e9])
    @pytest.mark.parametrize("speed", [0.01, 0.12])
    @pytest.mark.parametrize("step", [0.001, 0.005, 0.02])
    def test_an_undamped_strike_peaks_at_v_times_the_root_of_k_m(
        self, step: float, stiffness: float, speed: float
    ) -> None:
        world = thrown(speed, stiffness, step)
        expected = speed * math.sqrt(2.0 * stiffness * mass_along_z(world, 0.08))
        assert world.record.contacts == 1
        assert world.record.peak_force == pytest.approx(expected, rel=0.03)

    def test_a_spring_that_bottoms_strikes_its_stop(self) -> None:
        world = thrown(0.12, 1e3, 0.005)
        contact, mass = world.parameters.contact, mass_along_z(world, 0.08)
        # Energy: ½ m v² = k s² + 2 k s d + (k + K/2) d² with the travel s to the stop and d beyond it.
        k, stop, s = contact.stiffness, contact.hard_stop_stiffness, contact.hard_stop
        left, b, a = 0.5 * mass * 0.12**2 - k * s * s, 2.0 * k * s, k + 0.5 * stop
        beyond = (-b + math.sqrt(b * b + 4.0 * a * left)) / (2.0 * a)
        expected = 2.0 * k * (s + beyond) + stop * beyond
        assert world.record.peak_force == pytest.approx(expected, rel=0.03)


class TestQuiet:
    def test_resting_and_gently_pressed_contacts_have_no_strike(self, arm: ArmFactory) -> None:
        found = arm(WorldParameters(contact=ContactParameters(stiffness=1e6)), 0.01)
        found.dock()
        for depth in (0.083, 0.085, 0.084):
            found.world.record.peak_force = 0.0
            found.aim((0.0, 0.0, depth))
            highest = 0.0
            for _ in range(100):
                found.world.step(0.01)
                highest = max(highest, found.world.mechanics.contact_force)
            assert found.world.record.peak_force == highest
            assert found.world.mechanics.peak_force == found.world.mechanics.contact_force
