# SPDX-License-Identifier: Apache-2.0
"""Poses of a terminal, and small motions of them.

A pose is (rotation (3, 3), translation (3,) m): terminal coordinates to the optical frame. Inside the detector, the
terminal's frame has its origin at the midpoint of the touched faces, x along the bars and z away from the camera.
The bars' roots on the plate are at z = +bar_thickness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deltacharger_core.arrays import Array


@dataclass(frozen=True)
class TerminalPose:
    """Pose of the terminal in the optical frame: rotation (3, 3), translation (3,) m."""

    rotation: Array
    translation: Array

    def moved(self, step: Array) -> TerminalPose:
        """Return the pose after a step (6,): translation (m), then rotation about the optical axes (rad)."""
        return TerminalPose(turn(step[3:]) @ self.rotation, self.translation + step[:3])

    def points(self, terminal_points: Array) -> Array:
        """Return points (..., 3) of the terminal in the optical frame, m."""
        return np.asarray(terminal_points @ self.rotation.T + self.translation)


def turn(vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector (3,) rad (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    skew = cross_matrix(vector)
    if angle < 1e-9:
        return np.asarray(np.eye(3) + skew)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * skew + (1.0 - np.cos(angle)) / angle**2 * skew @ skew)


def transform(rotation: Array, position: ArrayLike) -> Array:
    """Return the transform (4, 4) of a rotation (3, 3) and a position (3,) m."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


def cross_matrix(vector: Array) -> Array:
    """Return [v]× of a vector (3,), so that [v]× w = v × w."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def facing(pose: TerminalPose) -> float:
    """Return the cosine between the line of sight and the terminal's z axis: 1 from the front, 0 edge-on."""
    return float(pose.rotation[:, 2] @ pose.translation / np.linalg.norm(pose.translation))
