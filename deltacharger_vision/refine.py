"""The pose that fits edges, and a plate's plane where there is one: robust nonlinear least squares.

Edges: distance of each seen place from its projected line (Drummond, Cipolla, "Real-time visual tracking of complex
structures", PAMI 24 (2002)). Plane: the inverse depth that a stereo camera sees of a plane n·X = D is linear in the
ray, q·ray with q = n/D.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deltacharger_vision.bounded import Bounded, value
from deltacharger_vision.edges import EdgePoints
from deltacharger_vision.plane import Plane
from deltacharger_vision.poses import Array, Pose, cross_matrix, facing
from deltacharger_vision.terminal import Terminal

_ROUNDS = 10
_ENOUGH = 2e-5  # m and rad
_LARGEST = 0.3  # rad a step
_FEWEST = 24  # edge points
_TILT = 0.7  # rad: a weak belief that the terminal is seen from the front, so that tilt stays finite


@dataclass(frozen=True)
class RefineSettings(Bounded):
    """How far edges are believed.

    Raises:
        ParameterError: a value is out of bounds.
    """

    bias: float = value(
        0.07, 0.001, 5.0, "px", "standard deviation of what shifts a whole edge (blur, glare, machining)"
    )
    noise: float = value(0.12, 0.001, 5.0, "px", "least standard deviation of one edge point")
    spread: float = value(0.05, 0.001, 5.0, "px", "standard deviation of how far light spreads over every edge")
    glare: float = value(0.5, 0.0, 5.0, "px", "the same per saturated share of the bars, added")
    outlier: float = value(4.7, 2.0, 20.0, "", "standard deviations beyond which a point counts for nothing (Tukey)")


@dataclass(frozen=True)
class Fit:
    """A pose and how well it fits.

    Attributes:
        pose: the pose.
        covariance: (6, 6) of position (m) and rotation about the optical axes (rad).
        used: (L, S) edge points that agree with the pose.
        scatter: px, robust standard deviation of the edge points.
        spread: px by which bars seem larger on every side, as bright metal does.
    """

    pose: Pose
    covariance: Array
    used: NDArray[np.bool_]
    scatter: float
    spread: float


class Edges:
    """Edge points that a terminal's pose is fitted to.

    Args:
        points: the edge points.
        terminal: size of the bars.
        focal: px, of a camera that would see the rays of the points.
        settings: how far they are believed.
    """

    def __init__(self, points: EdgePoints, terminal: Terminal, focal: float, settings: RefineSettings) -> None:
        self.points = points
        self._terminal = terminal
        self._focal = focal
        self._settings = settings
        self._line, self._place = np.nonzero(points.seen)
        self._model = points.model[points.seen]
        self._rays = points.rays[points.seen]
        self._bias = points.lines.bias[self._line]
        # What draws an edge toward a narrow side's other line differs along it: such points say little each.
        drawn = np.maximum(self._bias**2 - settings.bias**2, 0.0)
        self._independent = points.weight[self._line] / (1.0 + drawn / settings.noise**2)
        _, self._first, self._group = np.unique(self._line, return_index=True, return_inverse=True)
        self._spread = settings.spread + settings.glare * points.saturated

    def fit(self, start: Pose, plane: Plane | None = None) -> Fit | None:
        """Return the pose near `start` that fits the edges, and the plane; None where they do not settle it."""
        if len(self._line) < _FEWEST:
            return None
        pose, spread, covariance = start, 0.0, np.eye(7)
        residual, jacobian = self._residual(pose, spread)
        scatter, robust = self._trust(residual, np.ones(len(residual)), 2.0)
        for round_ in range(_ROUNDS):
            white = self._whitened(np.column_stack([jacobian, residual]), scatter, robust)
            weighted = white.T * (self._independent * robust / scatter**2)
            product = weighted @ white
            information, gradient = product[:7, :7], product[:7, 7]
            information[6, 6] += 1.0 / self._spread**2
            gradient[6] += spread / self._spread**2
            for extra, slope, precision in _beliefs(pose, self._terminal, plane):
                information[:6, :6] += slope.T @ precision @ slope
                gradient[:6] += slope.T @ precision @ extra
            try:
                covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
            except np.linalg.LinAlgError:  # edges that settle nothing
                return None
            step = -covariance @ gradient
            step *= min(1.0, _LARGEST / max(float(np.abs(step[3:6]).max()), 1e-12))
            pose, spread = pose.moved(step[:6]), spread + float(step[6])
            if not np.all(np.isfinite(step)) or pose.translation[2] <= 0.01 or facing(pose) <= 0.2:
                return None
            residual, jacobian = self._residual(pose, spread)
            # Far points are forgiven at first, while the start is still rough.
            scatter, robust = self._trust(residual, robust, 2.0 if round_ == 0 else 1.0)
            if np.abs(step[:6]).max() < _ENOUGH and round_ > 0:
                break
        used = np.zeros(self.points.seen.shape, dtype=bool)
        used[self._line, self._place] = robust > 0.0
        return Fit(pose, covariance[:6, :6], used, max(scatter, _spread(residual)), spread)

    def misfit(self, found: Fit, scatter: float, plane: Plane | None = None, missed: bool = True) -> float:
        """Return the robust sum of squares of a fit, in standard deviations of edge points of this scatter (px).

        Where `missed`, places without an edge count as outliers, so that explanations by other lines can be compared.
        """
        residual, _ = self._residual(found.pose, found.spread)
        limit = self._settings.outlier**2 / 3.0
        near = (np.abs(residual) < self._tolerance(scatter)).astype(float)
        white = self._whitened(residual[:, None], scatter, near)[:, 0]
        within = np.where(near > 0.0, np.minimum((white / (self._settings.outlier * scatter)) ** 2, 1.0), 1.0)
        squares = limit * (missed * self.points.missed + float(np.sum(self._independent * (1.0 - (1.0 - within) ** 3))))
        squares += (found.spread / self._spread) ** 2
        for extra, _, precision in _beliefs(found.pose, self._terminal, plane):
            squares += float(extra @ precision @ extra)
        return squares

    def _trust(self, residual: Array, robust: Array, width: float) -> tuple[float, Array]:
        """Return the scatter (px) of residuals (N,) about each line's mean, and Tukey's weights (N,)."""
        mean = self._means(residual[:, None], robust)[:, 0]
        scatter = max(self._settings.noise, _spread(residual - mean))
        whole = max(scatter, _spread(residual))
        return scatter, np.maximum(1.0 - (residual / (width * self._tolerance(whole))) ** 2, 0.0) ** 2

    def _tolerance(self, scatter: float) -> Array:
        return np.asarray(self._settings.outlier * np.hypot(scatter, self._bias))

    def _means(self, columns: Array, robust: Array) -> Array:
        """Return the mean over each line (N, k) of columns (N, k)."""
        weight = (self._independent * robust)[:, None]
        total = np.maximum(np.add.reduceat(weight, self._first, axis=0), 1e-9)
        return np.asarray((np.add.reduceat(weight * columns, self._first, axis=0) / total)[self._group])

    def _whitened(self, columns: Array, scatter: float, robust: Array) -> Array:
        """Return columns (N, k) scaled so that points of a line, which share its bias, become independent.

        The inverse root of σ² I + b² 1 1ᵀ over n points is (I − (1 − 1/√(1 + n b²/σ²)) 1 1ᵀ/n)/σ; σ is left to the
        caller.
        """
        count = np.add.reduceat(self._independent * robust, self._first)[self._group]
        share = 1.0 - 1.0 / np.sqrt(1.0 + count * (self._bias / scatter) ** 2)
        return columns - share[:, None] * self._means(columns, robust)

    def _residual(self, pose: Pose, spread: float) -> tuple[Array, Array]:
        """Return distances (N,) px of the lines, spread, from the seen places, and their Jacobian (N, 7)."""
        turned = self._model @ pose.rotation.T
        placed = turned + pose.translation
        inverse = 1.0 / placed[:, 2:]
        ideal = placed[:, :2] * inverse
        lines = self.points.lines
        ends = pose.points(np.stack([lines.start, lines.end]))
        start, end = ends[..., :2] / ends[..., 2:]
        along = (end - start) / np.maximum(np.hypot(*(end - start).T), 1e-12)[:, None]
        normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
        outward = np.sum(normal * lines.outward, axis=1) > 0.0
        normal = np.where(outward[:, None], normal, -normal)[self._line]
        jacobian = np.empty((len(ideal), 7))
        jacobian[:, :2] = self._focal * normal * inverse
        jacobian[:, 2] = -np.sum(jacobian[:, :2] * ideal, axis=1)
        x, y, z = jacobian[:, :3].T
        jacobian[:, 3] = turned[:, 1] * z - turned[:, 2] * y
        jacobian[:, 4] = turned[:, 2] * x - turned[:, 0] * z
        jacobian[:, 5] = turned[:, 0] * y - turned[:, 1] * x
        jacobian[:, 6] = lines.outer[self._line]
        residual = self._focal * np.sum((ideal - self._rays) * normal, axis=1) + spread * jacobian[:, 6]
        return residual, jacobian


def _spread(residual: Array) -> float:
    """Return the robust standard deviation of residuals (N,): their median size, scaled to the normal distribution."""
    middle = len(residual) // 2
    return 1.4826 * float(np.partition(np.abs(residual), middle)[middle])


def _beliefs(pose: Pose, terminal: Terminal, plane: Plane | None) -> list[tuple[Array, Array, Array]]:
    """Return residual, Jacobian (k, 6) and precision (k, k) of what is known apart from edges."""
    axis, t = pose.rotation[:, 2], pose.translation
    # Tilt: the part of the axis across the line of sight.
    sight = t / np.linalg.norm(t)
    across = np.eye(3) - np.outer(sight, sight)
    turning = -cross_matrix(axis)  # of the axis by a small rotation
    slope = np.concatenate([np.zeros((3, 3)), across @ turning], axis=1)
    beliefs = [(across @ axis, slope, np.eye(3) / _TILT**2)]
    if plane is not None:
        distance = float(axis @ t) + terminal.bar_thickness
        change = np.concatenate([axis, t @ turning])
        slope = np.concatenate([np.zeros((3, 3)), turning / distance], axis=1) - np.outer(axis, change) / distance**2
        beliefs.append((axis / distance - plane.coefficients, slope, plane.precision))
    return beliefs
