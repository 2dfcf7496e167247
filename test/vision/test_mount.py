# SPDX-License-Identifier: Apache-2.0
"""Laws of the hand-eye transform: a detection's pose in charger_base and its uncertainty."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltacharger_vision.detector.detection import Detection
from deltacharger_vision.errors import MountError
from deltacharger_vision.mount import Mount, line_angle, look_at, quaternion
from deltacharger_vision.poses import turn

angles = st.floats(-math.pi, math.pi)


def seen(rotation: np.ndarray, position: np.ndarray, covariance: np.ndarray | None = None) -> Detection:
    """A detection of a terminal with this pose in the optical frame."""
    axis = rotation[:, 0] * (1.0 if rotation[0, 0] >= 0.0 else -1.0)
    return Detection(
        position=position,
        roll=line_angle(axis[0], axis[1]),
        axis=axis,
        normal=-rotation[:, 2],
        covariance=np.zeros((6, 6)) if covariance is None else covariance,
        confidence=1.0,
        range=float(np.linalg.norm(position)),
        bars=np.zeros((2, 4, 2)),
        source="fused",
    )


def through(mount: Mount, position: np.ndarray, roll: float) -> Detection:
    """Detection of a terminal in charger_base at `position`, rolled about z."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn(np.array([0.0, 0.0, roll])), position
    inside = np.linalg.inv(mount.pose) @ pose
    return seen(inside[:3, :3], inside[:3, 3])


@given(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(0.02, 0.4), st.floats(-1.5, 1.5))
def test_a_detection_is_placed_in_charger_base(x: float, y: float, z: float, roll: float) -> None:
    mount = Mount.default()
    placed = mount.place(through(mount, np.array([x, y, z]), roll))
    assert placed.position == pytest.approx([x, y, z], abs=1e-12)
    assert placed.roll == pytest.approx(roll, abs=1e-12)
    assert placed.normal == pytest.approx([0.0, 0.0, -1.0], abs=1e-12)


def test_the_default_camera_is_upright_and_centres_the_dock() -> None:
    dock = np.linalg.inv(Mount.default().pose) @ np.array([0.0, 0.0, 0.080, 1.0])
    assert dock[:2] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert dock[2] == pytest.approx(math.hypot(0.12, 0.20))
    upward = np.linalg.inv(Mount.default().pose) @ np.array([0.0, 0.1, 0.080, 1.0])
    assert upward[1] < 0.0  # the optical frame's y points down


def test_the_covariance_holds_for_errors_of_camera_and_mount() -> None:
    random = np.random.default_rng(4)
    nominal = Mount.from_numbers([0.0, 0.12, -0.12, *quaternion(Mount.default().pose[:3, :3])], 0.002, 0.01)
    own = np.diag([0.3, 0.3, 0.9, 4.0, 4.0, 2.0]) ** 2 * 1e-6
    tilt = turn(np.array([0.2, -0.3, 0.4]))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = tilt, (0.01, -0.02, 0.09)
    expected = nominal.place(
        seen(*(lambda inside: (inside[:3, :3], inside[:3, 3]))(np.linalg.inv(nominal.pose) @ pose), own)
    )
    errors = []
    for _ in range(4000):
        true = nominal.pose.copy()
        true[:3, :3] = turn(0.01 * random.normal(size=3)) @ true[:3, :3]
        true[:3, 3] += 0.002 * random.normal(size=3)
        inside = np.linalg.inv(true) @ pose
        noise = random.multivariate_normal(np.zeros(6), own)
        inside[:3, :3] = turn(noise[3:]) @ inside[:3, :3]
        placed = nominal.place(seen(inside[:3, :3], inside[:3, 3] + noise[:3]))
        errors.append([*(placed.position - expected.position), placed.roll - expected.roll])
    sampled = np.cov(np.array(errors).T)
    rows = np.ix_([0, 1, 2, 5], [0, 1, 2, 5])
    predicted = expected.covariance[rows]
    whitened = np.linalg.solve(np.linalg.cholesky(predicted), np.array(errors).T)
    assert np.cov(whitened) == pytest.approx(np.eye(4), abs=0.12)
    assert np.sqrt(np.diag(sampled)) == pytest.approx(np.sqrt(np.diag(predicted)), rel=0.05)


@given(angles, angles, angles)
def test_a_quaternion_matches_its_rotation(a: float, b: float, c: float) -> None:
    rotation = turn(np.array([a, 0.0, 0.0])) @ turn(np.array([0.0, b, 0.0])) @ turn(np.array([0.0, 0.0, c]))
    q = quaternion(rotation)
    assert q[3] >= 0.0
    assert Mount.from_numbers([0.0, 0.0, 0.0, *q]).pose[:3, :3] == pytest.approx(rotation, abs=1e-9)


def test_a_saved_mount_loads_unchanged(tmp_path: Path) -> None:
    spread = np.diag([1e-3, 2e-3, 3e-3, 0.01, 0.02, 0.03]) ** 2
    spread[0, 4] = spread[4, 0] = 1e-6
    Mount(Mount.default().pose, spread).save(tmp_path / "mount.yaml", {"views": 20, "residual_px": 0.21})
    loaded = Mount.load(tmp_path / "mount.yaml")
    assert loaded.pose == pytest.approx(Mount.default().pose, abs=1e-7)
    assert loaded.covariance == pytest.approx(spread, rel=1e-5)
    assert "residual_px: 0.21" in (tmp_path / "mount.yaml").read_text()


def test_a_file_without_covariance_gets_the_usual_error(tmp_path: Path) -> None:
    path = tmp_path / "mount.yaml"
    path.write_text("position: [0, 0.1, 0]\norientation: [0, 0, 0, 1]\n")
    assert np.sqrt(np.diag(Mount.load(path).covariance)) == pytest.approx([0.002] * 3 + [math.radians(0.5)] * 3)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("position: [0, 0, 0]\n", "orientation"),
        ("position: [0, 120, -120]\norientation: [0, 0, 0, 1]\n", "metres"),
        ("position: [0, 0, .nan]\norientation: [0, 0, 0, 1]\n", "finite"),
        ("position: [0, 0, 0]\norientation: [0, 0, 0, 1]\ncovariance: [1, 2]\n", "36 numbers"),
        ("position: [0, 0, 0]\norientation: [0, 0, 0, 1]\nframe: base_link\n", "base_link"),
        ("translation: [0, 0, 0]\n", "unknown key 'translation'"),
        ("position: [", "not valid YAML: line"),
    ],
)
def test_a_wrong_file_is_refused_by_name(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "mount.yaml"
    path.write_text(text)
    with pytest.raises(MountError, match=problem) as caught:
        Mount.load(path)
    assert str(path) in str(caught.value)


def test_a_negative_covariance_is_refused() -> None:
    with pytest.raises(MountError, match="not negative"):
        Mount(np.eye(4), -np.eye(6))


def test_a_camera_that_looks_straight_down_has_no_upright() -> None:
    with pytest.raises(MountError, match="straight"):
        look_at((0.0, 0.1, 0.0), (0.0, 0.0, 0.0))
