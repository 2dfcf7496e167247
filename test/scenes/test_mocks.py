# SPDX-License-Identifier: Apache-2.0
"""The mocks obey the laws that the layers above rely on."""

from __future__ import annotations

import pytest

from deltacharger_core.machine import (
    DOCK_DISTANCE,
    GRAVITY,
    SERVO_STIFFNESS,
    TORQUE_CONSTANT,
    ChargeLimits,
)
from deltacharger_driver.board.contactor import LeaseRefused
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_scenes.mocks.mock_servo_node import MockArm
from deltacharger_scenes.mocks.mock_tactile_node import CHARGE_CURRENT, MockPower

pytestmark = pytest.mark.ros

DELTA = ScalarDelta()
LIMITS = ChargeLimits(10.0, 29.4)


def go(arm: MockArm, position: tuple[float, float, float]) -> None:
    """Command `position` with the arm's weight compensated, as docking does, for 1 s."""
    held = DELTA.holding_torque(*position, GRAVITY)
    inverse = DELTA.inverse(*position)
    arm.goals = [angle + torque / SERVO_STIFFNESS for angle, torque in zip(inverse, held, strict=True)]
    arm.advance(1.0)


def push(arm: MockArm) -> float:
    """Return the force along z on the target that the currents correspond to."""
    held = DELTA.holding_torque(*arm.position, GRAVITY)
    spare = [TORQUE_CONSTANT * current - hold for current, hold in zip(arm.currents, held, strict=True)]
    return DELTA.force(*arm.position, (spare[0], spare[1], spare[2]))[2]


def test_beyond_the_targets_plane_it_presses_and_sticks_within_its_bounds() -> None:
    arm = MockArm()
    arm.torque_enabled, arm.bounds = [True] * 3, [4.1] * 3
    go(arm, (0.0, 0.0, 0.082))
    before = push(arm)
    go(arm, (0.002, 0.0, 0.084))
    assert 5.0 < before < push(arm) < 60.0
    assert (arm.position[0], arm.position[2]) == pytest.approx((0.0, DOCK_DISTANCE), abs=3e-3)
    assert arm.position[0] < 1e-3
    arm.bounds = [0.3] * 3
    go(arm, (0.0, 0.0, 0.11))
    assert max(abs(current) for current in arm.currents) <= 0.3 + 1e-12


def test_current_flows_only_while_leased_and_in_contact() -> None:
    power = MockPower()
    power.advance(0.0, True)
    power.probe(0.0, True)
    power.close("docking", 0.25, 0.0, limits=LIMITS)
    power.advance(0.2, True)
    assert 0.0 < power.current < CHARGE_CURRENT
    power.advance(0.24, False)
    assert power.current == 0.0
    power.advance(0.249, True)
    assert power.closed
    power.advance(0.251, True)
    assert not power.closed
    with pytest.raises(LeaseRefused, match="probe"):
        power.close("docking", 0.25, 0.26, limits=LIMITS)
