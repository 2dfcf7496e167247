"""Poses before a camera, and where a camera should show a point."""

from __future__ import annotations

import numpy as np

from deltacharger_vision.images import Intrinsics
from deltacharger_vision.lens import distort

DISTORTIONS = ((), (-0.30, 0.12, 0.001, -0.0005, -0.02), (6.5, -3.1, 0.0004, -0.0003, 0.9, 6.7, -2.4, 0.6))


def view(distance: float, pitch: float = 0.0, yaw: float = 0.0, roll: float = 0.0, x: float = 0.0) -> np.ndarray:
    """Return camera_T_terminal: straight ahead at `distance` m and upright, then turned (rad) about x, y, z."""
    found = np.eye(4)
    for axis, angle in enumerate((pitch, yaw, roll)):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(4)
        turn[i, i] = turn[j, j] = np.cos(angle)
        turn[j, i] = np.sin(angle)
        turn[i, j] = -turn[j, i]
        found = found @ turn
    found = found @ np.diag([-1.0, -1.0, 1.0, 1.0])
    found[:3, 3] = x, 0.0, distance
    return found


def shown(points: np.ndarray, pose: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """Return the pixels (..., 2) of points (..., 3) in the terminal's frame."""
    seen = points @ pose[:3, :3].T + pose[:3, 3]
    ideal = distort(seen[..., :2] / seen[..., 2:], intrinsics.distortion)
    return ideal * [intrinsics.fx, intrinsics.fy] + [intrinsics.cx, intrinsics.cy]


def linear(color: np.ndarray) -> np.ndarray:
    """Return light (H, W) of an sRGB image's green, full scale 1."""
    encoded = color[:, :, 1] / 255.0
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
