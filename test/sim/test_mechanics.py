# SPDX-License-Identifier: Apache-2.0
"""Laws of the mechanics: statics, limits, friction, energy, and a settled state independent of the step."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable
from typing import Any

import pytest

from deltacharger_core.machine import TORQUE_CONSTANT
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_sim.parameters import (
    ContactParameters,
    MagnetParameters,
    ServoParameters,
    TargetParameters,
    WorldParameters,
)

SLIPPERY = ServoParameters(friction=0.0)
NO_MAGNETS = MagnetParameters(force=0.0)
NO_TARGET = TargetParameters(present=False)
ArmFactory = Callable[..., Any]


def size(vector: Any) -> float:
    return math.sqrt(sum(value * value for value in vector))


class TestStatics:
    def test_the_arm_starts_at_home_and_stays_there_without_power(self, arm: ArmFactory) -> None:
        world = arm().world
        assert world.mechanics.angles == pytest.approx([math.radians(-41.55)] * 3, abs=2e-4)
        for _ in range(200):
            world.step()
        assert size(world.mechanics.position) < 5e-4  # the gears' friction carries it
        assert world.mechanics.torques == (0.0, 0.0, 0.0)

    def test_without_power_its_gears_friction_keeps_it_from_falling(self, arm: ArmFactory) -> None:
        weak = arm(WorldParameters(servo=ServoParameters(unpowered_friction=0.1), target=NO_TARGET))
        weak.go((0.0, 0.0, 0.05))
        weak.release()
        weak.run(3.0)
        assert -0.2 < weak.world.mechanics.position[1] < -0.01
        assert size(weak.world.mechanics.velocity) < 1e-3

    @pytest.mark.parametrize("point", [(0.0, 0.0, 0.02), (0.0, 0.0, 0.08), (0.04, -0.03, 0.06), (-0.05, 0.05, 0.1)])
    def test_at_rest_the_servos_carry_only_the_weight(self, arm: ArmFactory, point: Any) -> None:
        still = arm(WorldParameters(servo=SLIPPERY, target=NO_TARGET))
        still.go(point, 2.0)
        mechanics = still.world.mechanics
        assert mechanics.position == pytest.approx(point, abs=1e-6)
        expected = still.delta.holding_torque(*mechanics.position, still.gravity)
        assert mechanics.torques == pytest.approx(expected, abs=1e-5)

    @pytest.mark.parametrize(("stiffness", "sag"), [(2.5, 23.0), (10.0, 5.9), (15.0, 4.0), (20.0, 3.0)])
    def test_sag_at_the_dock_falls_as_one_over_stiffness(self, arm: ArmFactory, stiffness: float, sag: float) -> None:
        hanging = arm(WorldParameters(servo=ServoParameters(friction=0.0, stiffness=stiffness), target=NO_TARGET))
        hanging.go((0.0, 0.0, 0.08), 2.0, lead=False)
        assert -1000.0 * hanging.world.mechanics.position[1] == pytest.approx(sag, abs=0.1)

    def test_twenty_newtons_at_the_dock_take_0_521_ampere_per_servo(self, arm: ArmFactory) -> None:
        pressing = arm(
            WorldParameters(servo=SLIPPERY, magnets=NO_MAGNETS, contact=ContactParameters(stiffness=1e9), gravity_y=0.0)
        )
        pressing.go((0.0, 0.0, 0.08 + 20.0 / 3435.0), 2.0)  # 15 N·m/rad are 3435 N/m along z
        mechanics = pressing.world.mechanics
        assert mechanics.contact_force == pytest.approx(20.0, rel=0.03)
        for torque in mechanics.torques:
            assert torque / TORQUE_CONSTANT / mechanics.contact_force * 20.0 == pytest.approx(0.5214, abs=2e-4)

    @pytest.mark.parametrize("stiffness", [2.5, 5.0, 15.0, 20.0])
    def test_a_5_mm_step_is_0_030_ampere_per_unit_of_servo_stiffness(self, arm: ArmFactory, stiffness: float) -> None:
        servo = ServoParameters(friction=0.0, stiffness=stiffness)
        pressing = arm(WorldParameters(servo=servo, magnets=NO_MAGNETS))
        rest = max(1.0, 8.0 * servo.damping / stiffness)
        pressing.go((0.0, 0.0, 0.081), rest)
        before = pressing.contact_current
        pressing.go((0.0, 0.0, 0.086), rest)
        assert pressing.contact_current - before == pytest.approx(0.030 * stiffness, rel=0.05)

    def test_friction_hides_only_a_few_newtons(self, arm: ArmFactory) -> None:
        forces = []
        for start in (0.0855, 0.0885):  # the same command reached from below and from above
            rubbing = arm(WorldParameters(magnets=NO_MAGNETS))
            rubbing.go((0.0, 0.0, 0.07))
            rubbing.go((0.0, 0.0, start))
            rubbing.go((0.0, 0.0, 0.087))
            forces.append(rubbing.contact_current / rubbing.world.push())
        assert forces[0] != pytest.approx(forces[1], rel=0.02)
        assert abs(forces[0] - forces[1]) * 20.0 < 0.12  # A at 20 N


class TestLimits:
    @pytest.mark.parametrize("bound", [0.0, 0.3, 0.83])
    def test_no_servo_exceeds_its_current_bound(self, arm: ArmFactory, bound: float) -> None:
        bounded = arm()
        bounded.go((0.0, 0.0, 0.06))
        bounded.aim((0.0, 0.0, 0.105), bound)
        for _ in range(200):
            bounded.world.step()
            assert max(map(abs, bounded.world.mechanics.torques)) <= bound * TORQUE_CONSTANT + 1e-12

    def test_no_servo_exceeds_its_stall_torque(self, arm: ArmFactory) -> None:
        world = arm(WorldParameters(servo=ServoParameters(stall_torque=1.0))).world
        for index in range(3):
            world.command(index, True, 1.2, 100.0)
        for _ in range(200):
            world.step()
            assert max(map(abs, world.mechanics.torques)) <= 1.0 + 1e-12

    def test_a_command_beyond_the_joint_limits_ends_at_the_stops(self, arm: ArmFactory) -> None:
        geometry = DeltaGeometry()
        world = arm(WorldParameters(target=NO_TARGET)).world
        for goal in (-3.0, 3.0):
            for index in range(3):
                world.command(index, True, goal, 4.1)
            for _ in range(400):
                world.step()
            for angle in world.mechanics.angles:
                assert geometry.joint_min - 0.01 < angle < geometry.joint_max + 0.01

    @pytest.mark.parametrize("step", [0.001, 0.005, 0.02, 0.1])
    def test_the_state_stays_finite_for_any_command(self, arm: ArmFactory, step: float) -> None:
        draw = random.Random(3)
        for _ in range(3):
            world = arm().world
            for _ in range(15):
                on = draw.random() < 0.8
                for index in range(3):
                    world.command(index, on, draw.uniform(-2.0, 2.0), draw.choice((0.0, 0.3, 2.8, 4.1)))
                for _ in range(max(1, round(0.1 / step))):
                    world.step(step)
                    state = world.mechanics
                    numbers = (*state.position, *state.velocity, *state.torques, state.contact_force)
                    assert all(map(math.isfinite, numbers))

    def test_a_nan_goal_changes_nothing(self, arm: ArmFactory) -> None:
        still = arm()
        still.go((0.0, 0.0, 0.05))
        before = still.world.mechanics.position
        for index in range(3):
            still.world.command(index, True, math.nan, 4.1)
        still.run(0.5)
        assert still.world.mechanics.position == pytest.approx(before, abs=1e-6)


class TestContact:
    @pytest.mark.parametrize("stiffness", [1e3, 1e5, 1e7, 1e9])
    @pytest.mark.parametrize("step", [0.001, 0.005, 0.02, 0.1])
    def test_settled_force_does_not_depend_on_the_step(self, arm: ArmFactory, stiffness: float, step: float) -> None:
        contact = ContactParameters(stiffness=stiffness)
        pressing = arm(WorldParameters(servo=SLIPPERY, contact=contact, gravity_y=0.0), step)
        pressing.go((0.0, 0.0, 0.07), 0.8)
        pressing.go((0.0, 0.0, 0.086), 1.2)
        world = pressing.world
        # Balance of springs, magnets and electrodes by bisection, without an integrator.
        goal = pressing.delta.inverse(0.0, 0.0, 0.086)[0]
        low, high = 0.080, 0.105
        for _ in range(100):
            z = 0.5 * (low + high)
            lever = pressing.delta.jacobian(0.0, 0.0, z)[6]
            pushed = 15.0 * (goal - pressing.delta.inverse(0.0, 0.0, z)[0]) / lever + 60.0
            low, high = (z, high) if pushed > electrode_force(contact, z - 0.080) else (low, z)
        assert world.mechanics.contact_force == pytest.approx(electrode_force(contact, low - 0.080), rel=1e-3)
        assert size(world.mechanics.velocity) < 1e-6

    @pytest.mark.parametrize("offset", [0.0, 0.004, 0.008])
    def test_the_force_is_the_sum_of_servos_and_magnets(self, arm: ArmFactory, offset: float) -> None:
        pressing = arm(WorldParameters(target=TargetParameters(x=offset)))
        pressing.go((0.0, 0.0, 0.07))
        pressing.go((0.0, 0.0, 0.0865))
        world, mechanics = pressing.world, pressing.world.mechanics
        assert world.push() == pytest.approx(mechanics.contact_force - 60.0 / (1.0 + (offset / 0.008) ** 2), abs=0.2)
        assert world.snapshot().push == world.push()
        # The servos' currents differ from it by the friction of their gears, 1 to 2 N here.
        by_current = pressing.contact_current * 38.4
        assert by_current == pytest.approx(world.push(), abs=2.0)

    def test_the_current_bound_caps_the_push(self, arm: ArmFactory) -> None:
        pressing = arm(WorldParameters(servo=SLIPPERY, gravity_y=0.0))
        pressing.dock()
        pressing.go((0.0, 0.0, 0.105), 1.0, bound=0.6)
        assert 20.0 < pressing.world.push() < 0.6 * 38.4 + 0.1

    def test_soft_electrodes_bottom_at_their_hard_stop(self, arm: ArmFactory) -> None:
        soft = arm(WorldParameters(contact=ContactParameters(stiffness=1e3)))
        soft.dock(0.010)
        assert 0.002 < -soft.world.mechanics.gap < 0.0022

    def test_lateral_force_stays_in_the_friction_cone(self, arm: ArmFactory) -> None:
        still = arm(WorldParameters(servo=SLIPPERY, gravity_y=0.0))
        still.dock()
        mechanics, rest = still.world.mechanics, still.world.mechanics.position
        slid = False
        for side in range(1, 15):
            still.go((0.003 * side, 0.0, 0.0865), 0.3)
            force = still.delta.force(*mechanics.position, mechanics.torques)
            lateral = math.hypot(force[0], force[1])
            assert lateral <= 0.3 * mechanics.contact_force + 0.01
            moved = mechanics.position[0] - rest[0]
            if lateral < 0.28 * mechanics.contact_force:
                assert moved < 2e-4  # it sticks: only the bristles yield
            slid = slid or moved > 1e-3
        assert slid

    def test_friction_holds_the_docked_arm_when_power_is_lost(self, arm: ArmFactory) -> None:
        docked = arm(WorldParameters(servo=ServoParameters(unpowered_friction=0.0)))
        docked.dock()
        docked.release()
        docked.run(1.0)
        assert docked.world.mechanics.contact_force == pytest.approx(60.0, abs=2.0)
        assert abs(docked.world.mechanics.position[1]) < 2e-4


class TestEnergy:
    @pytest.mark.parametrize("step", [0.001, 0.005, 0.02])
    @pytest.mark.parametrize("lateral", [0.0, 0.03])
    def test_energy_never_grows_in_free_fall_onto_target_and_stops(
        self, arm: ArmFactory, step: float, lateral: float
    ) -> None:
        servo = ServoParameters(unpowered_friction=0.0, friction=0.0)
        parameters = WorldParameters(servo=servo, magnets=NO_MAGNETS, gravity_y=-4.0, gravity_z=6.0)
        falling = arm(parameters, step)
        falling.go((lateral, 0.0, 0.05), 1.0)
        falling.release()
        energies = [energy(falling)]
        for _ in range(round(1.5 / step)):
            falling.world.step(step)
            energies.append(energy(falling))
        scale = max(energies) - min(energies)
        assert scale > 0.01  # it fell
        for before, after in itertools.pairwise(energies):
            assert after <= before + 0.02 * scale
        assert energies[-1] == min(energies) or energies[-1] < energies[0] - 0.5 * scale

    def test_a_step_response_of_the_servos_does_not_ring(self, arm: ArmFactory) -> None:
        moving = arm(WorldParameters(target=NO_TARGET), 0.002)
        moving.go((0.0, 0.0, 0.04), 1.5)
        moving.aim((0.0, 0.0, 0.05))
        highest = 0.0
        for _ in range(500):
            moving.world.step(0.002)
            highest = max(highest, moving.world.mechanics.position[2])
        assert highest < 0.0505


def electrode_force(contact: ContactParameters, depth: float) -> float:
    return 2.0 * contact.stiffness * depth + contact.hard_stop_stiffness * max(depth - contact.hard_stop, 0.0)


def energy(falling: Any) -> float:
    """Kinetic energy, weight and elastic energy of electrodes and joint stops (J)."""
    world, geometry = falling.world, DeltaGeometry()
    mechanics, parameters = world.mechanics, world.parameters
    mass = geometry.platform_mass + 1.5 * geometry.rod_mass
    total = 0.5 * mass * size(mechanics.velocity) ** 2 + 0.5 * parameters.servo.inertia * size(mechanics.rates) ** 2
    total -= mass * (parameters.gravity_y * mechanics.position[1] + parameters.gravity_z * mechanics.position[2])
    elbow = 0.5 * geometry.rod_mass * geometry.arm
    directions = ((1.0, 0.0), (-0.5, math.sqrt(0.75)), (-0.5, -math.sqrt(0.75)))
    for angle, (_, sine) in zip(mechanics.angles, directions, strict=True):
        total -= elbow * (parameters.gravity_z * math.sin(angle) + parameters.gravity_y * sine * math.cos(angle))
        beyond = max(geometry.joint_min - angle, angle - geometry.joint_max, 0.0)
        total += 0.5 * 2000.0 * beyond * beyond
    depth = max(-mechanics.gap, 0.0)
    return total + parameters.contact.stiffness * depth * depth
