# SPDX-License-Identifier: Apache-2.0
"""Inputs of a hand-eye calibration, views of a board on the platform and prior knowledge; its model, start and fit.

The measurement model of a hand-eye calibration: expected positions of the board's corners, and their derivatives.
With the platform at e (forward kinematics), its constant angle errors δ, and the board's offset o and orientation Q:
a corner b is at e + J δ + o + Q s b in charger_base, and at X = Rᵀ (e + J δ + Q s b − d) in the camera with
d = t − o. Only the difference d is observable, because platform and board never turn; o is measured with a ruler. s is
1, or fitted to check the stated size of the board.

Initial hand-eye solution without a guess: the board's pose in each image, then Procrustes against the platform.
The platform only translates, so the board has one orientation C in the camera. Two poses fit an image of a plane
(IPPE); the right one fits all images. With C, the board's position X in the camera follows linearly. X = k Rᵀ (e − d)
then gives the camera's rotation R, d = t − o (camera minus board offset) and the scale k (Umeyama 1991, reweighted so
that a wrong view does little harm).

The hand-eye fit of all corners of all views at once, each view with its own position error.
A corner scatters by σ px. In addition, all corners of a view move together, by τ m in each direction, because the
arm's position differs from its angles. A view's residuals have the covariance σ² I + τ² G Gᵀ, with G = ∂pixels/∂e. Both
spreads come from the data: σ from what moving the board cannot explain, τ from what it can (the estimator of Paule and
Mandel, 1982), each with a weak prior. A robust fit comes first; the final one leaves out contradicting views.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from deltacharger_core import arrays, machine
from deltacharger_vision import errors, images, terminal
from deltacharger_vision.hand_eye.board import Sighting

FEWEST = 5
"""Views needed for a calibration, one of them to test the others."""
_FARTHEST = 10.0
"""Largest plausible coordinate of a platform, m."""


class HandEyeError(errors.VisionError, ValueError):
    """The views do not determine the mount. Example: in all, the platform was on one line.

    Args:
        reason: what is missing and what to do.
    """


@dataclass(frozen=True, eq=False)
class View:
    """One image of the board, with the platform at rest.

    Attributes:
        position: (3,) m of end_effector in charger_base, by forward kinematics.
        sighting: the board's corners in the image.
        slope: (3, 3) m/rad, derivative of `position` by each arm angle; 0 if the angles are exact.

    Raises:
        HandEyeError: a number is not finite, or the platform is far outside any workspace.
    """

    position: arrays.Array
    sighting: Sighting
    slope: arrays.Array

    def __post_init__(self) -> None:
        if np.shape(self.position) != (3,) or np.shape(self.slope) != (3, len(machine.JOINTS)):
            raise HandEyeError("a view needs a position (3,) and its slope (3, 3)")
        numbers = (self.position, self.slope, self.sighting.corners, self.sighting.pixels)
        if not all(np.isfinite(each).all() for each in numbers) or np.abs(self.position).max() > _FARTHEST:
            raise HandEyeError(f"a view at {np.asarray(self.position)} m; give finite numbers in metres")


@dataclass(frozen=True)
class Beliefs:
    """Knowledge before the views. Standard deviations without a source are assumed.

    Attributes:
        offset: (3,) m, origin of the board in end_effector.
    """

    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    offset_stddev: float = 0.0005  # m, of each coordinate of `offset`, measured by hand
    joint_stddev: float = 0.001745  # rad, of each arm's constant angle error (0.1°)
    arm_stddev: float = 0.0001  # m, scatter of a position; corrected by the views
    pixel_stddev: float = 0.1  # px, scatter of a corner; corrected by the views

    def __post_init__(self) -> None:
        if len(self.offset) != 3 or not np.isfinite(self.offset).all() or np.abs(self.offset).max() > 1.0:
            raise HandEyeError(f"the board's offset is {self.offset}; give three lengths within ±1 m")


@dataclass(frozen=True, eq=False)
class Corners:
    """The M corners of N views, one row each, view after view.

    Attributes:
        view: (M,) index of the view.
        points: (M, 3) m in the board's frame.
        seen: (M, 2) px without lens distortion: focal length times ray, from the principal point.
        positions: (N, 3) m.
        slopes: (N, 3, 3) m/rad.
        focal: (2,) px.
    """

    view: NDArray[np.int64]
    points: arrays.Array
    seen: arrays.Array
    positions: arrays.Array
    slopes: arrays.Array
    focal: arrays.Array

    @property
    def views(self) -> int:
        """Number of views."""
        return len(self.positions)

    @cached_property
    def rows(self) -> tuple[slice, ...]:
        """The rows of each view."""
        ends = np.cumsum(np.bincount(self.view, minlength=self.views)).tolist()
        return tuple(slice(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True))

    @staticmethod
    def of(views: Sequence[View], intrinsics: images.Intrinsics) -> Corners:
        """Gather the corners of `views` and undistort them.

        Raises:
            CameraInfoError: the lens's distortion is not one-to-one at a corner.
        """
        focal = np.array([intrinsics.fx, intrinsics.fy])
        pixels = np.concatenate([view.sighting.pixels for view in views])
        return Corners(
            np.repeat(np.arange(len(views)), [len(view.sighting.pixels) for view in views]),
            np.concatenate([view.sighting.corners for view in views]),
            focal * images.rays(pixels, intrinsics),
            np.stack([view.position for view in views]),
            np.stack([view.slope for view in views]),
            focal,
        )


CAMERA, SHIFT, BOARD, ANGLES, SCALE = (
    slice(0, 3),
    slice(3, 6),
    slice(6, 9),
    slice(9, 9 + len(machine.JOINTS)),
    9 + len(machine.JOINTS),
)
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

    camera: arrays.Array
    shift: arrays.Array
    board: arrays.Array
    joints: arrays.Array
    scale: float = 1.0

    def moved(self, step: arrays.Array) -> HandEyeState:
        """Return the state after a step (12,) or (13,)."""
        return dataclasses.replace(
            self,
            camera=terminal.turn(step[CAMERA]) @ self.camera,
            shift=self.shift + step[SHIFT],
            board=terminal.turn(step[BOARD]) @ self.board,
            joints=self.joints + step[ANGLES],
            scale=self.scale * (math.exp(step[SCALE]) if len(step) > SCALE else 1.0),
        )


def residuals(corners: Corners, state: HandEyeState) -> arrays.Array:
    """Return (M, 2) px: expected minus measured corners."""
    camera = _in_base(corners, state) @ state.camera
    depth = np.maximum(camera[:, 2:], _CLOSEST)
    return np.asarray(corners.focal * camera[:, :2] / depth - corners.seen)


def jacobian(corners: Corners, state: HandEyeState, step: arrays.Array) -> tuple[arrays.Array, arrays.Array]:
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


def _in_base(corners: Corners, state: HandEyeState) -> arrays.Array:
    """Return (M, 3) m, the corners relative to the camera, along the axes of charger_base."""
    platform = corners.positions + corners.slopes @ state.joints - state.shift
    return np.asarray(platform[corners.view] + state.scale * corners.points @ state.board.T)


def _skew(vectors: arrays.Array) -> arrays.Array:
    """Return (M, 3, 3), [v]× of vectors (M, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)


def _left(vector: arrays.Array) -> arrays.Array:
    """Return the left Jacobian (3, 3) of SO(3) at a rotation vector (rad): turn(v + dv) = turn(J dv) turn(v)."""
    angle = float(np.linalg.norm(vector))
    skew = terminal.cross_matrix(vector)
    if angle < 1e-6:
        return np.asarray(np.eye(3) + 0.5 * skew)
    first, second = (1.0 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * skew + second * skew @ skew)


_CAP = 3.0  # px; cap of a view's misfit
_LIKE = np.radians(10.0)  # orientations closer than this are one
_START_STEPS = 30
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

    camera: arrays.Array
    shift: arrays.Array
    board: arrays.Array
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


def _candidates(corners: Corners) -> arrays.Array:
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


def _tried(corners: Corners, turns: arrays.Array) -> tuple[arrays.Array, arrays.Array]:
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


def _averaged(candidates: arrays.Array, chosen: arrays.Array) -> arrays.Array:
    """Return the mean (3, 3) of the candidates near the chosen one."""
    near = candidates[_angles(candidates, chosen) <= _LIKE]
    return _nearest_rotation(near.sum(axis=0))


def _angles(turns: arrays.Array, other: arrays.Array) -> arrays.Array:
    """Return the angles (P,) rad between rotations (P, 3, 3) and another (3, 3)."""
    cosine = (np.einsum("pij,ij->p", turns, other) - 1.0) / 2.0
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _nearest_rotation(matrix: arrays.Array) -> arrays.Array:
    """Return the rotation nearest to a matrix (3, 3)."""
    u, _, v = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v)


def _procrustes(positions: arrays.Array, places: arrays.Array) -> tuple[arrays.Array, arrays.Array, float]:
    """Return R (3, 3), d (3,) m and k of places (N, 3) = k Rᵀ (positions (N, 3) − d)."""
    weight = np.ones(len(positions))
    turn, shift, scale = np.eye(3), np.zeros(3), 1.0
    for _ in range(_START_STEPS):
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


_ROBUST_STEPS, _STEPS = 12, 12
_CHANCE = 1e-5  # that a good view contradicts the others so much
_BELIEF = 6.0  # weight of a spread's prior, in observations
_FINEST_PIXEL, _FINEST_ARM = 0.01, 1e-5  # px, m
_COARSEST_ARM = 1.0  # m
_MEDIAN_OF_3 = 2.366  # median of χ² with three degrees of freedom
_STEP, _SETTLED = 1e-3, 1e-7  # m and rad; a millimetre is about a milliradian here
_FEWEST = 4  # views; fewer leave camera and board undetermined
_ALIKE = 1e-3  # negligible relative difference of spreads
_JURY = 8  # views; fewer do not show which of them is wrong


@dataclass(frozen=True)
class HandEyeSpread:
    """Standard deviations of a corner (px) and of a position (m)."""

    pixel: float
    arm: float


@dataclass(frozen=True, eq=False)
class Apart:
    """Residuals of views, separated into what another position explains and the rest.

    Attributes:
        moves: (N, 3) m in charger_base: position by the image minus prediction.
        precision: (N, 3, 3) 1/m² of `moves` by the corners alone, for σ = 1 px.
        rest: (N,) px², sum of squares that no move explains.
        counts: (N,) degrees of freedom of `rest`.
    """

    moves: arrays.Array
    precision: arrays.Array
    rest: arrays.Array
    counts: arrays.Array


@dataclass(frozen=True, eq=False)
class HandEyeFit:
    """A fitted state.

    Attributes:
        state: result.
        covariance: (12, 12) or (13, 13) of a step from the true state to the result.
        kept: (N,) views used for the fit; the others contradict them.
        spread: of corners and positions.
        apart: residuals of all N views.
    """

    state: HandEyeState
    covariance: arrays.Array
    kept: arrays.Mask
    spread: HandEyeSpread
    apart: Apart


def fit(corners: Corners, beliefs: Beliefs, state: HandEyeState, free_scale: bool = False) -> HandEyeFit:
    """Fit a state to views.

    Args:
        corners: of N views.
        beliefs: prior knowledge.
        state: initial state.
        free_scale: also fit the board's size.

    Raises:
        HandEyeError: fewer than four views agree.
    """
    length = FREE_WITH_SCALE if free_scale else FREE
    spread = HandEyeSpread(math.inf, math.inf)
    for _ in range(_ROBUST_STEPS):
        apart = set_apart(corners, state)
        before, spread = spread, _robust_spread(apart, beliefs)
        if _same(before, spread):
            break
        # Cauchy's weights: 1 for small residuals, falling with the square of large ones.
        weights = 1.0 / (1.0 + _distance(apart, spread) / (2.0 * np.bincount(corners.view)))
        state, _ = _solved(corners, beliefs, state, spread, weights, length)
    agreeing = _agreeing(set_apart(corners, state), spread)
    kept, covariance = agreeing, np.eye(length)
    for _ in range(_STEPS):
        kept = agreeing
        if kept.sum() < _FEWEST:
            raise HandEyeError(f"only {kept.sum()} of {len(kept)} views agree; give the right position of each image")
        state, covariance = _solved(corners, beliefs, state, spread, kept.astype(float), length)
        apart = set_apart(corners, state)
        before, spread = spread, _spread(apart, kept, beliefs, covariance)
        agreeing = _agreeing(apart, spread)
        if (agreeing == kept).all() and _same(before, spread):
            break
    return HandEyeFit(state, covariance, kept, spread, apart)


def set_apart(corners: Corners, state: HandEyeState) -> Apart:
    """Return the residuals of views, separated into moves of the board and the rest."""
    error = residuals(corners, state)
    _, by_position = jacobian(corners, state, np.zeros(FREE))
    moves, precision, rest, counts = [], [], [], []
    for rows in corners.rows:
        slope, values = by_position[rows].reshape(-1, 3), error[rows].ravel()
        move = -np.linalg.pinv(slope) @ values
        moves.append(move)
        precision.append(slope.T @ slope)
        rest.append(float(np.sum((values + slope @ move) ** 2)))
        counts.append(len(values) - 3)
    return Apart(np.array(moves), np.array(precision), np.array(rest), np.array(counts, dtype=float))


def _solved(
    corners: Corners, beliefs: Beliefs, state: HandEyeState, spread: HandEyeSpread, weights: arrays.Array, length: int
) -> tuple[HandEyeState, arrays.Array]:
    """Return the least-squares state, views weighted by `weights` (N,), and its covariance (length, length)."""
    from scipy.optimize import least_squares

    _, by_position = jacobian(corners, state, np.zeros(FREE))
    whiten = []
    for rows, weight in zip(corners.rows, weights, strict=True):
        slope = by_position[rows].reshape(-1, 3)
        covariance = spread.pixel**2 * np.eye(len(slope)) + spread.arm**2 * slope @ slope.T
        whiten.append((rows, np.sqrt(weight) * np.linalg.inv(np.linalg.cholesky(covariance))))
    joints = max(beliefs.joint_stddev, 1e-9)

    def values(step: arrays.Array) -> arrays.Array:
        moved = state.moved(step)
        error = residuals(corners, moved)
        parts = [matrix @ error[rows].ravel() for rows, matrix in whiten]
        return np.concatenate([*parts, moved.joints / joints])

    def slopes(step: arrays.Array) -> arrays.Array:
        found, _ = jacobian(corners, state, step)
        parts = [matrix @ found[rows].reshape(-1, length) for rows, matrix in whiten]
        prior = np.zeros((len(state.joints), length))
        prior[:, ANGLES] = np.eye(len(state.joints)) / joints
        return np.concatenate([*parts, prior])

    solved = least_squares(values, np.zeros(length), slopes, x_scale=_STEP, xtol=_SETTLED, ftol=1e-10, max_nfev=30)
    step = np.asarray(solved.x)
    found = slopes(step)
    return state.moved(step), _inverse(found.T @ found)


def _inverse(information: arrays.Array) -> arrays.Array:
    """Return the covariance of an information matrix whose units differ by many powers of ten."""
    size = np.sqrt(np.diag(information))
    try:
        found = np.linalg.inv(information / np.outer(size, size))
    except np.linalg.LinAlgError as error:
        raise HandEyeError(
            "the views leave the mount undetermined; move the platform further, in all directions"
        ) from error
    return np.asarray(found / np.outer(size, size))


def _same(first: HandEyeSpread, second: HandEyeSpread) -> bool:
    return math.isclose(first.arm, second.arm, rel_tol=_ALIKE) and math.isclose(
        first.pixel, second.pixel, rel_tol=_ALIKE
    )


def _distance(apart: Apart, spread: HandEyeSpread) -> arrays.Array:
    """Return (N,) squared residuals in units of their spread."""
    return np.asarray(_moves_squared(apart, spread) + apart.rest / spread.pixel**2)


def _moves_squared(apart: Apart, spread: HandEyeSpread) -> arrays.Array:
    """Return (N,) squared moves in units of the positions' spread and the corners' accuracy."""
    covariance = spread.arm**2 * np.eye(3) + spread.pixel**2 * np.linalg.pinv(apart.precision, hermitian=True)
    solved = np.linalg.solve(covariance, apart.moves[..., None])[..., 0]
    return np.asarray(np.sum(apart.moves * solved, axis=-1))


def _robust_spread(apart: Apart, beliefs: Beliefs) -> HandEyeSpread:
    """Return the spread that contains half of the views, at least the prior, because few views fit too well."""
    count = len(apart.moves)
    pixel = np.sqrt(np.median(apart.rest / np.maximum(apart.counts, 1.0)))
    arm = np.sqrt(np.median(np.sum(apart.moves**2, axis=1)) / _MEDIAN_OF_3 * count / max(count - 2.0, 1.0))
    return HandEyeSpread(max(float(pixel), beliefs.pixel_stddev), max(float(arm), beliefs.arm_stddev))


def _agreeing(apart: Apart, spread: HandEyeSpread) -> arrays.Mask:
    """Return (N,) which views agree with the others; all if there are too few to identify a wrong one."""
    from scipy.stats import chi2

    if len(apart.moves) < _JURY:
        return np.ones(len(apart.moves), dtype=bool)

    near = _moves_squared(apart, spread) < chi2.ppf(1.0 - _CHANCE, 3)
    sharp = apart.rest / spread.pixel**2 < chi2.ppf(1.0 - _CHANCE, np.maximum(apart.counts, 1.0))
    return np.asarray(near & sharp)


def _spread(apart: Apart, kept: arrays.Mask, beliefs: Beliefs, covariance: arrays.Array) -> HandEyeSpread:
    """Return the spread of the kept views; the prior counts as a few more observations."""
    from scipy.optimize import brentq

    # Of the fitted parameters, three (the board as seen by the camera) and the scale affect what no move explains.
    scaled = len(covariance) > SCALE
    left = max(float(apart.counts[kept].sum()) - 3.0 - scaled, 0.0)
    squares = float(apart.rest[kept].sum()) + _BELIEF * beliefs.pixel_stddev**2
    pixel = max(float(np.sqrt(squares / (left + _BELIEF))), _FINEST_PIXEL)
    # The other six, and the joints' errors as far as the views show them, affect the moves.
    gained = float(np.sum(1.0 - np.diag(covariance)[ANGLES] / max(beliefs.joint_stddev, 1e-9) ** 2))
    free = max(3.0 * float(kept.sum()) - 6.0 - min(max(gained, 0.0), 3.0), 0.0)
    some = Apart(apart.moves[kept], apart.precision[kept], apart.rest[kept], apart.counts[kept])

    def excess(arm: float) -> float:
        squared = float(_moves_squared(some, HandEyeSpread(pixel, arm)).sum())
        return squared + _BELIEF * (beliefs.arm_stddev / arm) ** 2 - free - _BELIEF

    if excess(_FINEST_ARM) <= 0.0:
        return HandEyeSpread(pixel, _FINEST_ARM)
    return HandEyeSpread(pixel, float(brentq(excess, _FINEST_ARM, _COARSEST_ARM, xtol=1e-8)))
