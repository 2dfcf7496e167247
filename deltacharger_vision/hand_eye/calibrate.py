# SPDX-License-Identifier: Apache-2.0
"""Hand-eye calibration: the camera's mount from views of a board, and its checks.

The platform only translates, so the classical AX = XB has no solution. The camera's rotation follows from the
directions of the platform's moves. Its position depends on the board's offset on the platform, which must be measured
with a ruler; the offset's error is also the camera's. The fit also finds the board's orientation.

`calibrate` returns the mount with a covariance, the error on held-out views, and the board size that fits the moves.
`doubts` are reasons not to use the mount, `notes` hints for the next calibration.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deltacharger_core import arrays, machine
from deltacharger_vision import images, terminal
from deltacharger_vision.hand_eye.fit import (
    ANGLES,
    CAMERA,
    FEWEST,
    SCALE,
    SHIFT,
    Beliefs,
    Corners,
    HandEyeError,
    HandEyeFit,
    HandEyeState,
    Start,
    View,
    fit,
    set_apart,
    start,
)
from deltacharger_vision.mount import Mount

HELD_OUT = 5
"""Every so many views, one tests a fit to the others; the mount itself is fitted to all."""
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
    board: arrays.Array
    joints: tuple[arrays.Array, arrays.Array]
    joint_surprise: float
    fit: HandEyeFit
    held_out: tuple[int, ...]
    held_out_errors: arrays.Array
    size: float
    size_stddev: float
    decided: bool
    positions: arrays.Array
    reprojection: arrays.Array

    def point_covariance(self, point: arrays.Array) -> arrays.Array:
        """Return the covariance (3, 3) m², by the mount alone, of a `point` (3,) m in charger_base."""
        lever = np.hstack([np.eye(3), -terminal.cross_matrix(np.asarray(point) - self.mount.pose[:3, 3])])
        return np.asarray(lever @ self.mount.covariance @ lever.T)


def calibrate(views: Sequence[View], intrinsics: images.Intrinsics, beliefs: Beliefs) -> Calibration:
    """Find the camera's mount.

    Args:
        views: five or more, in the order of recording.
        intrinsics: of the camera.
        beliefs: the board's offset, and the accuracy of all inputs.

    Raises:
        HandEyeError: too few views, platform moves that leave the mount unknown, or contradictory views.
        CameraInfoError: the lens's distortion is not one-to-one at a corner.
    """
    judges = range(HELD_OUT - 1, len(views), HELD_OUT)
    check_moves([view.position for view in views])
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


def check_moves(positions: Sequence[arrays.Array]) -> None:
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


def moved(positions: arrays.Array) -> tuple[arrays.Array, arrays.Array]:
    """Return the extents (3,) m of positions (N, 3), largest first, and their unit axes (3, 3), row by row."""
    centred = positions - positions.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=True)[2]
    along = np.ptp(centred @ axes.T, axis=0)
    order = np.argsort(-along)
    return along[order], axes[order]


def axis_name(axis: arrays.Array) -> str:
    """Return a unit axis (3,) of charger_base as text."""
    largest = int(np.argmax(np.abs(axis)))
    if abs(axis[largest]) > 0.9:
        return "xyz"[largest]
    signed = axis * np.sign(axis[largest])
    return "(" + ", ".join(f"{value:.2f}" for value in signed) + ")"


def count_places(positions: arrays.Array) -> int:
    """Return the number of distinct places of positions (N, 3) m."""
    places: list[arrays.Array] = []
    for position in positions:
        if all(np.linalg.norm(position - place) > PLACES_APART for place in places):
            places.append(position)
    return len(places)


def _state(first: Start, scale: float) -> HandEyeState:
    return HandEyeState(first.camera, first.shift, first.board, np.zeros(len(machine.JOINTS)), scale)


def _mount(found: HandEyeFit, beliefs: Beliefs) -> Mount:
    pose = terminal.transform(found.state.camera, found.state.shift + beliefs.offset)
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
    gained = np.eye(len(machine.JOINTS)) - found.covariance[ANGLES, ANGLES] / beliefs.joint_stddev**2
    values, axes = np.linalg.eigh(gained)
    return float(np.sum((errors @ axes) ** 2 / np.maximum(values, _KNOWN_SHARE)))


def _judged(
    views: Sequence[View], intrinsics: images.Intrinsics, beliefs: Beliefs, judges: Sequence[int], state: HandEyeState
) -> arrays.Array:
    """Return the errors (len(judges), 3) m of a fit to the other views."""
    others = [view for index, view in enumerate(views) if index not in judges]
    found = fit(Corners.of(others, intrinsics), beliefs, state)
    return set_apart(Corners.of([views[index] for index in judges], intrinsics), found.state).moves


def _reprojection(corners: Corners, found: HandEyeFit) -> arrays.Array:
    """Return (N,) px: the residual of a view by both movement of the board and scatter of its corners."""
    apart = found.apart
    count = np.bincount(corners.view)
    by_move = np.einsum("ni,nij,nj->n", apart.moves, apart.precision, apart.moves)
    return np.asarray(np.sqrt((apart.rest + by_move) / count))


GOOD_VIEWS = 15
"""More views gain little against the error of the board's offset."""
_GOOD_SPAN = 0.030  # m
_SIZE, _SIZE_SIGMAS = 0.008, 4.0
_SHARE = 0.2  # of views that contradict the others
_ROTATION = math.radians(0.3)  # standard deviation
_ARM, _PIXEL, _HELD_OUT = 0.001, 0.8, 0.002  # m, px, m
_SURPRISE = 16.3  # of χ² with three degrees of freedom; one correct arm in 1000 exceeds it
_NAMED = 5


def doubts(found: Calibration, size: float, names: Sequence[str]) -> list[str]:
    """Return why the mount should not be used; empty if it should.

    Args:
        found: calibration to check.
        size: stated size of the board, m: of the tag's black square or of a chessboard square.
        names: (N,) of the images.
    """
    wrong_size = _size(found, size)
    if wrong_size:
        return [wrong_size]  # other doubts would follow from it
    reasons = [*_agreement(found, names), _joints(found), _certainty(found)]
    if not found.decided:
        reasons.append("the board could also be tilted the other way: turn it by 20° on the platform, or move it more")
    return [text for text in reasons if text]


def notes(found: Calibration, names: Sequence[str]) -> list[str]:
    """Return hints for a better mount; arguments as in `doubts`."""
    hints = []
    kept = found.positions[found.fit.kept]
    if len(kept) < GOOD_VIEWS:
        hints.append(f"{len(kept)} views are few; take {GOOD_VIEWS} or more")
    for extent, axis in zip(*moved(kept), strict=True):
        if extent < _GOOD_SPAN:
            hints.append(
                f"the platform moved by {1e3 * extent:.0f} mm only along {axis_name(axis)}; give it "
                f"{1e3 * _GOOD_SPAN:.0f} mm and more, as far as the camera sees the board"
            )
    if 0 < np.count_nonzero(~found.fit.kept) <= _SHARE * len(names):
        hints.append(f"left out, as the others contradict: {_named(found, names)}")
    return hints


def _size(found: Calibration, size: float) -> str:
    off = abs(math.log(found.size))
    if off < max(_SIZE, _SIZE_SIGMAS * found.size_stddev / found.size):
        return ""
    likely, spread = 1e3 * size * found.size, 1e3 * size * found.size_stddev
    return (
        f"the platform's moves show that the board's size is {likely:.2f} ± {spread:.2f} mm, not {1e3 * size:g} mm: "
        "measure the print. If it is right, the image is over-exposed, or focal length or the arm's geometry is wrong"
    )


def _agreement(found: Calibration, names: Sequence[str]) -> list[str]:
    reasons = []
    spread = found.fit.spread
    left = int(np.count_nonzero(~found.fit.kept))
    if left > _SHARE * len(names):
        reasons.append(
            f"{left} of {len(names)} views contradict the others ({_named(found, names)}): do their positions belong "
            "to these images?"
        )
    if spread.arm > _ARM:
        reasons.append(
            f"platform and images disagree by {1e3 * spread.arm:.1f} mm in each direction: calibrate the arm, fasten "
            "camera and board, and let the arm come to rest before each image"
        )
    if spread.pixel > _PIXEL:
        reasons.append(
            f"corners scatter by {spread.pixel:.1f} px about the board's shape: is the board flat, the image sharp, "
            "the camera's calibration that of this image size?"
        )
    error = held_out_rms(found)
    if error > _HELD_OUT:
        reasons.append(f"held-out images show the board {1e3 * error:.1f} mm from where it is expected")
    return reasons


def held_out_rms(found: Calibration) -> float:
    """Return the root mean square length (m) of the held-out errors, without views that contradict the others."""
    good = found.fit.kept[list(found.held_out)]
    return math.sqrt(float(np.mean(np.sum(found.held_out_errors[good] ** 2, axis=1)))) if good.any() else math.nan


def _joints(found: Calibration) -> str:
    if found.joint_surprise < _SURPRISE:
        return ""
    worst = math.degrees(float(np.abs(found.joints[0]).max()))
    return (
        f"the arm's angles are off by more than stated, by at least {worst:.1f}°: calibrate the arm and give its "
        "--geometry"
    )


def _certainty(found: Calibration) -> str:
    worst = math.sqrt(float(np.linalg.eigvalsh(found.mount.covariance[3:, 3:])[-1]))
    if worst < _ROTATION:
        return ""
    return (
        f"the camera's rotation is known to ±{math.degrees(worst):.2f}° only: take more views, further apart, as far "
        "as the camera sees the board"
    )


def _named(found: Calibration, names: Sequence[str]) -> str:
    left = [names[index] for index in np.flatnonzero(~found.fit.kept).tolist()]
    more = f" and {len(left) - _NAMED} more" if len(left) > _NAMED else ""
    return ", ".join(left[:_NAMED]) + more
