# SPDX-License-Identifier: Apache-2.0
"""Laws of the hand-eye transform and of the lean: poses in charger_base, their uncertainty, invalid normals; files."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given, strategies as st

from deltacharger_core.frames import rotation
from deltacharger_vision.errors import MountError, TerminalError
from deltacharger_vision.mount import Mount, Placed, is_front, leaning_normal, line_angle, quaternion
from deltacharger_vision.ros.messages import detection_message
from deltacharger_vision.terminal import Detection, Terminal, turn

from ..marks import rest

angles = st.floats(-math.pi, math.pi)


def seen(pose: np.ndarray, covariance: np.ndarray | None = None) -> Detection:
    """A detection of a terminal with this pose (4, 4) in the optical frame."""
    axis = pose[:3, 0] * (1.0 if pose[0, 0] >= 0.0 else -1.0)
    return Detection(
        position=pose[:3, 3],
        roll=line_angle(axis[0], axis[1]),
        axis=axis,
        normal=-pose[:3, 2],
        covariance=np.zeros((6, 6)) if covariance is None else covariance,
        confidence=1.0,
        range=float(np.linalg.norm(pose[:3, 3])),
        bars=np.zeros((2, 4, 2)),
        source="both",
    )


def through(mount: Mount, position: np.ndarray, roll: float) -> Detection:
    """Detection of a terminal in charger_base at `position`, rolled about z."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn(np.array([0.0, 0.0, roll])), position
    return seen(np.linalg.inv(mount.pose) @ pose)


@given(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(0.02, 0.4), st.floats(-1.5, 1.5))
def test_a_detection_is_placed_in_charger_base(x: float, y: float, z: float, roll: float) -> None:
    mount = Mount.default()
    placed = mount.place(through(mount, np.array([x, y, z]), roll))
    assert placed.position == pytest.approx([x, y, z], abs=1e-12)
    assert placed.roll == pytest.approx(roll, abs=1e-12)
    assert placed.normal == pytest.approx([0.0, 0.0, -1.0], abs=1e-12)


@pytest.mark.parametrize(("count", "share", "most"), [(400, 0.1, 0.25), rest(3000, 0.05, 0.12)])
def test_the_covariances_hold_for_errors_of_camera_and_mount(count: int, share: float, most: float) -> None:
    random = np.random.default_rng(4)
    spread, own = np.array([0.002] * 3 + [0.008, 0.012, 0.01]), 1e-3 * np.array([0.3, 0.3, 0.9, 6.0, 9.0, 3.0])
    nominal = Mount(Mount.default().pose, np.diag(spread**2))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn(np.array([0.3, -0.25, 0.5])), (0.01, -0.02, 0.09)
    expected = nominal.place(seen(np.linalg.inv(nominal.pose) @ pose, np.diag(own**2)))
    errors = []
    for _ in range(count):
        off, noise = random.normal(scale=spread), random.normal(scale=own)
        true = nominal.pose.copy()
        true[:3, :3], true[:3, 3] = turn(off[3:]) @ true[:3, :3], true[:3, 3] + off[:3]
        inside = np.linalg.inv(true) @ pose
        inside[:3, :3], inside[:3, 3] = turn(noise[3:]) @ inside[:3, :3], inside[:3, 3] + noise[:3]
        placed = nominal.place(seen(inside))
        errors.append([*(placed.position - expected.position), placed.roll - expected.roll])
    predicted = expected.covariance[np.ix_([0, 1, 2, 5], [0, 1, 2, 5])]
    whitened = np.linalg.solve(np.linalg.cholesky(predicted), np.transpose(errors))
    assert np.cov(whitened) == pytest.approx(np.eye(4), abs=most)
    assert np.std(errors, axis=0) == pytest.approx(np.sqrt(np.diag(predicted)), rel=share)


@given(angles, angles, angles)
def test_a_quaternion_matches_its_rotation(a: float, b: float, c: float) -> None:
    rotation = turn(np.array([a, 0.0, 0.0])) @ turn(np.array([0.0, b, 0.0])) @ turn(np.array([0.0, 0.0, c]))
    q = quaternion(rotation)
    assert q[3] >= 0.0
    assert Mount.from_numbers([0.0, 0.0, 0.0, *q]).pose[:3, :3] == pytest.approx(rotation, abs=1e-9)


def test_a_saved_mount_loads_unchanged_and_one_without_covariance_has_the_usual_error(tmp_path: Path) -> None:
    path, spread = tmp_path / "mount.yaml", np.diag([1e-3, 2e-3, 3e-3, 0.01, 0.02, 0.03]) ** 2
    spread[0, 4] = spread[4, 0] = 1e-6
    Mount(Mount.default().pose, spread).save(path, {"residual_px": 0.21})
    loaded = Mount.load(path)
    assert loaded.pose == pytest.approx(Mount.default().pose, abs=1e-7)
    assert loaded.covariance == pytest.approx(spread, rel=1e-5)
    assert "residual_px: 0.21" in path.read_text()
    path.write_text("position: [0, 0.1, 0]\norientation: [0, 0, 0, 1]\n")
    assert np.sqrt(np.diag(Mount.load(path).covariance)) == pytest.approx([0.002] * 3 + [math.radians(0.5)] * 3)


STRAIGHT = "position: [0, 0, 0]\norientation: [0, 0, 0, 1]\n"


@pytest.mark.parametrize(
    ("kind", "text", "noun"),
    [
        (Mount, "position: [0, 0, 0]", "orientation"),
        (Mount, STRAIGHT.replace("0, 0, 0]", "0, 120, -120]", 1), "metres"),
        (Mount, STRAIGHT + "frame: base_link", "base_link"),
        (Terminal, "bar_lenght: 0.07", "'bar_length'"),
    ],
)
def test_a_wrong_file_is_refused_by_name(tmp_path: Path, kind: Any, text: str, noun: str) -> None:
    path = tmp_path / "any.yaml"
    path.write_text(text)
    with pytest.raises(MountError if kind is Mount else TerminalError, match=noun) as caught:
        kind.load(path)
    assert caught.value.source == str(path)


def test_a_negative_covariance_is_refused() -> None:
    with pytest.raises(MountError, match="negative"):
        Mount(np.eye(4), -np.eye(6))


leans = st.floats(-0.6, 0.6)
rolls = st.floats(-1.5, 1.5)
UNKNOWN = np.full(3, np.nan)
X, Y, Z = np.eye(3)


def standing(axes: np.ndarray, normal: np.ndarray | None = None) -> Placed:
    roll = line_angle(axes[0, 0], axes[1, 0])
    return Placed(np.array([0.0, 0.0, 0.08]), roll, -axes[:, 2] if normal is None else normal, np.eye(6) * 1e-4)


@given(leans, leans, rolls)
def test_the_orientation_matches_the_target_at_any_lean_and_roll(yaw: float, pitch: float, roll: float) -> None:
    axes = turn(pitch * X) @ turn(yaw * Y) @ turn(roll * Z)
    placed = standing(axes)
    flip = np.diag([1.0, 1.0, 1.0] if axes[0, 0] >= 0.0 else [-1.0, -1.0, 1.0])  # bars have no sign
    assert placed.rotation() == pytest.approx(axes @ flip, abs=1e-9)
    yaw, pitch = math.atan2(axes[0, 2], axes[2, 2]), math.atan2(-axes[1, 2], axes[2, 2])
    assert leaning_normal(yaw, pitch) == pytest.approx(placed.normal)


def test_without_a_normal_only_the_roll_is_known() -> None:
    placed = standing(turn(0.3 * Z), UNKNOWN)
    covariance = placed.known_covariance()
    assert placed.rotation() == pytest.approx(turn(0.3 * Z))
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


def test_an_impossible_normal_is_dropped() -> None:
    assert is_front(X, -Z, Z)
    # Seen from behind; not square to bars along x, so it contradicts the roll; its edge is seen; not known.
    for normal in (Z, turn(0.05 * Y) @ -Z, leaning_normal(0.0, 1.55), UNKNOWN):
        assert not is_front(X, normal, Z)
