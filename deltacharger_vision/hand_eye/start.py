# SPDX-License-Identifier: Apache-2.0
"""Initial hand-eye solution without a guess: the board's pose in each image, then Procrustes against the platform.

The platform only translates, so the board has one orientation C in the camera. Two poses fit an image of a plane
(IPPE); the right one fits all images. With C, the board's position X in the camera follows linearly. X = k Rᵀ (e − d)
then gives the camera's rotation R, d = t − o (camera minus board offset) and the scale k (Umeyama 1991, reweighted so
that a wrong view does little harm).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_vision.hand_eye.views import Corners, HandEyeError

_CAP = 3.0  # px; cap of a view's misfit
_LIKE = np.radians(10.0)  # orientations closer than this are one
_STEPS = 30
_NEAR = 0.0005  # m; smaller residuals have equal weight
_DECIDED = 1.5  # least ratio of the other orientation's misfit to the chosen one's


@dataclass(frozen=True, eq=False)
class Start:
    """An initial solution.

    Attributes:
        camera: (3, 3) charger_base_R_camera.
        shift: (3,) m, the camera's position minus the board's offset on the platform.
        board: (3, 3) end_effector_R_board.
        scale: factor on the board's size that fits the platform's moves.
        decided: whether only one orientation of the board fits.
    """

    camera: Array
    shift: Array
    board: Array
    scale: float
    decided: bool


def start(corners: Corners) -> Start:
    """Return an initial solution.

    Raises:
        HandEyeError: no board pose fits the images.
    """
    candidates = _candidates(corners)
    misfit, places = _tried(corners, candidates)
    first = int(np.argmin(misfit))
    answers = [_averaged(candidates, candidates[first])]
    apart = _angles(candidates, candidates[first]) > _LIKE
    if apart.any():
        other = int(np.flatnonzero(apart)[np.argmin(misfit[apart])])
        answers.append(_averaged(candidates, candidates[other]))
    misfit, places = _tried(corners, np.stack(answers))
    best = int(np.argmin(misfit))
    camera, shift, scale = _procrustes(corners.positions, places[best])
    decided = len(answers) == 1 or float(misfit[1 - best]) > _DECIDED * float(misfit[best])
    return Start(camera, shift, camera @ answers[best], 1.0 / scale, decided)


def _candidates(corners: Corners) -> Array:
    """Return (P, 3, 3) camera_R_board: both IPPE solutions of each view."""
    import cv2

    found = []
    for rows in corners.rows:
        points, image = corners.points[rows], corners.seen[rows] / corners.focal
        try:
            count, turns, _, _ = cv2.solvePnPGeneric(points, image, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
        except cv2.error:
            continue
        matrices = [cv2.Rodrigues(turn)[0] for turn in turns[:count]]
        found += [matrix for matrix in matrices if np.isfinite(matrix).all()]
    if not found:
        raise HandEyeError("no view shows the corners of a board; check the images and the board")
    return np.stack(found)


def _tried(corners: Corners, turns: Array) -> tuple[Array, Array]:
    """Return the misfit (P,) px² of orientations (P, 3, 3), and the board's positions (P, N, 3) m in the camera."""
    misfit = np.zeros(len(turns))
    places = np.zeros((len(turns), corners.views, 3))
    for view, rows in enumerate(corners.rows):
        ray = corners.seen[rows] / corners.focal
        turned = corners.points[rows] @ np.swapaxes(turns, 1, 2)
        # (turned + place) lies on the ray: x − u z = 0 and y − v z = 0.
        ones, zeros = np.ones(len(ray)), np.zeros(len(ray))
        equations = np.concatenate(
            [np.stack([ones, zeros, -ray[:, 0]], axis=-1), np.stack([zeros, ones, -ray[:, 1]], axis=-1)]
        )
        wanted = np.concatenate([ray[:, i] * turned[..., 2] - turned[..., i] for i in (0, 1)], axis=-1)
        places[:, view] = wanted @ np.linalg.pinv(equations).T
        depth = np.maximum(places[:, view, 2], 1e-3)
        error = (places[:, view] @ equations.T - wanted) * (corners.focal.mean() / depth)[:, None]
        behind = places[:, view, 2] <= 0.0
        misfit += np.where(behind, _CAP**2, np.minimum((error**2).mean(axis=-1), _CAP**2))
    return misfit, places


def _averaged(candidates: Array, chosen: Array) -> Array:
    """Return the mean (3, 3) of the candidates near the chosen one."""
    near = candidates[_angles(candidates, chosen) <= _LIKE]
    return _nearest_rotation(near.sum(axis=0))


def _angles(turns: Array, other: Array) -> Array:
    """Return the angles (P,) rad between rotations (P, 3, 3) and another (3, 3)."""
    cosine = (np.einsum("pij,ij->p", turns, other) - 1.0) / 2.0
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _nearest_rotation(matrix: Array) -> Array:
    """Return the rotation nearest to a matrix (3, 3)."""
    u, _, v = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v)


def _procrustes(positions: Array, places: Array) -> tuple[Array, Array, float]:
    """Return R (3, 3), d (3,) m and k of places (N, 3) = k Rᵀ (positions (N, 3) − d)."""
    weight = np.ones(len(positions))
    turn, shift, scale = np.eye(3), np.zeros(3), 1.0
    for _ in range(_STEPS):
        share = weight[:, None] / weight.sum()
        middle, centre = (share * positions).sum(axis=0), (share * places).sum(axis=0)
        moved, seen = positions - middle, places - centre
        turn = _nearest_rotation((share * moved).T @ seen)
        along = float(np.sum(share * seen * (moved @ turn)))
        scale = max(along / float(np.sum(share * moved**2)), 1e-3)
        shift = middle - turn @ centre / scale
        error = np.linalg.norm(places / scale - (positions - shift) @ turn, axis=1)
        weight = 1.0 / np.maximum(error, _NEAR)
    return turn, shift, scale
