# SPDX-License-Identifier: Apache-2.0
"""A leaning contact: MuJoCo and the light model against statics, and against each other in motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_sim import mujoco_model
from deltacharger_sim.mujoco_springs import IMPEDANCE, share, share_impedance
from deltacharger_sim.mujoco_world import mujoco_world, pull
from deltacharger_sim.parameters import (
    ContactParameters,
    PlatformParameters,
    ServoParameters,
    TargetParameters,
    WorldParameters,
)

ArmFactory = Callable[..., Any]
COMMAND = 0.086  # m


def leaning(
    compliance: float, pitch: float, yaw: float, stiffness: float = 1e5, roll: float = 0.0, **changes: Any
) -> WorldParameters:
    """Angles in degrees; the platform tilts about its own face, where friction has no lever."""
    return WorldParameters(
        contact=ContactParameters(stiffness=stiffness, hard_stop_stiffness=max(1e6, 2.0 * stiffness)),
        platform=PlatformParameters(compliance=compliance, lever=0.0),
        target=TargetParameters(roll=math.radians(roll), tilt_x=math.radians(pitch), tilt_y=math.radians(yaw)),
        **changes,
    )


def settled(arm: ArmFactory, parameters: WorldParameters, mujoco: bool) -> Any:
    """Dock on the axis and wait; return the motion."""
    pressing = arm(parameters)
    if mujoco:
        pytest.importorskip("mujoco", reason="the reference of the simulation is deltacharger[sim]")
        pressing.world = mujoco_world(parameters, step=2e-4)
    pressing.go((0.0, 0.0, 0.07), 0.6)
    pressing.go((0.0, 0.0, COMMAND), 1.4)
    return pressing.world.mechanics


def statics(parameters: WorldParameters) -> tuple[float, float, float]:
    """Return force (N) and tilt about x and y (rad) on the axis, weightless, by springs, magnets and root finding."""
    from scipy.optimize import brentq, minimize

    delta, servo, target = ScalarDelta(), parameters.servo.stiffness, parameters.target
    compliance, contact = parameters.platform.compliance, parameters.contact
    pads = 2.0 * contact.pad_stiffness * 0.048**2
    u, v = np.meshgrid(0.07 * ((np.arange(2000) + 0.5) / 2000 - 0.5), (0.0087, -0.0087))

    def compressed(depth: float, tilt: np.ndarray) -> np.ndarray:
        return np.maximum(depth + (tilt[0] - target.tilt_x) * v - (tilt[1] - target.tilt_y) * u, 0.0)

    def pressed(depth: float, tilt: np.ndarray, power: int) -> float:
        springs = compressed(depth, tilt)
        stops = np.maximum(springs - contact.hard_stop, 0.0)
        each = contact.stiffness * springs**power + 0.5 * contact.hard_stop_stiffness * stops**power
        return float(np.sum(each)) / 2000

    def borne(depth: float) -> float:
        z = target.z + depth
        lever = sum(delta.jacobian(0.0, 0.0, z)[6:]) / 3.0
        push = servo * (delta.inverse(0.0, 0.0, COMMAND)[0] - delta.inverse(0.0, 0.0, z)[0]) / lever
        return push + pull(parameters.magnets, -depth, 0.0)

    def tilted(depth: float) -> np.ndarray:
        most = 0.048 * borne(depth)  # N·m of one pad that bears the total force

        def energy(scaled: np.ndarray) -> float:
            tilt = 0.01 * scaled
            springs = pressed(depth, tilt, 2)
            yaw = abs(tilt[1] - target.tilt_y)
            held = pads * yaw**2 if pads * yaw < most else 2.0 * most * yaw - most**2 / pads
            return float(0.5 * (tilt @ tilt / compliance + springs + held))

        if compliance == 0.0:
            return np.zeros(2)
        return 0.01 * minimize(energy, np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-12}).x

    def force(depth: float) -> float:
        return pressed(depth, tilted(depth), 1)

    depth = brentq(lambda depth: borne(depth) - force(depth), -0.002, 0.002, xtol=1e-9)
    return (force(depth), *tilted(depth))


@pytest.mark.parametrize("mujoco", [False, True])
@pytest.mark.parametrize(
    ("compliance", "pitch", "yaw", "stiffness"),
    [
        (0.0, 0.0, 2.0, 1e5),
        (0.02, 0.0, 1.0, 1e5),
        (0.01, 0.0, 2.0, 1e6),
        (0.03, 2.0, 0.0, 1e6),
        (0.02, -2.0, 1.5, 1e5),
        (0.01, 0.0, 5.0, 1e5),
        (0.01, 0.0, -4.0, 3e4),
        (0.03, -3.0, 5.0, 1e6),
    ],
)
def test_force_and_tilt_at_rest_agree_with_statics(
    arm: ArmFactory, mujoco: bool, compliance: float, pitch: float, yaw: float, stiffness: float
) -> None:
    parameters = leaning(compliance, pitch, yaw, stiffness, servo=ServoParameters(friction=0.0), gravity_y=0.0)
    force, alpha, beta = statics(parameters)
    found = settled(arm, parameters, mujoco)
    # The statics assume small angles, MuJoCo does not.
    assert found.contact_force == pytest.approx(force, rel=0.005 if abs(yaw) < 5.0 else 0.012)
    assert found.peak_force >= found.contact_force
    assert found.tilt == pytest.approx((alpha, beta), rel=0.01 if abs(yaw) < 5.0 else 0.02, abs=2e-5)
    residual = alpha - math.radians(pitch), beta - math.radians(yaw)
    assert found.lean.residual == pytest.approx(residual, rel=0.02, abs=3e-5)
    assert found.lean.free == pytest.approx((-math.radians(pitch), -math.radians(yaw)))
    assert found.bars.upper + found.bars.lower == pytest.approx(found.contact_force)
    if compliance > 0.0:  # the difference of the bars' forces turns the platform about x
        assert found.bars.lower - found.bars.upper == pytest.approx(alpha / compliance / 0.0087, rel=0.02, abs=0.1)


@pytest.mark.parametrize("compliance", [0.01, 0.03])
@pytest.mark.parametrize(
    "lean", [(3.0, 0.0, 1e6), (-2.0, 4.0, 1e5), (0.0, 5.0, 3e4), (2.0, 0.0, 1e5, 12.0), (-2.0, 1.0, 3e4, -8.0)]
)
def test_both_give_equal_forces_on_each_bar(arm: ArmFactory, compliance: float, lean: tuple[float, ...]) -> None:
    parameters = leaning(compliance, *lean, servo=ServoParameters(friction=0.0), gravity_y=0.0)
    light, other = (settled(arm, parameters, mujoco) for mujoco in (False, True))
    assert other.contact_force == pytest.approx(light.contact_force, rel=0.01)
    assert other.bars[:2] == pytest.approx(light.bars[:2], rel=0.03, abs=0.5)
    assert other.bars[2:] == pytest.approx(light.bars[2:], abs=0.06)  # a point of 24 more or less
    assert other.lean.residual == pytest.approx(light.lean.residual, rel=0.02, abs=2e-4)


def test_both_agree_in_docking_with_friction_weight_and_a_lever(arm: ArmFactory) -> None:
    pytest.importorskip("mujoco", reason="the reference of the simulation is deltacharger[sim]")
    parameters = replace(leaning(0.02, -1.0, 2.0), platform=PlatformParameters(compliance=0.02, lever=0.02))
    light, other = arm(parameters), arm(parameters)
    other.world = mujoco_world(parameters, step=2e-4)
    squares = []
    for tick in range(24):
        for each in (light, other):
            each.aim((0.0, 0.0, 0.06 + 0.026 * min((tick + 1) / 16.0, 1.0)))
            each.run(0.05)
        squares.append(math.dist(light.world.mechanics.position, other.world.mechanics.position) ** 2)
    # While the face swings aside by 0.7 mm, friction grows with the force: the motion decides whether it holds.
    assert math.sqrt(sum(squares[5:]) / len(squares[5:])) < 1.6e-4
    first, second = light.world.mechanics, other.world.mechanics
    # Friction holds the face while it swings aside by lever · tilt, so that the platform moves the other way.
    assert second.position[0] < -0.5 * 0.02 * second.tilt[1] < 0.0
    assert first.position[0] == pytest.approx(second.position[0], abs=1.6e-4)
    assert first.tilt == pytest.approx(second.tilt, rel=0.05)


def test_the_stop_holds_an_end_that_is_pressed_beyond_its_travel(arm: ArmFactory) -> None:
    parameters = leaning(0.0, 0.0, 5.0, 1e3, servo=ServoParameters(friction=0.0), gravity_y=0.0)
    light, other = (settled(arm, parameters, mujoco) for mujoco in (False, True))
    assert -light.gap + 0.035 * math.radians(5.0) > 0.002
    assert other.contact_force == pytest.approx(light.contact_force, rel=0.01)
    assert other.gap == pytest.approx(light.gap, abs=4e-5)


@pytest.mark.parametrize("count", [1, 16])
def test_constraints_in_parallel_are_as_stiff_and_as_hard_as_one(count: int) -> None:
    inverse, d = 2.0, share_impedance(count)
    s, b = share(1e5, inverse, count)
    assert count * -s / ((1.0 - d) * inverse) == pytest.approx(1e5)
    assert (1.0 - d) / d / count == pytest.approx((1.0 - IMPEDANCE) / IMPEDANCE)
    assert count * b / (1.0 - d) == pytest.approx(share(1e5, inverse, 1)[1] / (1.0 - IMPEDANCE))


def test_a_level_contact_uses_the_model_of_two_spheres() -> None:
    pytest.importorskip("mujoco", reason="the reference of the simulation is deltacharger[sim]")
    integrator = mujoco_model.integrators()[0]
    level = mujoco_model.build(WorldParameters(), DeltaGeometry(), 1e-3, integrator)
    assert (level.npair, level.njnt, level.neq) == (2, 12, 3)
    leans = mujoco_model.build(leaning(0.01, 0.0, 1.0), DeltaGeometry(), 1e-3, integrator)
    assert (leans.njnt, leans.neq) == (14, 6)
    assert leans.npair > 2
