# SPDX-License-Identifier: Apache-2.0
"""Positions of the platform that show its board to the camera, spread over the workspace."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_vision.images import Intrinsics
from deltacharger_vision.mount import Mount
from deltacharger_vision.projection import project

_INSET = 0.95  # of the workspace; a real arm reaches some millimetres less than its model
_SPARE = 1.1  # of the board's half diagonal that must be in the image
_NEAREST = 0.03  # m before the camera
_TRIED = 4096


def view_places(
    geometry: DeltaGeometry, farthest: float, mount: Mount, intrinsics: Intrinsics, offset: Vector, radius: float
) -> Iterator[Vector]:
    """Yield positions (m, charger_base) that the camera sees: a Halton sequence in the workspace box.

    Each prefix fills the box evenly, so position does not correlate with time.

    Args:
        geometry: gives the workspace box.
        farthest: largest z, m.
        mount: believed pose of the camera.
        intrinsics: of the camera.
        offset: origin of the board in end_effector, m.
        radius: half the board's diagonal, m.
    """
    from scipy.stats import qmc

    low, high = np.array(geometry.workspace_min), np.array(geometry.workspace_max)
    high[2] = min(high[2], farthest)
    middle, reach = (low + high) / 2, _INSET * (high - low) / 2
    points = middle + reach * (2.0 * qmc.Halton(3, scramble=False).random(_TRIED) - 1.0)
    for point in points[_visible(points + offset, mount, intrinsics, _SPARE * radius)]:
        yield float(point[0]), float(point[1]), float(point[2])


def _visible(centres: NDArray[np.float64], mount: Mount, intrinsics: Intrinsics, radius: float) -> NDArray[np.bool_]:
    """Return which spheres of `radius` m around `centres` (N, 3) are in the image."""
    turn, place = mount.pose[:3, :3], mount.pose[:3, 3]
    camera = (centres - place) @ turn
    before = camera[:, 2] > _NEAREST + radius
    pixels = project(np.where(before[:, None], camera, (0.0, 0.0, 1.0)), intrinsics)
    margin = radius * np.array([intrinsics.fx, intrinsics.fy]) / np.maximum(camera[:, 2:], _NEAREST)
    inside = (pixels > margin) & (pixels < np.array([intrinsics.width, intrinsics.height]) - margin)
    return np.asarray(before & inside.all(axis=1))
