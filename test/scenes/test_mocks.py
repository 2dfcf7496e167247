# SPDX-License-Identifier: Apache-2.0
"""The mocks obey the laws that the layers above rely on."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from deltacharger.srv import DetectElectrodes
from rclpy.node import Node

from deltacharger_core.frames import rotation
from deltacharger_core.machine import (
    DOCK_DISTANCE,
    GRAVITY,
    SERVO_STIFFNESS,
    TORQUE_CONSTANT,
    ChargeLimits,
    Port,
    port_of,
)
from deltacharger_driver.board.contactor import LeaseRefused
from deltacharger_driver.board.protocol import BoardFault
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_scenes.mocks.mock_detector_node import MockDetectorNode
from deltacharger_scenes.mocks.mock_servo_node import MockArm
from deltacharger_scenes.mocks.mock_tactile_node import CHARGE_CURRENT, MockPower

from ..chargers import DEADLINE, Spin
from ..nodes import call, options

pytestmark = pytest.mark.ros

DELTA = ScalarDelta()
LIMITS = ChargeLimits(10.0, 29.4)


def powered() -> MockArm:
    arm = MockArm()
    arm.torque_enabled = [True] * 3
    arm.bounds = [4.1] * 3
    return arm


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


def test_beyond_the_targets_plane_it_presses_and_sticks() -> None:
    arm = powered()
    go(arm, (0.0, 0.0, 0.082))
    before = push(arm)
    go(arm, (0.002, 0.0, 0.084))
    assert 5.0 < before < push(arm) < 60.0
    assert (arm.position[0], arm.position[2]) == pytest.approx((0.0, DOCK_DISTANCE), abs=3e-3)
    assert arm.position[0] < 1e-3


def test_a_bound_clips_every_current() -> None:
    arm = powered()
    arm.bounds = [0.3] * 3
    go(arm, (0.0, 0.0, 0.11))
    assert max(abs(current) for current in arm.currents) <= 0.3 + 1e-12


def leased(power: MockPower, now: float = 0.0) -> MockPower:
    power.advance(now, True)
    power.probe(now, True)
    power.close("docking", 0.25, now, limits=LIMITS)
    return power


def test_current_flows_only_while_closed_and_in_contact() -> None:
    power = leased(MockPower())
    power.advance(0.2, True)
    assert 0.0 < power.current < CHARGE_CURRENT
    power.advance(0.24, False)
    assert power.current == 0.0


def test_an_expired_lease_opens_the_contactor() -> None:
    power = leased(MockPower())
    power.advance(0.249, True)
    assert power.closed
    power.advance(0.251, True)
    assert not power.closed
    with pytest.raises(LeaseRefused, match="probe"):
        power.close("docking", 0.25, 0.26, limits=LIMITS)


def test_missing_current_is_a_fault_that_opens_and_is_cleared_by_opening() -> None:
    power = MockPower()
    power.misbehaviour = "no_charge_current"
    leased(power)
    for step in range(1, 8):
        if power.closed:
            power.lease.take("docking", 0.25, 0.1 * step - 0.01)
        power.advance(0.1 * step, True)
    assert (power.closed, power.fault) == (False, BoardFault.NO_CHARGE_CURRENT)
    power.open()
    assert power.fault == 0


def test_a_welded_contactor_stays_closed_and_reports_it() -> None:
    power = leased(MockPower())
    power.misbehaviour = "contactor_welded"
    power.open()
    assert (power.closed, power.fault) == (True, BoardFault.CONTACTOR_WELDED)
    with pytest.raises(LeaseRefused, match="closed"):
        power.clear_weld()
    power.misbehaviour = ""
    power.open()
    assert (power.closed, power.fault) == (False, BoardFault.CONTACTOR_WELDED)
    power.clear_weld()
    assert power.fault == 0


@pytest.mark.parametrize(
    ("misbehaviour", "contact", "port"),
    [
        ("", True, Port.LIVE),
        ("", False, Port.OPEN),
        ("open_circuit", True, Port.OPEN),
        ("short", True, Port.SHORT),
        ("reverse_polarity", True, Port.REVERSED),
    ],
)
def test_the_probe_finds_a_live_port_unless_the_mock_misbehaves(misbehaviour: str, contact: bool, port: Port) -> None:
    power = MockPower()
    power.misbehaviour = misbehaviour
    assert port_of(*power.probe(0.0, contact)) is port


@pytest.mark.parametrize("fault", ["none", "no_normal"])
def test_the_lean_is_as_given_or_unknown(context: Any, namespace: str, spin: Spin, fault: str) -> None:
    given = {"yaw": 0.1, "pitch": -0.2, "roll": 0.3, "lean_stddev": 0.02, "fault": fault}
    spin(MockDetectorNode(**options(context, namespace, **given)))
    asking = spin(Node("asking", **options(context, namespace)))
    client: Any = asking.create_client(DetectElectrodes, "detect_electrodes")
    assert client.wait_for_service(DEADLINE)
    pose = call(client, DetectElectrodes.Request()).detection.pose
    q = pose.pose.orientation
    axes = np.array(rotation(q.x, q.y, q.z, q.w))
    covariance = np.reshape(pose.covariance, (6, 6))
    lean = (math.atan2(axes[0, 2], axes[2, 2]), math.atan2(-axes[1, 2], axes[2, 2]))
    known = fault == "none"
    assert math.atan2(axes[1, 0], axes[0, 0]) == pytest.approx(0.3)
    assert lean == pytest.approx((0.1, -0.2) if known else (0.0, 0.0))
    assert np.sqrt(np.diag(covariance)[3:5]) == pytest.approx([0.02 if known else math.nan] * 2, nan_ok=True)
