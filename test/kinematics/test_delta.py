# SPDX-License-Identifier: Apache-2.0
"""Laws of the kinematics: round trips, finite differences, virtual work, results of bad points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltacharger_core.machine import TORQUE_CONSTANT
from deltacharger_kinematics import (
    AHEAD,
    BEHIND,
    WORKING_MODES,
    Delta,
    DeltaGeometry,
    LimbAdjustment,
    Status,
)
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_kinematics.status import NO_ANSWER

DELTA = Delta()
SCALAR = ScalarDelta()
ADJUSTED = (
    LimbAdjustment(0.0010, 0.0020, 0.0030, 0.1010, 0.1810, 0.010),
    LimbAdjustment(-0.0010, 0.0010, -0.0030, 0.0990, 0.1790, -0.020),
    LimbAdjustment(0.0020, -0.0020, 0.0010, 0.1005, None, 0.005),
)
CALIBRATED = DeltaGeometry(limbs=ADJUSTED)
DOCK = (0.0, 0.0, 0.080)
MILLIMETRE = 1e-3

AZIMUTHS = np.radians((0.0, 120.0, 240.0))
lateral = st.floats(-0.060, 0.060)
forward = st.floats(0.0, 0.110)


def workspace_points(count: int, seed: int = 1) -> np.ndarray:
    geometry = DELTA.geometry
    return np.random.default_rng(seed).uniform(geometry.workspace_min, geometry.workspace_max, (count, 3))


@given(lateral, lateral, forward)
def test_the_scalar_path_agrees_with_the_arrays(x: float, y: float, z: float) -> None:
    angles = SCALAR.inverse(x, y, z)
    assert np.allclose(angles, DELTA.inverse((x, y, z)).angles, atol=1e-15)
    assert np.allclose(SCALAR.forward(*angles), (x, y, z), atol=1e-14)
    assert np.allclose(SCALAR.jacobian(x, y, z), DELTA.jacobian((x, y, z)).matrix.ravel(), atol=1e-14)
    weight = (0.0, -9.81, 0.0)
    assert np.allclose(SCALAR.holding_torque(x, y, z, weight), DELTA.holding_torque((x, y, z), weight), atol=1e-14)


def test_published_angles_and_currents() -> None:
    home, dock = DELTA.inverse([(0.0, 0.0, 0.0), DOCK]).angles
    assert np.allclose(np.degrees(home), -41.55, atol=0.01)
    assert np.allclose(np.degrees(dock), 15.27, atol=0.01)
    assert np.allclose(DELTA.torque(DOCK, (0.0, 0.0, 20.0)) / TORQUE_CONSTANT, 0.521, atol=5e-4)


def test_the_jacobian_is_the_derivative_of_forward_kinematics() -> None:
    points = workspace_points(200)
    angles = DELTA.inverse(points).angles
    step = 1e-6
    for joint in range(3):
        shift = step * np.eye(3)[joint]
        slope = (DELTA.forward(angles + shift).position - DELTA.forward(angles - shift).position) / (2 * step)
        assert np.allclose(DELTA.jacobian(points).matrix[..., joint], slope, atol=1e-9)


def test_torque_does_the_work_of_the_force() -> None:
    points = workspace_points(100)
    force = np.random.default_rng(2).normal(size=(100, 3))
    speed = np.random.default_rng(3).normal(size=(100, 3))
    velocity = np.einsum("nij,nj->ni", DELTA.jacobian(points).matrix, speed)
    assert np.allclose((DELTA.torque(points, force) * speed).sum(-1), (force * velocity).sum(-1), atol=1e-12)
    assert np.allclose(DELTA.force(points, DELTA.torque(points, force)), force, atol=1e-12)


def test_holding_torque_is_the_slope_of_potential_energy() -> None:
    geometry, gravity = DELTA.geometry, np.array((1.0, -9.0, 2.0))

    def arms(angles: np.ndarray) -> np.ndarray:
        return geometry.arm * np.stack([np.cos(angles), np.sin(angles)], axis=-1)

    def energy(angles: np.ndarray) -> float:
        platform = DELTA.forward(angles).position
        elbows = np.stack(
            [
                (np.cos(azimuth) * arm[0], np.sin(azimuth) * arm[0], arm[1])
                for azimuth, arm in zip(AZIMUTHS, arms(angles), strict=True)
            ]
        )
        carried = (geometry.platform_mass + 1.5 * geometry.rod_mass) * platform
        return -float(gravity @ (carried + 0.5 * geometry.rod_mass * elbows.sum(0)))

    for point in workspace_points(6):
        angles = DELTA.inverse(point).angles
        slope = [(energy(angles + 1e-6 * e) - energy(angles - 1e-6 * e)) / 2e-6 for e in np.eye(3)]
        assert np.allclose(DELTA.holding_torque(point, gravity), slope, atol=1e-8)


def test_contact_force_is_free_of_the_arms_weight() -> None:
    push = np.array((1.0, -2.0, 18.0))
    current = (DELTA.torque(DOCK, push) + DELTA.holding_torque(DOCK)) / TORQUE_CONSTANT
    assert np.allclose(DELTA.contact_force(DOCK, current), push, atol=1e-12)


def test_a_reachable_point_outside_the_box_or_the_joint_limits_has_a_flag() -> None:
    solved = DELTA.inverse((0.0, 0.0, 0.115))
    assert solved.status == Status.OUTSIDE_WORKSPACE
    assert np.isfinite(solved.angles).all()
    assert Status.JOINT_LIMIT | Status.LIMB_0 in DELTA.inverse((0.0, 0.0, 0.178)).status


def test_reachable_points_of_the_mirror_assembly_are_flagged() -> None:
    points = np.random.default_rng(5).uniform((-0.2, -0.2, 0), (0.2, 0.2, 0.2), (5000, 3))
    solved = DELTA.inverse(points)
    good = np.isfinite(solved.angles).all(-1)
    returned = DELTA.forward(solved.angles[good]).position
    elsewhere = np.abs(returned - points[good]).max(-1) > MILLIMETRE
    assert elsewhere.any()
    assert np.array_equal(elsewhere, (solved.status[good] & Status.WRONG_ASSEMBLY) != 0)


@given(st.tuples(*[st.floats(-1.2, 1.3)] * 3), st.sampled_from([AHEAD, BEHIND]))
def test_forward_kinematics_agree_alone_and_in_a_batch(arms: tuple[float, float, float], assembly: int) -> None:
    delta = Delta(CALIBRATED, assembly=assembly)
    alone, together = delta.forward(arms), delta.forward([arms, (0.1, 0.2, 0.3)])
    assert alone.status == np.asarray(together.status)[0]
    assert np.allclose(alone.position, together.position[0], atol=1e-15, equal_nan=True)
    assert np.allclose(alone.determinant, np.asarray(together.determinant)[0], atol=1e-14, equal_nan=True)


@pytest.mark.parametrize("mode", WORKING_MODES)
@pytest.mark.parametrize("assembly", [AHEAD, BEHIND])
def test_every_mode_and_assembly_is_consistent(mode: tuple[int, int, int], assembly: int) -> None:
    """Round trip, derivative and statics hold wherever the status reports the right assembly."""
    delta, scalar = (kind(CALIBRATED, working_mode=mode, assembly=assembly) for kind in (Delta, ScalarDelta))
    points = np.random.default_rng(4).uniform((-0.1, -0.1, -0.25), (0.1, 0.1, 0.15), (200, 3))
    solved = delta.inverse(points)
    refused = NO_ANSWER | Status.WRONG_ASSEMBLY | Status.NEAR_TYPE_1 | Status.NEAR_TYPE_2
    good = (np.asarray(solved.status) & refused) == 0
    assert 5 < good.sum() < 200
    points, angles = points[good], solved.angles[good]
    assert np.allclose(delta.forward(angles).position, points, atol=1e-13)
    matrix = delta.jacobian(points).matrix
    for joint in range(3):
        shift = 1e-7 * np.eye(3)[joint]
        slope = (delta.forward(angles + shift).position - delta.forward(angles - shift).position) / 2e-7
        assert np.allclose(matrix[..., joint], slope, rtol=1e-4, atol=1e-6)
    for point, expected in zip(points[:5], matrix[:5], strict=True):
        assert np.allclose(np.reshape(scalar.jacobian(*point), (3, 3)), expected, rtol=1e-12, atol=1e-14)
        assert np.allclose(scalar.forward(*scalar.inverse(*point)), point, atol=1e-13)


def test_angle_offset_is_true_angle_minus_commanded_angle() -> None:
    offset = Delta(DeltaGeometry(limbs=(LimbAdjustment(angle_offset=0.02),) * 3))
    assert np.allclose(offset.inverse(DOCK).angles + 0.02, DELTA.inverse(DOCK).angles, atol=1e-15)
    assert np.allclose(offset.holding_torque(DOCK), DELTA.holding_torque(DOCK), atol=1e-15)
