# SPDX-License-Identifier: Apache-2.0
"""The magnets' law, and its effects on the arm: snap, pull back, release."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from deltacharger_sim.mujoco_world import pull
from deltacharger_sim.parameters import MagnetParameters, ServoParameters, WorldParameters

MAGNETS = MagnetParameters()
ArmFactory = Callable[..., Any]


@pytest.mark.parametrize(
    ("gap", "offset", "force"),
    [
        (0.0, 0.0, 60.0),
        (0.002, 0.0, 15.0),
        (0.006, 0.0, 3.75),
        (0.0, 0.008, 30.0),
        (0.0, 0.1, 12.0),
        (-0.001, 0.0, 60.0),
    ],
)
def test_the_pull_follows_its_law(gap: float, offset: float, force: float) -> None:
    assert pull(MAGNETS, gap, offset) == pytest.approx(force)


def approach(arm: Any) -> tuple[float, float, float]:
    """Step toward the target by 0.25 mm until it snaps: gap (m) and contact current (A) before, command (m) after."""
    command = 0.072
    arm.go((0.0, 0.0, command))
    gap = current = 0.0
    while arm.world.mechanics.contact_force == 0.0:
        gap, current = arm.world.mechanics.gap, arm.contact_current
        command += 0.00025
        assert command < 0.082
        arm.go((0.0, 0.0, command), 0.5)
    return gap, current, command


def test_the_arm_snaps_in_from_three_millimetres_and_then_pulls_back(arm: ArmFactory) -> None:
    snapping = arm()
    gap, before, command = approach(snapping)
    assert gap == pytest.approx(0.0033, abs=0.0004)
    assert before == pytest.approx(-0.17, abs=0.05)
    assert snapping.contact_current == pytest.approx(-0.45, abs=0.06)
    assert snapping.world.push() < 0.0
    for _ in range(30):
        if snapping.contact_current >= 0.0:
            break
        command += 0.00025
        snapping.go((0.0, 0.0, command), 0.2)
    assert 0.0795 < command < 0.0825


def test_stiffer_servos_resist_the_snap_longer(arm: ArmFactory) -> None:
    gaps = [approach(arm(WorldParameters(servo=ServoParameters(stiffness=k))))[0] for k in (5.0, 10.0, 20.0)]
    assert gaps == sorted(gaps, reverse=True)


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


def test_the_push_bound_is_too_low_to_release_the_magnets(arm: ArmFactory) -> None:
    bounded = arm()
    bounded.dock()
    bounded.go((0.0, 0.0, 0.03), 2.0, bound=0.83)
    assert bounded.world.mechanics.contact_force > 0.0


def test_a_target_with_a_large_offset_pulls_with_a_fifth(arm: ArmFactory) -> None:
    aside = arm()
    aside.go((0.05, 0.0, 0.07))
    aside.go((0.05, 0.0, 0.086))
    held = aside.world.mechanics.magnet_force
    assert held == pytest.approx(12.0, rel=1e-3)
