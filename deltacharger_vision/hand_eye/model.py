# SPDX-License-Identifier: Apache-2.0
"""The measurement model of a hand-eye calibration: expected positions of the board's corners, and their derivatives.

With the platform at e (forward kinematics), its constant angle errors δ, and the board's offset o and orientation Q:
a corner b is at e + J δ + o + Q s b in charger_base, and at X = Rᵀ (e + J δ + Q s b − d) in the camera with
d = t − o. Only the difference d is observable, because platform and board never turn; o is measured with a ruler. s is
1, or fitted to check the stated size of the board.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import JOINTS
from deltacharger_vision.hand_eye.views import Corners
from deltacharger_vision.poses import cross_matrix, turn

CAMERA, SHIFT, BOARD, ANGLES, SCALE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 9 + len(JOINTS)), 9 + len(JOINTS)
"""Columns of a step: rotation of the camera (rad, about charger_base's axes), d (m), rotation of the board (rad),
joint errors (rad), and the logarithm of s."""
FREE, FREE_WITH_SCALE = SCALE, SCALE + 1
"""Length of a step."""
_CLOSEST = 1e-3  # m


@dataclass(frozen=True, eq=False)
class HandEyeState:
    """Parameters to fit.

    Attributes:
        camera: (3, 3) R, charger_base_R_camera.
        shift: (3,) d, m.
        board: (3, 3) Q, end_effector_R_board.
        joints: (3,) δ, rad.
        scale: s.
    """

    camera: Array
    shift: Array
    board: Array
    joints: Array
    scale: float = 1.0

    def moved(self, step: Array) -> HandEyeState:
        """Return the state after a step (12,) or (13,)."""
        return dataclasses.replace(
            self,
            camera=turn(step[CAMERA]) @ self.camera,
            shift=self.shift + step[SHIFT],
            board=turn(step[BOARD]) @ self.board,
            joints=self.joints + step[ANGLES],
            scale=self.scale * (math.exp(step[SCALE]) if len(step) > SCALE else 1.0),
        )


def residuals(corners: Corners, state: HandEyeState) -> Array:
    """Return (M, 2) px: expected minus measured corners."""
    camera = _in_base(corners, state) @ state.camera
    depth = np.maximum(camera[:, 2:], _CLOSEST)
    return np.asarray(corners.focal * camera[:, :2] / depth - corners.seen)


def jacobian(corners: Corners, state: HandEyeState, step: Array) -> tuple[Array, Array]:
    """Return the derivatives of the residuals at `state.moved(step)`.

    Returns:
        (M, 2, 12 or 13) px by the step, and (M, 2, 3) px/m by the platform's position.
    """
    at = state.moved(step)
    base = _in_base(corners, at)
    camera = base @ at.camera
    depth = np.maximum(camera[:, 2], _CLOSEST)
    by_camera = np.zeros((len(base), 2, 3))
    for axis in (0, 1):
        by_camera[:, axis, axis] = corners.focal[axis] / depth
        by_camera[:, axis, 2] = -corners.focal[axis] * camera[:, axis] / depth**2
    by_position = by_camera @ at.camera.T
    turned = at.scale * corners.points @ at.board.T
    found = np.zeros((len(base), 2, len(step)))
    # A rotation by w: dRᵀ y = Rᵀ [y]× dw and d(Q b) = −[Q b]× dq, with dw to the left of the previous step.
    found[:, :, CAMERA] = by_position @ _skew(base) @ _left(step[CAMERA])
    found[:, :, SHIFT] = -by_position
    found[:, :, BOARD] = -by_position @ _skew(turned) @ _left(step[BOARD])
    found[:, :, ANGLES] = by_position @ corners.slopes[corners.view]
    if len(step) > SCALE:
        found[:, :, SCALE] = np.einsum("mij,mj->mi", by_position, turned)
    return found, by_position


def _in_base(corners: Corners, state: HandEyeState) -> Array:
    """Return (M, 3) m, the corners relative to the camera, along the axes of charger_base."""
    platform = corners.positions + corners.slopes @ state.joints - state.shift
    return np.asarray(platform[corners.view] + state.scale * corners.points @ state.board.T)


def _skew(vectors: Array) -> Array:
    """Return (M, 3, 3), [v]× of vectors (M, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)


def _left(vector: Array) -> Array:
    """Return the left Jacobian (3, 3) of SO(3) at a rotation vector (rad): turn(v + dv) = turn(J dv) turn(v)."""
    angle = float(np.linalg.norm(vector))
    skew = cross_matrix(vector)
    if angle < 1e-6:
        return np.asarray(np.eye(3) + 0.5 * skew)
    first, second = (1.0 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * skew + second * skew @ skew)
