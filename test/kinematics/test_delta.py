# SPDX-License-Identifier: Apache-2.0
"""Laws of the kinematics: round trips, finite differences, virtual work; results of bad and extreme points."""

import math
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from deltacharger_core.machine import TORQUE_CONSTANT
from deltacharger_kinematics import Delta, DeltaGeometry, Inverse, LimbAdjustment, Status
from deltacharger_kinematics.geometry import NO_ANSWER
from deltacharger_kinematics.scalar import ScalarDelta

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
    assert np.allclose(SCALAR.torque(x, y, z, (1.0, 2.0, 3.0)), DELTA.torque((x, y, z), (1.0, 2.0, 3.0)), atol=1e-13)
    weight = (0.0, -9.81, 0.0)
    assert np.allclose(SCALAR.holding_torque(x, y, z, weight), DELTA.holding_torque((x, y, z), weight), atol=1e-14)


def test_published_angles_and_currents() -> None:
    home, dock = DELTA.inverse([(0.0, 0.0, 0.0), DOCK]).angles
    assert np.allclose(np.degrees(home), -41.55, atol=0.01)
    assert np.allclose(np.degrees(dock), 15.27, atol=0.01)
    assert np.allclose(DELTA.torque(DOCK, (0.0, 0.0, 20.0)) / TORQUE_CONSTANT, 0.521, atol=5e-4)


def test_torque_does_the_work_of_the_force() -> None:
    points = workspace_points(100)
    force = np.random.default_rng(2).normal(size=(100, 3))
    speed = np.random.default_rng(3).normal(size=(100, 3))
    velocity = np.einsum("nij,nj->ni", DELTA.jacobian(points).matrix, speed)
    assert np.allclose((DELTA.torque(points, force) * speed).sum(-1), (force * velocity).sum(-1), atol=1e-12)
    for point, push in zip(points[:9].tolist(), force[:9].tolist(), strict=True):
        assert np.allclose(SCALAR.force(*point, SCALAR.torque(*point, push)), push, atol=1e-12)


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


def test_a_reachable_point_outside_the_box_or_the_joint_limits_has_a_flag() -> None:
    solved = DELTA.inverse((0.0, 0.0, 0.115))
    assert solved.status == Status.OUTSIDE_WORKSPACE
    assert np.isfinite(solved.angles).all()
    assert Status.JOINT_LIMIT | Status.LIMB_0 in DELTA.inverse((0.0, 0.0, 0.178)).status
    assert Status.SWING_LIMIT in DELTA.inverse((0.15, 0.0, 0.08)).status
    for point in ((0.0, 0.0, 0.08), (0.0, 0.0, 0.115), (0.0, 0.0, 0.178), (0.15, 0.0, 0.08)):
        angles, bits, margin = SCALAR.solve(*point) or ((), -1, math.nan)
        alone = DELTA.inverse(point)
        assert (bits, margin) == (alone.status, pytest.approx(alone.margin))
        assert np.allclose(angles, alone.angles, atol=1e-15)


def test_reachable_points_of_the_mirror_assembly_are_flagged() -> None:
    points = np.random.default_rng(5).uniform((-0.2, -0.2, 0), (0.2, 0.2, 0.2), (5000, 3))
    solved = DELTA.inverse(points)
    good = np.isfinite(solved.angles).all(-1)
    returned = DELTA.forward(solved.angles[good]).position
    elsewhere = np.abs(returned - points[good]).max(-1) > MILLIMETRE
    assert elsewhere.any()
    assert np.array_equal(elsewhere, (solved.status[good] & Status.WRONG_ASSEMBLY) != 0)


def test_a_calibrated_arm_is_consistent() -> None:
    """Round trip, derivative and statics hold wherever the status reports the right assembly."""
    delta, scalar = Delta(CALIBRATED), ScalarDelta(CALIBRATED)
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


def test_a_singular_pose_and_a_joint_that_turns_freely_are_flagged() -> None:
    """All rods in one plane; a platform joint on its motor axis (powers of two, so exactly)."""
    flat = DeltaGeometry(base_radius=0.125, platform_radius=0.0625, arm=0.125, rod=0.1875, z_offset=0.0)
    _, bits, _ = ScalarDelta(flat).solve(0.0, 0.0, 0.0) or ((), 0, 0.0)
    assert Status.NEAR_TYPE_2 in Status(bits) & Delta(flat).inverse((0.0, 0.0, 0.0)).status
    square = DeltaGeometry(base_radius=0.25, platform_radius=0.125, arm=0.25, rod=0.25, z_offset=0.5)
    solved = Delta(square).inverse((0.125, 0.0, -0.5))
    assert solved.status == Status.INDETERMINATE | Status.LIMB_0
    assert math.isnan(solved.angles[0])


LIMBS = Status.LIMB_0 | Status.LIMB_1 | Status.LIMB_2
LONG_ARM = Delta(DeltaGeometry(arm=0.25, rod=0.125, base_radius=0.25, platform_radius=0.25, z_offset=0.0))

pytestmark = pytest.mark.filterwarnings("error")


def alone_and_in_a_batch(delta: Delta, point: tuple[float, float, float]) -> Inverse:
    with np.errstate(all="raise"):
        alone, batch, expected = delta.inverse(point), delta.inverse([DOCK, point, DOCK]), delta.inverse(DOCK)
    for row, one in enumerate((expected, alone, expected)):
        assert np.allclose(batch.angles[row], one.angles, rtol=0.0, atol=4e-16, equal_nan=True)
        assert np.asarray(batch.status)[row] == one.status
        assert np.array_equal(np.asarray(batch.margin)[row], one.margin, equal_nan=True)
    return alone


@pytest.mark.parametrize(
    ("value", "status"),
    [
        (math.inf, Status.INVALID_INPUT),
        (-sys.float_info.max, Status.UNREACHABLE_FAR | LIMBS),
    ],
)
@pytest.mark.parametrize("axis", range(3))
def test_non_finite_input_is_invalid_and_overflow_unreachable(value: float, status: Status, axis: int) -> None:
    point = (*DOCK[:axis], value, *DOCK[axis + 1 :])
    solved = alone_and_in_a_batch(DELTA, point)
    assert solved.status == status
    assert np.isnan(solved.angles).all()
    assert np.array_equal(solved.margin, math.nan if status == Status.INVALID_INPUT else -math.inf, equal_nan=True)
    assert np.isnan(ScalarDelta().inverse(*point)).all()


@pytest.mark.parametrize(
    ("delta", "point", "reason"),
    [
        (DELTA, (0.0, 0.0, 0.5), Status.UNREACHABLE_FAR),
        (DELTA, (0.0, 0.3, 0.0), Status.UNREACHABLE_LATERAL),
        (DELTA, (0.0, 0.0, -0.095), Status.UNREACHABLE_NEAR),
        (LONG_ARM, (0.0, 0.0, 0.1), Status.UNREACHABLE_NEAR),
    ],
)
def test_out_of_reach_states_reason_and_limb(delta: Delta, point: tuple[float, float, float], reason: Status) -> None:
    solved = alone_and_in_a_batch(delta, point)
    limbs = [bool(solved.status & bit) for bit in (Status.LIMB_0, Status.LIMB_1, Status.LIMB_2)]
    assert reason in solved.status
    assert np.isnan(solved.angles).tolist() == limbs
    assert solved.margin < 0.0


@pytest.mark.parametrize("bad", [np.zeros((3, 4)), 0.1])
def test_an_array_of_another_shape_is_refused_by_name(bad: Any) -> None:
    for name, call in (("position", DELTA.inverse), ("angles", DELTA.forward)):
        with pytest.raises(ValueError, match=f"^{name}: "):
            call(bad)


def test_nan_and_unreached_points_are_unknown() -> None:
    assert np.isnan(DELTA.torque(DOCK, (math.nan, 0.0, 0.0))).any()
    assert np.isnan(DELTA.torque((0.0, 0.0, 0.8), (0.0, 0.0, 1.0))).all()
    assert np.isnan(SCALAR.force(0.0, 0.0, 0.8, (0.1, 0.1, 0.1))).all()
    assert np.isfinite(DELTA.torque(DOCK, (1e300, 0.0, 0.0))).all()


def test_elbows_in_a_line_or_too_far_apart() -> None:
    level = Delta(DeltaGeometry(base_radius=0.05, platform_radius=0.05))
    straight_up = (math.pi / 2,) * 3  # the three elbows coincide
    apart = Delta(DeltaGeometry(base_radius=0.4, rod=0.11))
    for delta, arms, status in (
        (level, straight_up, Status.DEGENERATE),
        (apart, (0.0, 0.0, 0.0), Status.NOT_ASSEMBLABLE),
        (DELTA, (math.nan, 0.0, 0.0), Status.INVALID_INPUT),
        (DELTA, (math.inf, 0.0, 0.0), Status.INVALID_INPUT),
    ):
        met = delta.forward([arms, (0.1, 0.2, 0.3)])
        assert np.ravel(met.status).tolist() == [status, delta.forward((0.1, 0.2, 0.3)).status]
        assert np.isnan(met.position[0]).all()
    assert np.isnan(ScalarDelta(level.geometry).forward(*straight_up)).all()
    assert np.isnan(ScalarDelta(apart.geometry).forward(0.0, 0.0, 0.0)).all()
