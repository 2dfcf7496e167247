# SPDX-License-Identifier: Apache-2.0
"""Laws of motion: symmetry, order of convergence, energy, and no effect of disabled parts."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable
from typing import Any

import pytest

from deltacharger_kinematics.geometry import Vector
from deltacharger_sim.parameters import (
    ContactParameters,
    MagnetParameters,
    PlatformParameters,
    ServoParameters,
    TargetParameters,
    WorldParameters,
)
from deltacharger_sim.world import World

ArmFactory = Callable[..., Any]
SLIPPERY = ServoParameters(friction=0.0)
NO_TARGET = TargetParameters(present=False)
POINTS = ((0.0, 0.0, 0.07), (0.0, 0.0, 0.0865), (0.006, 0.003, 0.0865), (0.0, 0.0, 0.05))


def course(arm: Any, points: tuple[Vector, ...] = POINTS, seconds: float = 0.4) -> list[Vector]:
    """Every position of the platform on its way along commands."""
    places = []
    for point in points:
        arm.aim(point)
        for _ in range(round(seconds / arm.step)):
            arm.world.step(arm.step)
            places.append(arm.world.mechanics.position)
    return places


def apart(first: list[Vector], second: list[Vector]) -> float:
    return max(math.dist(a, b) for a, b in zip(first, second, strict=True))


def rms(coarse: list[Vector], fine: list[Vector]) -> float:
    every = len(fine) // len(coarse)
    squares = [math.dist(place, fine[(index + 1) * every - 1]) ** 2 for index, place in enumerate(coarse)]
    return math.sqrt(statistics.mean(squares))


class TestSymmetry:
    def test_a_third_of_a_turn_changes_nothing_but_the_names_of_the_limbs(self, arm: ArmFactory) -> None:
        cosine, sine = -0.5, math.sqrt(0.75)

        def turned(point: Vector) -> Vector:
            return cosine * point[0] - sine * point[1], sine * point[0] + cosine * point[1], point[2]

        parameters = WorldParameters(gravity_y=0.0)
        straight = course(arm(parameters))
        around = course(arm(parameters), tuple(turned(point) for point in POINTS))
        assert apart([turned(place) for place in straight], around) < 1e-8

    def test_reversed_gravity_sags_in_the_opposite_direction(self, arm: ArmFactory) -> None:
        places = [
            course(arm(WorldParameters(servo=SLIPPERY, target=NO_TARGET, gravity_y=weight)), ((0.0, 0.0, 0.06),))[-1]
            for weight in (-9.81, 9.81)
        ]
        assert places[0][1] == pytest.approx(-places[1][1], abs=1e-9)
        assert places[0][2] == pytest.approx(places[1][2], abs=1e-9)


class TestConvergence:
    def test_the_error_falls_with_the_step(self, arm: ArmFactory) -> None:
        parameters = WorldParameters(servo=SLIPPERY, target=NO_TARGET)
        point = ((0.004, -0.006, 0.012),)
        exact = course(arm(parameters, 1e-4), point, 0.5)
        steps = (0.001, 0.002, 0.005, 0.01)
        errors = [math.log(rms(course(arm(parameters, step), point, 0.5), exact)) for step in steps]
        assert statistics.linear_regression([math.log(step) for step in steps], errors).slope > 0.95

    @pytest.mark.parametrize("step", [0.05, 0.1])
    def test_long_steps_are_halved_until_they_balance(self, arm: ArmFactory, step: float) -> None:
        rough = arm(WorldParameters(), step)
        for goals in ((3.0, 3.0, 3.0), (-1.2, 1.2, 1.2), (-3.0, -3.0, 3.0), (1.2, -1.2, -1.2)):
            for index, goal in enumerate(goals):
                rough.world.command(index, True, goal, 4.1)
            for _ in range(round(1.0 / step)):
                rough.world.step(step)
                assert rough.world.mechanics.imbalance < 0.5
        geometry = rough.world.geometry
        for angle in rough.world.mechanics.angles:
            assert geometry.joint_min - 0.01 < angle < geometry.joint_max + 0.01


class TestEnergy:
    @pytest.mark.parametrize("step", [0.0002, 0.001, 0.005, 0.01, 0.05])
    def test_a_swinging_limp_arm_gains_no_energy(self, arm: ArmFactory, step: float) -> None:
        servo = ServoParameters(unpowered_friction=0.0, friction=0.0)
        world = WorldParameters(servo=servo, magnets=MagnetParameters(force=0.0), target=NO_TARGET, gravity_y=-4.0)
        swinging = arm(world, step)
        swinging.go((0.02, 0.0, 0.06), 1.0)
        swinging.release()
        values = [swinging.energy()]
        for _ in range(round(0.6 / step)):
            swinging.world.step(step)
            values.append(swinging.energy())
        lowest, gain = values[0], 0.0
        for value in values:
            gain, lowest = max(gain, value - lowest), min(lowest, value)
        assert values[0] - values[-1] > 0.03  # it fell
        assert gain < 0.01 * (values[0] - values[-1])

    def test_in_tiny_steps_it_loses_almost_no_energy_on_the_way_to_its_stops(self, arm: ArmFactory) -> None:
        servo = ServoParameters(unpowered_friction=0.0, friction=0.0)
        world = WorldParameters(servo=servo, magnets=MagnetParameters(force=0.0), target=NO_TARGET, gravity_y=-4.0)
        swinging = arm(world, 0.0002)
        swinging.go((0.0, 0.02, 0.06), 1.0)
        swinging.release()
        before = swinging.energy()
        while max(swinging.world.mechanics.angles) < 1.0:
            swinging.world.step(0.0002)
        speed = swinging.world.mechanics.velocity
        moving = 0.5 * 0.319 * sum(v * v for v in speed)
        assert moving > 0.003
        assert swinging.energy() == pytest.approx(before, abs=0.01 * moving)


class TestRest:
    def test_at_rest_the_world_stands_exactly_still(self, arm: ArmFactory) -> None:
        still = arm()
        still.dock()
        still.run(1.0)
        mechanics = still.world.mechanics
        assert mechanics.still
        before = (mechanics.position, mechanics.torques, mechanics.contact_force)
        still.run(1.0)
        assert (mechanics.position, mechanics.torques, mechanics.contact_force) == before
        assert mechanics.velocity == (0.0, 0.0, 0.0)

    def test_a_new_command_ends_the_rest(self, arm: ArmFactory) -> None:
        woken = arm()
        woken.dock()
        woken.run(1.0)
        woken.aim((0.0, 0.0, 0.088))
        woken.run(0.02)
        assert not woken.world.mechanics.still
        assert woken.world.mechanics.contact_force > 0.0


class TestOff:
    @pytest.mark.parametrize(
        "nearly",
        [
            WorldParameters(servo=ServoParameters(stall_sag=1.0, supply_resistance=0.0)),
            WorldParameters(servo=ServoParameters(command_latency=1e-12)),
            WorldParameters(servo=ServoParameters(reading_latency=0.02)),
            WorldParameters(platform=PlatformParameters(lever=0.1)),
            WorldParameters(platform=PlatformParameters(compliance=1e-12)),
            WorldParameters(servo=ServoParameters(backlash=1e-12)),
        ],
        ids=["sag", "late commands", "old readings", "lever", "compliance", "play"],
    )
    def test_an_almost_disabled_part_has_almost_no_effect(self, arm: ArmFactory, nearly: Any) -> None:
        assert apart(course(arm()), course(arm(nearly))) < 2e-8

    def test_disabled_parts_are_not_created(self) -> None:
        world = World(WorldParameters())
        assert world._late is None
        assert world.mechanics._touch.tilt is None  # type: ignore[attr-defined]


class TestSupply:
    def test_a_sagging_supply_reduces_stall_torque(self, arm: ArmFactory) -> None:
        weak = ServoParameters(supply_resistance=0.5, stall_sag=1.0)
        most = []
        for servo in (ServoParameters(supply_resistance=0.5), weak):
            pushing = arm(WorldParameters(servo=servo, contact=ContactParameters(stiffness=1e9)))
            pushing.go((0.0, 0.0, 0.07))
            for index in range(3):
                pushing.world.command(index, True, 1.2, 100.0)
            pushing.run(1.0)
            most.append(max(pushing.world.mechanics.torques))
            voltage = pushing.world.mechanics.voltage
        assert most[0] == pytest.approx(6.0)
        # Torque = stall · voltage/12 with voltage = 12 − R · 3 torque/Kt, solved by hand.
        expected = 6.0 / (1.0 + 6.0 * 0.5 * 3.0 / (12.0 * 6.0 / 4.1))
        assert most[1] == pytest.approx(expected, rel=0.02)
        assert voltage == pytest.approx(12.0 * expected / 6.0, rel=0.02)

    def test_more_than_twelve_volts_adds_no_torque_unless_configured(self, arm: ArmFactory) -> None:
        parameters = WorldParameters(servo=ServoParameters(supply_voltage=12.0, stall_sag=0.0, supply_resistance=0.9))
        assert apart(course(arm()), course(arm(parameters))) == 0.0
