# SPDX-License-Identifier: Apache-2.0
"""A platform that yields to an off-centre or tilted contact: closed forms, limits, what it changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from deltacharger_sim.parameters import (
    ContactParameters,
    PlatformParameters,
    ServoParameters,
    TargetParameters,
    WorldParameters,
)
from deltacharger_sim.tilt import PlatformTilt, tilts
from deltacharger_sim.world import World

ArmFactory = Callable[..., Any]
SOFT = 0.005  # rad/(N·m)


def tilting(compliance: float = SOFT, **target: float) -> PlatformTilt:
    return PlatformTilt(
        WorldParameters(platform=PlatformParameters(compliance=compliance), target=TargetParameters(**target))
    )


def test_a_rigid_platform_on_a_straight_target_needs_none_of_this() -> None:
    assert not tilts(WorldParameters())
    assert tilts(WorldParameters(platform=PlatformParameters(compliance=SOFT)))
    assert tilts(WorldParameters(target=TargetParameters(tilt_y=0.01)))


def test_a_centred_contact_presses_flat_and_as_hard_as_without() -> None:
    tilt = tilting()
    force, stiffness = tilt.press(4e-4, 0.0, 0.0)
    assert (force, stiffness) == pytest.approx((80.0, 2e5))
    assert tilt.angles == pytest.approx((0.0, 0.0))
    assert tilt.left_share == 0.5


def test_an_off_centre_contact_tilts_by_compliance_times_moment() -> None:
    tilt = tilting()
    for x, y in ((0.006, 0.0), (0.0, -0.004), (0.006, -0.004)):
        force, _ = tilt.press(4e-4, x, y)
        # The springs meet the target half way between the centres; their own stiffness against turning adds c Σ k v².
        terminal = WorldParameters().terminal
        around_x = 2e5 * (0.5 * (terminal.gap + terminal.height)) ** 2
        around_y = 2e5 * (terminal.length - abs(x)) ** 2 / 12.0
        assert tilt.angles[0] == pytest.approx(-SOFT * 0.5 * y * force / (1.0 + SOFT * around_x), rel=1e-6)
        assert tilt.angles[1] == pytest.approx(SOFT * 0.5 * x * force / (1.0 + SOFT * around_y), rel=1e-6)
        assert np.sign(tilt.left_share - 0.5) == np.sign(x)


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.004, -0.003), (-0.01, 0.006)])
@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.01, 0.0), (-0.005, 0.02)])
def test_the_stiffness_is_the_slope_of_the_force(place: tuple[float, float], slope: tuple[float, float]) -> None:
    tilt = tilting(tilt_x=slope[0], tilt_y=slope[1])
    step = 1e-8
    for depth in (5e-5, 3e-4, 1e-3, 2.5e-3):
        _, stiffness = tilt.press(depth, *place)
        ahead, behind = (tilt.press(depth + sign * step, *place)[0] for sign in (1.0, -1.0))
        assert stiffness == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-3)


def test_a_tilted_target_is_touched_at_its_nearer_edge_first() -> None:
    tilt = tilting(compliance=0.0, tilt_y=0.02)
    assert tilt.press(-1e-3, 0.0, 0.0)[0] == 0.0
    force, _ = tilt.press(-2e-4, 0.0, 0.0)  # the centre is still 0.2 mm away
    assert force > 0.0
    # By the lever rule: it presses at the nearer points of both electrodes alone, the pads are 48 mm from the middle.
    assert tilt.left_share == pytest.approx(0.5 + 0.5 * 0.07 / 12.0**0.5 / 0.048)
    assert tilting(compliance=0.0, tilt_y=-0.02).press(-2e-4, 0.0, 0.0)[0] == pytest.approx(force)


@pytest.mark.parametrize("compliance", [0.001, 0.1])
def test_a_platform_follows_a_tilted_target_by_what_its_springs_can(compliance: float) -> None:
    tilt = tilting(compliance, tilt_x=0.004, tilt_y=-0.003)
    tilt.press(4e-4, 0.0, 0.0)
    # Contact and compliance are two springs in a row: φ = c K t / (1 + c K), K what the contact resists turning with.
    for angle, slope, lever in zip(tilt.angles, (0.004, -0.003), (0.0087**2, 0.07**2 / 12.0), strict=True):
        stiff = compliance * 2e5 * lever
        assert angle == pytest.approx(slope * stiff / (1.0 + stiff), rel=1e-6)


def test_tilt_moves_the_terminals_and_so_the_clearance(arm: ArmFactory) -> None:
    results = []
    for compliance in (0.0, 0.02):
        parameters = WorldParameters(
            servo=ServoParameters(friction=0.0),
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
    assert soft - rigid == pytest.approx(-0.05 * angles[0], rel=0.25)


def test_each_pad_is_asked_with_its_own_force(arm: ArmFactory) -> None:
    class Pads:
        def begin_docking(self) -> tuple[float, float, float]:
            return 0.0, 0.0, 0.0

        def sample(self, time: float, pose: Any, force: float, share: float) -> tuple[np.ndarray, np.ndarray]:
            return np.full((10, 10), 2.0 * share * force), np.full((10, 10), 2.0 * (1.0 - share) * force)

    parameters = WorldParameters(platform=PlatformParameters(compliance=SOFT), target=TargetParameters(tilt_y=0.002))
    touching = arm(parameters, tactile=Pads())
    touching.dock()
    left, right = touching.world.taxels()
    assert left[0, 0] > right[0, 0] > 0.0
    assert left[0, 0] + right[0, 0] == pytest.approx(2.0 * touching.world.mechanics.contact_force)


def test_a_tilting_contact_comes_to_rest_at_any_step_and_stiffness(arm: ArmFactory) -> None:
    for stiffness in (1e3, 1e5, 1e9):
        for step in (0.001, 0.01, 0.1):
            parameters = WorldParameters(
                contact=ContactParameters(stiffness=stiffness),
                platform=PlatformParameters(compliance=0.1),
                target=TargetParameters(tilt_x=0.02, tilt_y=-0.03),
            )
            pressing = arm(parameters, step)
            pressing.dock()
            pressing.run(1.0)
            assert max(map(abs, pressing.world.mechanics.velocity)) < 1e-4
            assert 40.0 < pressing.world.mechanics.contact_force < 140.0


def test_off_it_is_not_there() -> None:
    world = World(replace(WorldParameters(), platform=PlatformParameters(lever=0.1)))
    world.step()
    assert world.mechanics.tilt == (0.0, 0.0)
    assert world.mechanics.pad_share == 0.5
