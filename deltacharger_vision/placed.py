# SPDX-License-Identifier: Apache-2.0
"""A detection in charger_base, and the lean of the target's touched faces.

For a target with axes as the columns of R in charger_base, yaw = atan2(R[0, 2], R[2, 2]) is the lean about +y, and
pitch = atan2(−R[1, 2], R[2, 2]) the lean about +x. The normal toward the camera is −R[:, 2].
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from deltacharger_core.arrays import Array

_SQUARE = 0.01  # cosine between bars and normal, which are perpendicular: a larger one contradicts the roll
_STEEPEST = 0.1  # least share of a normal along z: a lean of 84°


@dataclass(frozen=True)
class PlateLean:
    """Lean of the touched faces in charger_base, rad; all NaN if the normal is unknown.

    Attributes:
        yaw: about +y.
        pitch: about +x.
        covariance: (2, 2) of both, in this order.
    """

    yaw: float
    pitch: float
    covariance: Array

    @property
    def yaw_stddev(self) -> float:
        """Standard deviation of the yaw, rad."""
        return math.sqrt(self.covariance[0, 0])

    @property
    def pitch_stddev(self) -> float:
        """Standard deviation of the pitch, rad."""
        return math.sqrt(self.covariance[1, 1])


@dataclass(frozen=True, eq=False)
class Placed:
    """Electrodes in charger_base.

    Attributes:
        position: (3,) m, midpoint between the bars' touched faces.
        roll: rad in (−π/2, π/2], from +x to the projection of the bars' long axis on the x–y plane.
        normal: (3,) unit normal of the touched faces, toward the camera; NaN if unreliable.
        covariance: (6, 6) of position (m), of the rotation about x and y, and of the roll (rad), including the mount's
            error.
    """

    position: Array
    roll: float
    normal: Array
    covariance: Array

    @property
    def upright(self) -> bool:
        """Whether the normal is known."""
        return bool(np.isfinite(self.normal).all())

    def rotation(self) -> Array:
        """Return (3, 3) charger_base_R_target: z against the normal, x at the roll; without a normal, only the roll."""
        z = -self.normal if self.upright else np.array([0.0, 0.0, 1.0])
        x = np.array([math.cos(self.roll) * z[2], math.sin(self.roll) * z[2], 0.0])
        x[2] = -(math.cos(self.roll) * z[0] + math.sin(self.roll) * z[1])
        x /= np.linalg.norm(x)
        return np.column_stack([x, np.cross(z, x), z])

    def known_covariance(self) -> Array:
        """Return `covariance`, with NaN for the rotations about x and y if the normal is unknown."""
        found = self.covariance.copy()
        if not self.upright:
            found[3:5, :] = found[:, 3:5] = math.nan
        return found

    def lean(self) -> PlateLean:
        """Return the lean, with its first-order covariance."""
        if not self.upright:
            return PlateLean(math.nan, math.nan, np.full((2, 2), math.nan))
        x, _, z = self.rotation().T
        # dz = dω × z, and dωz follows the roll: dωz = d roll + x_z (x_x dωx + x_y dωy) / (x_x² + x_y²).
        about_z = np.array([*(x[2] * x[:2] / (x[0] ** 2 + x[1] ** 2)), 1.0])
        turning = np.vstack([np.eye(3)[:2], about_z])
        moved = np.array([[0.0, z[2], -z[1]], [-z[2], 0.0, z[0]], [z[1], -z[0], 0.0]]) @ turning
        slope = np.stack(
            [
                (z[2] * moved[0] - z[0] * moved[2]) / (z[0] ** 2 + z[2] ** 2),
                (z[1] * moved[2] - z[2] * moved[1]) / (z[1] ** 2 + z[2] ** 2),
            ]
        )
        return PlateLean(math.atan2(z[0], z[2]), math.atan2(-z[1], z[2]), slope @ self.covariance[3:, 3:] @ slope.T)


def leaning_normal(yaw: float, pitch: float) -> Array:
    """Return the (3,) unit normal, toward the camera, of faces with this yaw and pitch, rad."""
    z = np.array([math.tan(yaw), -math.tan(pitch), 1.0])
    return np.asarray(-z / np.linalg.norm(z))


def is_front(axis: Array, normal: Array, sight: Array) -> bool:
    """Return whether a normal belongs to faces visible from the front to camera and charger, square to their bars.

    Args:
        axis: (3,) unit vector along the bars.
        normal: (3,) unit normal, toward the camera.
        sight: (3,) from the camera to the faces.
    """
    return bool(normal @ sight < 0.0 and normal[2] < -_STEEPEST and abs(normal @ axis) < _SQUARE)
