# SPDX-License-Identifier: Apache-2.0
"""The hand-eye fit of all corners of all views at once, each view with its own position error.

A corner scatters by σ px. In addition, all corners of a view move together, by τ m in each direction, because the
arm's position differs from its angles. A view's residuals have the covariance σ² I + τ² G Gᵀ, with G = ∂pixels/∂e. Both
spreads come from the data: σ from what moving the board cannot explain, τ from what it can (the estimator of Paule and
Mandel, 1982), each with a weak prior. A robust fit comes first; the final one leaves out contradicting views.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from deltacharger_core.arrays import Array, Mask
from deltacharger_vision.hand_eye.model import (
    ANGLES,
    FREE,
    FREE_WITH_SCALE,
    SCALE,
    HandEyeState,
    jacobian,
    residuals,
)
from deltacharger_vision.hand_eye.views import Beliefs, Corners, HandEyeError

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

    moves: Array
    precision: Array
    rest: Array
    counts: Array


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
    covariance: Array
    kept: Mask
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
    corners: Corners, beliefs: Beliefs, state: HandEyeState, spread: HandEyeSpread, weights: Array, length: int
) -> tuple[HandEyeState, Array]:
    """Return the least-squares state, views weighted by `weights` (N,), and its covariance (length, length)."""
    from scipy.optimize import least_squares

    _, by_position = jacobian(corners, state, np.zeros(FREE))
    whiten = []
    for rows, weight in zip(corners.rows, weights, strict=True):
        slope = by_position[rows].reshape(-1, 3)
        covariance = spread.pixel**2 * np.eye(len(slope)) + spread.arm**2 * slope @ slope.T
        whiten.append((rows, np.sqrt(weight) * np.linalg.inv(np.linalg.cholesky(covariance))))
    joints = max(beliefs.joint_stddev, 1e-9)

    def values(step: Array) -> Array:
        moved = state.moved(step)
        error = residuals(corners, moved)
        parts = [matrix @ error[rows].ravel() for rows, matrix in whiten]
        return np.concatenate([*parts, moved.joints / joints])

    def slopes(step: Array) -> Array:
        found, _ = jacobian(corners, state, step)
        parts = [matrix @ found[rows].reshape(-1, length) for rows, matrix in whiten]
        prior = np.zeros((len(state.joints), length))
        prior[:, ANGLES] = np.eye(len(state.joints)) / joints
        return np.concatenate([*parts, prior])

    solved = least_squares(values, np.zeros(length), slopes, x_scale=_STEP, xtol=_SETTLED, ftol=1e-10, max_nfev=30)
    step = np.asarray(solved.x)
    found = slopes(step)
    return state.moved(step), _inverse(found.T @ found)


def _inverse(information: Array) -> Array:
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


def _distance(apart: Apart, spread: HandEyeSpread) -> Array:
    """Return (N,) squared residuals in units of their spread."""
    return np.asarray(_moves_squared(apart, spread) + apart.rest / spread.pixel**2)


def _moves_squared(apart: Apart, spread: HandEyeSpread) -> Array:
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


def _agreeing(apart: Apart, spread: HandEyeSpread) -> Mask:
    """Return (N,) which views agree with the others; all if there are too few to identify a wrong one."""
    from scipy.stats import chi2

    if len(apart.moves) < _JURY:
        return np.ones(len(apart.moves), dtype=bool)

    near = _moves_squared(apart, spread) < chi2.ppf(1.0 - _CHANCE, 3)
    sharp = apart.rest / spread.pixel**2 < chi2.ppf(1.0 - _CHANCE, np.maximum(apart.counts, 1.0))
    return np.asarray(near & sharp)


def _spread(apart: Apart, kept: Mask, beliefs: Beliefs, covariance: Array) -> HandEyeSpread:
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
