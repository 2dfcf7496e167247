# SPDX-License-Identifier: Apache-2.0
"""Hand-eye calibration: mount of the fixed camera on the charger, from images of a board on the moving platform.

The platform only translates, so the classical AX = XB has no solution. The camera's rotation follows from the
directions of the platform's moves. Its position depends on the board's offset on the platform, which must be measured
with a ruler; the offset's error is also the camera's. The fit also finds the board's orientation.

`calibrate` returns the mount with a covariance, the error on held-out views, and the board size that fits the moves;
`checks` lists doubts about them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import JOINTS
from deltacharger_vision.hand_eye.fit import HandEyeFit, fit, set_apart
from deltacharger_vision.hand_eye.model import ANGLES, BOARD, CAMERA, SCALE, SHIFT, HandEyeState
from deltacharger_vision.hand_eye.start import Start, start
from deltacharger_vision.hand_eye.views import FEWEST, Beliefs, Corners, HandEyeError, View
from deltacharger_vision.images import Intrinsics
from deltacharger_vision.mount import Mount
from deltacharger_vision.poses import cross_matrix, transform

HELD_OUT = 5
"""Period of held-out views, which test the others."""
LINE = 0.005
"""Least movement across the longest direction, m; with less, the rotation about that direction stays unknown."""
PLACES_APART = 0.005
"""Positions closer than this count as one, m."""
_FEWEST_PLACES = 4
_KNOWN_SHARE = 0.01
"""Share of a joint error's variance that views must remove to give any information."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated mount and its quality.

    Attributes:
        mount: of the camera; its covariance includes the error of the board's offset.
        board: (3, 3) end_effector_R_board.
        joints: (3,) rad, constant errors of the arm's angles as far as visible, and their standard deviations.
        joint_surprise: squared size of those errors in units of their prior; 3 if the prior is right.
        fit: to all views.
        held_out: indices of the views that tested a fit to the others.
        held_out_errors: (len(held_out), 3) m in charger_base: the board's position in those images minus the fit's
            prediction.
        size: factor on the stated board size that fits the platform's moves best; about 1 if the size is right.
        size_stddev: of `size`.
        decided: whether only one orientation of the board fits the images.
        positions: (N, 3) m, of the platform.
        reprojection: (N,) px, root mean square distance of a view's corners from their prediction.
    """

    mount: Mount
    board: Array
    joints: tuple[Array, Array]
    joint_surprise: float
    fit: HandEyeFit
    held_out: tuple[int, ...]
    held_out_errors: Array
    size: float
    size_stddev: float
    decided: bool
    positions: Array
    reprojection: Array

    def point_covariance(self, point: Array) -> Array:
        """Return the covariance (3, 3) m², by the mount alone, of a `point` (3,) m in charger_base."""
        lever = np.hstack([np.eye(3), -cross_matrix(np.asarray(point) - self.mount.pose[:3, 3])])
        return np.asarray(lever @ self.mount.covariance @ lever.T)

    @property
    def board_stddev(self) -> float:
        """Standard deviation (rad) of the board's orientation about its worst axis."""
        return float(np.sqrt(np.linalg.eigvalsh(self.fit.covariance[BOARD, BOARD])[-1]))


def calibrate(
    views: Sequence[View], intrinsics: Intrinsics, beliefs: Beliefs | None = None, every: int = HELD_OUT
) -> Calibration:
    """Find the camera's mount.

    Args:
        views: five or more, in the order of recording.
        intrinsics: of the camera.
        beliefs: the board's offset, and the accuracy of all inputs.
        every: period of held-out views, which test a fit to the others; the mount itself is fitted to all.

    Raises:
        HandEyeError: too few views, platform moves that leave the mount unknown, or contradictory views.
        CameraInfoError: the lens's distortion is not one-to-one at a corner.
    """
    beliefs = beliefs or Beliefs()
    judges = [index for index in range(len(views)) if index % every == every - 1]
    check_moves([view.position for view in views])
    if len(views) - len(judges) < FEWEST - 1:
        raise HandEyeError(f"{len(judges)} of {len(views)} views held out leave too few; take more, or hold out fewer")
    corners = Corners.of(views, intrinsics)
    first = start(corners)
    sized = fit(corners, beliefs, _state(first, first.scale), free_scale=True)
    try:
        whole = fit(corners, beliefs, _state(first, 1.0))
    except HandEyeError as error:
        raise HandEyeError(f"{error}; the board fits best at {sized.state.scale:.3f} of its size") from error
    return Calibration(
        mount=_mount(whole, beliefs),
        board=whole.state.board,
        joints=(whole.state.joints, np.sqrt(np.diag(whole.covariance)[ANGLES])),
        joint_surprise=_surprise(whole, beliefs),
        fit=whole,
        held_out=tuple(judges),
        held_out_errors=_judged(views, intrinsics, beliefs, judges, whole.state),
        size=sized.state.scale,
        size_stddev=sized.state.scale * float(np.sqrt(sized.covariance[SCALE, SCALE])),
        decided=first.decided,
        positions=corners.positions,
        reprojection=_reprojection(corners, whole),
    )


def check_moves(positions: Sequence[Array]) -> None:
    """Refuse platform positions (3,) m that leave the mount unknown.

    Raises:
        HandEyeError: states what is missing.
    """
    if len(positions) < FEWEST:
        raise HandEyeError(
            f"{len(positions)} views show the board, at least {FEWEST} are needed; take 20, all over the workspace"
        )
    places = count_places(np.array(positions))
    if places < _FEWEST_PLACES:
        raise HandEyeError(f"the platform stood at {places} places only; move it, 20 places are good")
    extents, axes = moved(np.array(positions))
    if extents[1] < LINE:
        raise HandEyeError(
            f"the platform moved along one line, {axis_name(axes[0])}; the camera's rotation about it stays unknown: "
            "move the platform in other directions too"
        )


def moved(positions: Array) -> tuple[Array, Array]:
    """Return the extents (3,) m of positions (N, 3), largest first, and their unit axes (3, 3), row by row."""
    centred = positions - positions.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=True)[2]
    along = np.ptp(centred @ axes.T, axis=0)
    order = np.argsort(-along)
    return along[order], axes[order]


def axis_name(axis: Array) -> str:
    """Return a unit axis (3,) of charger_base as text."""
    largest = int(np.argmax(np.abs(axis)))
    if abs(axis[largest]) > 0.9:
        return "xyz"[largest]
    signed = axis * np.sign(axis[largest])
    return "(" + ", ".join(f"{value:.2f}" for value in signed) + ")"


def count_places(positions: Array) -> int:
    """Return the number of distinct places of positions (N, 3) m."""
    places: list[Array] = []
    for position in positions:
        if all(np.linalg.norm(position - place) > PLACES_APART for place in places):
            places.append(position)
    return len(places)


def _state(first: Start, scale: float) -> HandEyeState:
    return HandEyeState(first.camera, first.shift, first.board, np.zeros(len(JOINTS)), scale)


def _mount(found: HandEyeFit, beliefs: Beliefs) -> Mount:
    pose = transform(found.state.camera, found.state.shift + beliefs.offset)
    order = np.r_[SHIFT, CAMERA]
    covariance = found.covariance[np.ix_(order, order)]
    covariance[:3, :3] += beliefs.offset_stddev**2 * np.eye(3)
    return Mount(pose, (covariance + covariance.T) / 2)


def _surprise(found: HandEyeFit, beliefs: Beliefs) -> float:
    """Return the joints' squared errors in units of P − C, their distribution if the prior P is right.

    C is their covariance after the views. If C equals P, the views give no information, which is no surprise.
    """
    if not beliefs.joint_stddev:
        return 0.0
    errors = found.state.joints / beliefs.joint_stddev
    gained = np.eye(len(JOINTS)) - found.covariance[ANGLES, ANGLES] / beliefs.joint_stddev**2
    values, axes = np.linalg.eigh(gained)
    return float(np.sum((errors @ axes) ** 2 / np.maximum(values, _KNOWN_SHARE)))


def _judged(
    views: Sequence[View], intrinsics: Intrinsics, beliefs: Beliefs, judges: Sequence[int], state: HandEyeState
) -> Array:
    """Return the errors (len(judges), 3) m of a fit to the other views."""
    if not judges:
        return np.empty((0, 3))
    others = [view for index, view in enumerate(views) if index not in judges]
    found = fit(Corners.of(others, intrinsics), beliefs, state)
    return set_apart(Corners.of([views[index] for index in judges], intrinsics), found.state).moves


def _reprojection(corners: Corners, found: HandEyeFit) -> Array:
    """Return (N,) px: the residual of a view by both movement of the board and scatter of its corners."""
    apart = found.apart
    count = np.bincount(corners.view)
    by_move = np.einsum("ni,nij,nj->n", apart.moves, apart.precision, apart.moves)
    return np.asarray(np.sqrt((apart.rest + by_move) / count))
