# SPDX-License-Identifier: Apache-2.0
"""A platform that yields to an off-centre or tilted contact: closed forms, limits, effects."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from deltacharger_sim import pads, touch
from deltacharger_sim.parameters import (
    ContactParameters,
    PlatformParameters,
    ServoParameters,
    TargetParameters,
    WorldParameters,
)
from deltacharger_tactile.contact import ContactModel

ArmFactory = Callable[..., Any]
SOFT = 0.005  # rad/(N·m)
PADS = 2.0 * 1.5e5 * 0.048**2  # N·m/rad, both pads about y


def tilting(
    compliance: float = SOFT, at: tuple[float, float] = (0.0, 0.0), stiffness: float = 1e5, **target: float
) -> touch.PlatformTilt:
    tilt = touch.PlatformTilt(
        WorldParameters(
            contact=ContactParameters(stiffness=stiffness),
            platform=PlatformParameters(compliance=compliance),
            target=TargetParameters(**target),
        )
    )
    tilt.lie(*at)
    return tilt


@pytest.mark.parametrize(
    ("place", "slope"), [((0.0, 0.0), (0.01, 0.0)), ((0.004, -0.003), (0.0, 0.0)), ((-0.01, 0.006), (-0.005, 0.02))]
)
def test_the_stiffness_is_the_slope_of_the_force(place: tuple[float, float], slope: tuple[float, float]) -> None:
    tilt = tilting(at=place, tilt_x=slope[0], tilt_y=slope[1])
    step = 1e-8
    for depth in (5e-5, 3e-4, 1e-3, 2.5e-3):
        _, stiffness = tilt.press(depth)
        ahead, behind = (tilt.press(depth + sign * step)[0] for sign in (1.0, -1.0))
        assert stiffness == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-3)


def bed(tilt: touch.PlatformTilt, depth: float, at: tuple[float, float], angles: np.ndarray) -> np.ndarray:
    """Return Σ N, Σ u N less the pads' moment, and Σ v N of 20 000 springs along each bar, from their positions."""
    x, y = at
    tilt_x, tilt_y = tilt._target
    along = 0.5 * x + (0.07 - abs(x)) * ((np.arange(20000) + 0.5) / 20000 - 0.5)
    found = np.zeros(3)
    for v in (0.5 * y + 0.0087, 0.5 * y - 0.0087):
        own = depth + angles[0] * v - angles[1] * along
        pressed = own - (tilt_x * (v - y) - tilt_y * (along - x))  # of the target's face, tilted about its centre
        forces = tilt._stiffness * np.maximum(pressed, 0.0) + tilt._stop * np.maximum(pressed - 0.002, 0.0)
        found += np.mean(forces) * np.array([1.0, 0.0, v]) + np.array([0.0, np.mean(forces * along), 0.0])
    most = 0.048 * found[0]
    return found - [0.0, np.clip(PADS * (angles[1] - tilt_y), -most, most), 0.0]


@pytest.mark.parametrize("slope", [(0.0, 0.1), (-0.03, 0.06), (0.002, -0.001)])
@pytest.mark.parametrize("compliance", [0.0, 0.01, 0.1])
@pytest.mark.parametrize("stiffness", [1e3, 1e7])
def test_force_and_tilt_agree_with_a_bed_of_springs_and_two_pads(
    stiffness: float, compliance: float, slope: tuple[float, float]
) -> None:
    at = (0.006, -0.002)
    tilt = tilting(compliance, at, stiffness, tilt_x=slope[0], tilt_y=slope[1])
    low, high = -0.01, 0.2
    for _ in range(60):
        depth = 0.5 * (low + high)
        low, high = (low, depth) if tilt.press(depth)[0] > 80.0 else (depth, high)
    force, _ = tilt.press(depth)
    assert force == pytest.approx(80.0, rel=1e-3)
    angles = np.array(tilt.angles)
    # Moments and compliance balance at only one point: it must be this one.
    total, about_y, about_x = bed(tilt, depth, at, angles)
    assert total == pytest.approx(force, rel=0.005)
    if compliance > 0.0:
        assert angles == pytest.approx([-compliance * about_x, compliance * about_y], rel=0.005, abs=1e-9)
    bars = tilt.keep()[1]
    assert bars.upper + bars.lower == pytest.approx(force, rel=0.005)
    if compliance > 0.0:
        arm = 0.0087 * (bars.upper - bars.lower) + 0.5 * at[1] * force
        assert angles[0] == pytest.approx(-compliance * arm, rel=0.005, abs=1e-9)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_tilt_moves_the_terminals_and_so_the_clearance_unless_friction_holds_them(
    arm: ArmFactory, friction: float
) -> None:
    results = []
    for compliance in (0.0, 0.02):
        parameters = WorldParameters(
            servo=ServoParameters(friction=0.0),
            contact=ContactParameters(friction=friction),
            platform=PlatformParameters(compliance=compliance, lever=0.05),
            target=TargetParameters(y=0.002),
        )
        touching = arm(parameters)
        touching.go((0.0, 0.0, 0.07))
        touching.go((0.0, 0.0, 0.0865))
        results.append((touching.world.snapshot().clearance, touching.world.mechanics.tilt))
    (rigid, none), (soft, angles) = results
    assert none == (0.0, 0.0)
    assert angles[0] < 0.0
    # If friction holds the face, the platform swings the other way.
    swung = -0.05 * angles[0]
    assert soft - rigid == pytest.approx(swung if friction == 0.0 else 0.0, abs=0.25 * swung)


@pytest.mark.parametrize("force", [60.0, 100.0])
def test_the_pads_moment_agrees_with_the_tactile_contact_model(force: float) -> None:
    """One stiffness represents a force-dependent one: within a tenth at 60 to 100 N."""
    model, turn = ContactModel(), touch.PADS_TURN
    distance = model.parameters.pad_distance
    assert distance == touch.PAD
    for residual in (1e-4, 3e-3, 0.05):
        left, right = model.solve((0.0, 0.0, 0.0), force, (0.0, residual))[0].sum(axis=(1, 2))
        expected = min(turn * residual, force * touch.PAD)
        assert distance * (left - right) == pytest.approx(expected, rel=0.12)


def yawed_target_comes_nearer_on_that_side_and_loads_that_pad(arm: ArmFactory, source: Any, compliance: float) -> None:
    """The law of every source of frames; the laboratory's has it, too."""
    differences = []
    for yaw in (-0.03, 0.03):
        parameters = WorldParameters(
            platform=PlatformParameters(compliance=compliance), target=TargetParameters(tilt_y=yaw)
        )
        touching = arm(parameters, tactile=source(rig_seed=1))
        touching.dock()
        left, right = np.nansum(np.array(touching.world.taxels()), axis=(1, 2))
        differences.append(left - right)  # left is at +x
        (_, residual), free = touching.world.mechanics.lean
        assert free == (0.0, -yaw)
        assert residual == pytest.approx(-yaw) if compliance == 0.0 else 0.0 < -residual / yaw < 0.5
    assert differences[1] > differences[0] + 5.0


def test_a_target_yawed_about_y_comes_nearer_on_that_side_and_loads_that_pad(arm: ArmFactory) -> None:
    yawed_target_comes_nearer_on_that_side_and_loads_that_pad(arm, pads.ContactSource, SOFT)
