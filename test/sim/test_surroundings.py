# SPDX-License-Identifier: Apache-2.0
"""What gives way around the arm: the cable, and both robots on their wheels."""

from collections.abc import Callable
from typing import Any

import pytest

from deltacharger_sim.parameters import CableParameters, MagnetParameters, StandParameters, WorldParameters
from test.plain import plain_servo

ArmFactory = Callable[..., Any]
ROLLING = 0.012 * 25.0 * 9.81  # N, resistance of 25 kg on rubber wheels
TYRES = 5000.0  # N/m
# Its servos creep, so that every motion ends in its own direction.
SLOW = {"servo": plain_servo(friction=0.0, damping=3.0), "magnets": MagnetParameters(force=0.0), "gravity_y": 0.0}


def test_a_cable_pulls_back_home_and_drags_against_the_motion(arm: ArmFactory) -> None:
    tied = arm(WorldParameters(cable=CableParameters(stiffness=200.0, drag=3.0), **SLOW), 0.01)
    mechanics = tied.world.mechanics
    for z, drag in ((0.05, 3.0), (0.03, -3.0)):
        tied.go((0.0, 0.0, z), 4.0)
        assert mechanics.servo_push() == pytest.approx(200.0 * mechanics.position[2] + drag, abs=0.01)


def pressed(arm: ArmFactory, step: float = 0.01, **stand: float) -> tuple[float, float]:
    """Return the push (N) on a target that gives way, and by how much (m), at rest."""
    pressing = arm(WorldParameters(stand=StandParameters(stiffness=TYRES, **stand), **SLOW), step)
    pressing.go((0.0, 0.0, 0.078), 2.0)
    for index in range(1, 41):  # slowly, so that the target does not swing back
        pressing.go((0.0, 0.0, 0.078 + 0.0005 * index), 0.05)
    pressing.run(3.0)
    mechanics = pressing.world.mechanics
    assert mechanics.target_shift[:2] == pytest.approx((0.0, 0.0), abs=1e-9)
    assert mechanics.gap == pytest.approx(-mechanics.contact_force / 2e5, abs=1e-9)
    return mechanics.contact_force, mechanics.target_shift[2]


@pytest.mark.parametrize(("play", "step"), [(0.0, 0.002), (0.002, 0.01)])
def test_a_pressed_target_yields_by_the_play_and_the_push_beyond_rolling_over_the_tyres(
    arm: ArmFactory, play: float, step: float
) -> None:
    push, shift = pressed(arm, step, play=play)
    assert push > 15.0
    assert shift == pytest.approx(play + (push - ROLLING) / TYRES, abs=1e-5)


def test_brakes_slip_at_their_force_and_the_wheels_then_roll(arm: ArmFactory) -> None:
    push, shift = pressed(arm, brakes=10.0)
    assert push == pytest.approx(10.0 + ROLLING, abs=0.05)
    assert shift > 0.008
