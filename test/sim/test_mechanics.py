# SPDX-License-Identifier: Apache-2.0
"""Laws of the mechanics: statics, limits, contact, energy, symmetry, rest, and parts that are disabled."""

import itertools
import math
import random
from collections.abc import Callable
from typing import Any

import pytest

from deltacharger_core.machine import STALL_TORQUE, TORQUE_CONSTANT
from deltacharger_kinematics.geometry import DeltaGeometry, LimbAdjustment
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_sim import parameters
from deltacharger_sim.mechanics import Linkage
from deltacharger_sim.world import World
from test.plain import plain_servo

DELTA = ScalarDelta()
SLIPPERY = plain_servo(friction=0.0)
SWINGING = plain_servo(friction=0.0, viscosity=0.02, damping=0.0)
LIMP = plain_servo(friction=0.0, unpowered_friction=0.0)
NO_MAGNETS = parameters.MagnetParameters(force=0.0)
NO_TARGET = parameters.TargetParameters(present=False)
ArmFactory = Callable[..., Any]


def test_its_gears_friction_carries_the_arm_without_power(arm: ArmFactory) -> None:
    limp = arm()
    limp.run(1.0)
    assert math.hypot(*limp.world.mechanics.position) < 5e-4
    assert limp.world.mechanics.torques == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("point", [(0.0, 0.0, 0.08), (-0.05, 0.05, 0.1)])
def test_at_rest_the_servos_carry_only_the_weight(arm: ArmFactory, point: Any) -> None:
    still = arm(parameters.WorldParameters(servo=SLIPPERY, target=NO_TARGET))
    still.go(point, 2.0)
    mechanics = still.world.mechanics
    assert mechanics.position == pytest.approx(point, abs=1e-6)
    expected = still.delta.holding_torque(*mechanics.position, still.gravity)
    assert mechanics.torques == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("bound", [0.0, 0.3, 100.0])
def test_no_servo_exceeds_its_current_bound_or_its_stall_torque(arm: ArmFactory, bound: float) -> None:
    bounded = arm(parameters.WorldParameters(servo=plain_servo(stiffness=40.0)))
    bounded.go((0.0, 0.0, 0.06))
    bounded.aim((0.0, 0.0, 0.105), bound)
    for _ in range(200):
        bounded.world.step()
        assert max(map(abs, bounded.world.mechanics.torques)) <= min(bound * TORQUE_CONSTANT, STALL_TORQUE) + 1e-12


@pytest.mark.parametrize("step", [0.001, 0.1])
def test_the_state_stays_finite_balanced_and_between_the_stops_for_any_command(arm: ArmFactory, step: float) -> None:
    """Long steps are halved until they balance."""
    draw, geometry = random.Random(3), DeltaGeometry()
    rough = arm(parameters.WorldParameters(), step)
    for trial in range(40):
        beyond = trial % 8 == 0  # the stops, for long enough to come to rest there
        for index in range(3):
            goal = draw.choice((-3.0, 3.0, math.nan)) if beyond else draw.uniform(-2.0, 2.0)
            current = 4.1 if beyond else draw.choice((0.0, 0.3, 2.8, 4.1))
            rough.world.command(index, beyond or draw.random() < 0.8, goal, current)
        for _ in range(max(1, round((1.0 if beyond else 0.1) / step))):
            rough.world.step(step)
            state = rough.world.mechanics
            numbers = (*state.position, *state.velocity, *state.torques, state.contact_force)
            assert all(map(math.isfinite, numbers))
            assert state.imbalance < 0.5
        if beyond:
            assert all(geometry.joint_min - 0.01 < a < geometry.joint_max + 0.01 for a in state.angles)


def electrode_force(contact: parameters.ContactParameters, depth: float) -> float:
    return 2.0 * contact.stiffness * depth + contact.hard_stop_stiffness * max(depth - contact.hard_stop, 0.0)


@pytest.mark.parametrize(("stiffness", "step"), [(1e3, 0.02), (1e5, 0.001), (1e9, 0.1)])
def test_settled_force_does_not_depend_on_the_step(arm: ArmFactory, stiffness: float, step: float) -> None:
    contact = parameters.ContactParameters(stiffness=stiffness)
    pressing = arm(parameters.WorldParameters(servo=SLIPPERY, contact=contact, gravity_y=0.0), step)
    pressing.go((0.0, 0.0, 0.07), 0.8)
    pressing.go((0.0, 0.0, 0.086), 1.2)
    mechanics = pressing.world.mechanics
    # Balance of springs, magnets and electrodes by bisection, without an integrator.
    goal = pressing.delta.inverse(0.0, 0.0, 0.086)[0]
    low, high = 0.080, 0.105
    for _ in range(100):
        z = 0.5 * (low + high)
        lever = pressing.delta.jacobian(0.0, 0.0, z)[6]
        pushed = 15.0 * (goal - pressing.delta.inverse(0.0, 0.0, z)[0]) / lever + 60.0
        low, high = (z, high) if pushed > electrode_force(contact, z - 0.080) else (low, z)
    assert mechanics.contact_force == pytest.approx(electrode_force(contact, low - 0.080), rel=1e-3)
    assert math.hypot(*mechanics.velocity) < 1e-6


@pytest.mark.parametrize("offset", [0.0, 0.008])
def test_the_force_is_the_sum_of_servos_and_magnets(arm: ArmFactory, offset: float) -> None:
    pressing = arm(parameters.WorldParameters(servo=plain_servo(), target=parameters.TargetParameters(x=offset)))
    pressing.go((0.0, 0.0, 0.07))
    pressing.go((0.0, 0.0, 0.0865))
    world, mechanics = pressing.world, pressing.world.mechanics
    aside = math.hypot(*world.misalignment[:2])
    assert offset - 0.004 < aside <= max(offset, 0.0005)
    assert world.push() == pytest.approx(mechanics.contact_force - 60.0 / (1.0 + (aside / 0.008) ** 2), abs=0.01)
    # The servos' currents differ from it by the friction of their gears: 3 · 0.1 N·m over 0.116 m are 2.6 N.
    assert pressing.contact_current * 38.4 == pytest.approx(world.push(), abs=2.7)


@pytest.mark.parametrize(("step", "lateral"), [(0.001, 0.0), (0.05, 0.02)])
def test_energy_never_grows_in_free_fall_onto_target_and_stops(arm: ArmFactory, step: float, lateral: float) -> None:
    falling = arm(parameters.WorldParameters(servo=LIMP, magnets=NO_MAGNETS, gravity_y=-4.0, gravity_z=6.0), step)
    falling.go((lateral, 0.0, 0.05), 1.0)
    falling.release()
    energies = [falling.energy()]
    for _ in range(round(1.5 / step)):
        falling.world.step(step)
        energies.append(falling.energy())
    scale = max(energies) - min(energies)
    assert scale > 0.01  # it fell
    assert all(after <= before + 0.02 * scale for before, after in itertools.pairwise(energies))


def test_without_a_d_gain_only_viscosity_brakes_a_swing() -> None:
    swings = []
    for servo, braking in ((plain_servo(friction=0.0, viscosity=0.02), 0.0), (SWINGING, 1.0)):
        world = World(parameters.WorldParameters(servo=servo, target=NO_TARGET, gravity_y=0.0), start=(0.0, 0.0, 0.08))
        for index, goal in enumerate(DELTA.inverse(0.0, 0.0, 0.081)):
            world.command(index, True, goal, 4.1, 1.0, braking)
        swings.append([])
        for _ in range(500):
            world.step(0.002)
            swings[-1].append(world.mechanics.position[2] - 0.081)
    assert swings[0] == swings[1]
    # m z̈ + c ż + k z = 0, its envelope over the last 0.8 s.
    geometry, turn = DeltaGeometry(), 1.0 / sum(DELTA.jacobian(0.0, 0.0, 0.081)[6:])
    mass = geometry.platform_mass + 1.5 * geometry.rod_mass + 3.0 * SWINGING.inertia * turn * turn
    decay = math.exp(-0.5 * 3.0 * 0.02 * turn * turn / mass * 0.8)
    assert max(swings[0][400:]) / max(swings[0][:100]) == pytest.approx(decay, rel=0.05)


def test_gears_take_their_friction_and_a_share_of_the_torque_from_a_push(arm: ArmFactory) -> None:
    servo = plain_servo(damping=3.0, friction=0.1, friction_share=0.2)  # it creeps, so that it ends pushing
    soft = parameters.ContactParameters(stiffness=1e4)  # its compression of 1 mm stretches the gears' bristles
    pressing = arm(parameters.WorldParameters(servo=servo, contact=soft, magnets=NO_MAGNETS, gravity_y=0.0))
    pressing.go((0.0, 0.0, 0.07))
    pressing.go((0.0, 0.0, 0.09), 3.0)
    mechanics = pressing.world.mechanics
    left = 0.8 * mechanics.torques[0] - 0.1
    assert mechanics.contact_force == pytest.approx(left / DELTA.jacobian(*mechanics.position)[6], rel=1e-4)


def test_at_rest_the_world_stands_exactly_still_until_a_new_command(arm: ArmFactory) -> None:
    still = arm()
    still.dock()
    still.run(1.0)
    mechanics = still.world.mechanics
    assert mechanics.still
    before = (mechanics.position, mechanics.torques, mechanics.contact_force)
    still.run(1.0)
    assert (mechanics.position, mechanics.torques, mechanics.contact_force) == before
    assert mechanics.velocity == (0.0, 0.0, 0.0)
    still.aim((0.0, 0.0, 0.088))
    still.run(0.02)
    assert not mechanics.still


ADJUSTED = DeltaGeometry(
    limbs=(
        LimbAdjustment(radius_offset=5e-4, angle_offset=0.02),
        LimbAdjustment(tangential_offset=-3e-4, arm=0.1004),
        LimbAdjustment(height_offset=2e-4, rod=0.1797),
    )
)


@pytest.mark.parametrize("geometry", [DeltaGeometry(), ADJUSTED], ids=["usual", "adjusted"])
def test_angles_their_slopes_and_turns_agree_with_the_kinematics(geometry: DeltaGeometry) -> None:
    linkage, delta, step, draw = Linkage(geometry), ScalarDelta(geometry), 1e-6, random.Random(5)
    for _ in range(50):
        place = (draw.uniform(-0.06, 0.06), draw.uniform(-0.06, 0.06), draw.uniform(0.0, 0.11))
        here = linkage.linearise(*place)
        assert here is not None
        angles, rows, turns = here
        assert angles == pytest.approx(delta.inverse(*place), abs=1e-14)
        for index, (angle, turn) in enumerate(zip(angles, turns, strict=True)):
            true = angle + geometry.limb(index).angle_offset
            assert turn == pytest.approx((math.cos(true), math.sin(true)), abs=1e-14)
        for axis in range(3):
            near = [tuple(p + sign * step * (i == axis) for i, p in enumerate(place)) for sign in (1.0, -1.0)]
            ahead, behind = (delta.inverse(*point) for point in near)
            slopes = [(ahead[limb] - behind[limb]) / (2.0 * step) for limb in range(3)]
            assert [row[axis] for row in rows] == pytest.approx(slopes, abs=1e-6)
