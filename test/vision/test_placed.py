# SPDX-License-Identifier: Apache-2.0
"""Laws of the lean: signs, orientation, error, and invalid normals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st

from deltacharger_core.rotation import rotation
from deltacharger_vision.mount import Mount, line_angle
from deltacharger_vision.placed import Placed, is_front, leaning_normal
from deltacharger_vision.poses import turn
from deltacharger_vision.ros.detections import detection_message

from .test_mount import seen

leans = st.floats(-0.6, 0.6)
rolls = st.floats(-1.5, 1.5)
UNKNOWN = np.full(3, np.nan)
X, Y, Z = np.eye(3)


def standing(axes: np.ndarray, normal: np.ndarray | None = None) -> Placed:
    roll = line_angle(axes[0, 0], axes[1, 0])
    return Placed(np.array([0.0, 0.0, 0.08]), roll, -axes[:, 2] if normal is None else normal, np.eye(6) * 1e-4)


@pytest.mark.parametrize("angle", [-0.3, 0.2])
def test_yaw_is_about_y_and_pitch_about_x(angle: float) -> None:
    yawed, pitched = standing(turn(angle * Y)).lean(), standing(turn(angle * X)).lean()
    assert (yawed.yaw, yawed.pitch) == pytest.approx((angle, 0.0))
    assert (pitched.yaw, pitched.pitch) == pytest.approx((0.0, angle))


@given(leans, leans, rolls)
def test_the_orientation_matches_the_target_at_any_lean_and_roll(yaw: float, pitch: float, roll: float) -> None:
    axes = turn(pitch * X) @ turn(yaw * Y) @ turn(roll * Z)
    placed = standing(axes)
    flip = np.diag([1.0, 1.0, 1.0] if axes[0, 0] >= 0.0 else [-1.0, -1.0, 1.0])  # bars have no sign
    assert placed.rotation() == pytest.approx(axes @ flip, abs=1e-9)
    lean = placed.lean()
    assert lean.yaw == pytest.approx(math.atan2(axes[0, 2], axes[2, 2]))
    assert lean.pitch == pytest.approx(math.atan2(-axes[1, 2], axes[2, 2]))
    assert leaning_normal(lean.yaw, lean.pitch) == pytest.approx(placed.normal)


def test_the_error_of_the_lean_combines_camera_and_mount() -> None:
    random = np.random.default_rng(7)
    nominal = Mount(Mount.default().pose, np.diag([0.002**2] * 3 + [0.008**2, 0.012**2, 0.02**2]))
    own = np.diag([0.3, 0.3, 0.9, 6.0, 9.0, 3.0]) ** 2 * 1e-6
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn(np.array([0.3, -0.25, 0.5])), (0.01, -0.02, 0.09)
    inside = np.linalg.inv(nominal.pose) @ pose
    expected = nominal.place(seen(inside[:3, :3], inside[:3, 3], own)).lean()
    errors = []
    for _ in range(4000):
        true = nominal.pose.copy()
        true[:3, :3] = turn(random.normal(size=3) * [0.008, 0.012, 0.02]) @ true[:3, :3]
        noisy = turn(random.multivariate_normal(np.zeros(6), own)[3:]) @ (np.linalg.inv(true) @ pose)[:3, :3]
        found = nominal.place(seen(noisy, inside[:3, 3])).lean()
        errors.append([found.yaw - expected.yaw, found.pitch - expected.pitch])
    whitened = np.linalg.solve(np.linalg.cholesky(expected.covariance), np.array(errors).T)
    assert np.cov(whitened) == pytest.approx(np.eye(2), abs=0.12)
    assert np.std(errors, axis=0) == pytest.approx([expected.yaw_stddev, expected.pitch_stddev], rel=0.05)


def test_without_a_normal_only_the_roll_is_known() -> None:
    placed = standing(turn(0.3 * Z), UNKNOWN)
    lean = placed.lean()
    assert np.isnan([lean.yaw, lean.pitch, lean.yaw_stddev, lean.pitch_stddev]).all()
    assert placed.rotation() == pytest.approx(turn(0.3 * Z))
    covariance = placed.known_covariance()
    assert np.isnan(covariance).sum() == 20
    assert np.isfinite(placed.covariance).all(), "the original is unchanged"
    assert covariance[np.ix_([0, 1, 2, 5], [0, 1, 2, 5])] == pytest.approx(1e-4 * np.eye(4))


@pytest.mark.parametrize("normal", [UNKNOWN, leaning_normal(0.2, -0.1)])
def test_the_message_has_the_orientation_and_its_known_covariance(normal: np.ndarray) -> None:
    placed = standing(turn(-0.4 * Z), normal)
    message = detection_message(placed, Time(sec=7), 0.75, 0.25)
    q = message.pose.pose.orientation
    assert np.array(rotation(q.x, q.y, q.z, q.w)) == pytest.approx(placed.rotation())
    assert message.roll == pytest.approx(-0.4)
    assert np.isnan(message.pose.covariance).sum() == (20 if np.isnan(normal[0]) else 0)
    assert (message.header.frame_id, message.header.stamp.sec) == ("charger_base", 7)


@pytest.mark.parametrize(
    ("normal", "why"),
    [
        (Z, "the plate is seen from behind"),
        (turn(0.05 * Y) @ -Z, "bars along x are not square to it: it contradicts the roll"),
        (leaning_normal(0.0, 1.55), "its edge is seen"),
        (UNKNOWN, "it is not known"),
    ],
)
def test_an_impossible_normal_is_dropped(normal: np.ndarray, why: str) -> None:
    assert is_front(X, -Z, Z)
    assert not is_front(X, normal, Z), why


def test_averted_faces_are_placed_without_a_normal() -> None:
    straight = Mount.default()
    back = straight.pose.copy()
    back[:3, :3] = turn(math.pi * Y) @ back[:3, :3]
    inside = np.linalg.inv(straight.pose) @ np.block([[np.eye(3), np.array([[0.0], [0.0], [0.08]])], [0.0, 0, 0, 1]])
    detection = seen(inside[:3, :3], inside[:3, 3])
    assert straight.place(detection).upright
    assert not Mount(back, straight.covariance).place(detection).upright, "a mount that looks backward"
