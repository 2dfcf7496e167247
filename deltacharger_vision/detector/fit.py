# SPDX-License-Identifier: Apache-2.0
"""Poses of a terminal: rough ones to start from, and the least-squares fit to edges and depth.

Initial poses that match a terminal's silhouette to a pair of blobs.
A blob covers all bright parts of a bar: its touched face and visible sides. The face's corners alone would put the
terminal too near and to the side. For a given tilt, the silhouette of the complete bar is laid over the blob.

The pose that fits edges, and a plate's plane if known: robust nonlinear least squares.
Edges: distance of each edge point from its projected line (Drummond, Cipolla, "Real-time visual tracking of complex
structures", PAMI 24 (2002)). Plane: for a stereo camera, the inverse depth of a plane n·X = D is linear in the ray,
q·ray with q = n/D.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from deltacharger_core.arrays import Array, Mask
from deltacharger_vision.detector import blobs, observed
from deltacharger_vision.images import Intrinsics, project, rays
from deltacharger_vision.terminal import Terminal, TerminalPose, cross_matrix, facing

_SIGNS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
Leans = tuple[tuple[float, float], ...]
SMALL_LEANS: Leans = ((0.0, 0.08), (0.0, -0.08), (0.08, 0.0), (-0.08, 0.0))
LARGE_LEANS: Leans = ((0.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.4, 0.3), (0.4, -0.3), (-0.4, 0.3), (-0.4, -0.3))
"""Tangents of the lean across and along the bars."""
_ROUNDS = 3
_SAME, _SAME_PX = 0.05, 3.0  # of the length, px: a pair is as long as the bars


def by_corners(pair: blobs.Pair, terminal: Terminal, intrinsics: Intrinsics) -> list[TerminalPose]:
    """Return the one or two poses that match the faces' corners to the outlines, the better first.

    Collins, Bartoli, "Infinitesimal plane-based pose estimation", IJCV 109 (2014).
    """
    import cv2

    corners = pair.centre[:, None] + _SIGNS[:, :1] * pair.along[:, None] + _SIGNS[:, 1:] * pair.across[:, None]
    ideal = rays(corners.reshape(-1, 1, 2), intrinsics)
    model = terminal.corners().reshape(-1, 1, 3)
    try:
        found, vectors, translations, _ = cv2.solvePnPGeneric(model, ideal, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error:  # no plane in front of a camera shows these corners
        return []
    poses = []
    for vector, translation in zip(vectors[:found], translations[:found], strict=True):
        rotation, _ = cv2.Rodrigues(np.asarray(vector, dtype=float))
        pose = TerminalPose(np.asarray(rotation, dtype=float), np.asarray(translation, dtype=float).ravel())
        if np.all(np.isfinite(pose.rotation)) and pose.translation[2] > 0.0 and facing(pose) > 0.0:
            poses.append(pose)
    return poses


def mirrored(pose: TerminalPose) -> TerminalPose:
    """Return the pose with its tilt mirrored at the line of sight, which looks almost equal from afar."""
    sight = pose.translation / np.linalg.norm(pose.translation)
    half_turn = 2.0 * np.outer(sight, sight) - np.eye(3)
    return TerminalPose(half_turn @ pose.rotation @ np.diag([-1.0, -1.0, 1.0]), pose.translation)


def ends_swapped(pose: TerminalPose, terminal: Terminal) -> list[TerminalPose]:
    """Return poses whose bars end where the side at their visible end ends in `pose`, and the reverse.

    At a slant, the end of a touched face is easily taken for the side's root on the plate. Either way the bars have
    another length in the image, and so another range and place.
    """
    camera = -pose.rotation.T @ pose.translation
    beyond = abs(camera[0]) - 0.5 * terminal.bar_length
    if beyond <= 0.0:
        return []
    # Where the root's ray crosses the plane of the touched faces, m past their end.
    past = beyond * terminal.bar_thickness / (terminal.bar_thickness - camera[2])
    found = []
    for shift in (-past, past):
        aside = np.array([0.5 * np.sign(camera[0]) * shift, 0.0, 0.0])
        place = (pose.translation + pose.rotation @ aside) * terminal.bar_length / (terminal.bar_length + shift)
        found.append(TerminalPose(pose.rotation, place))
    return found


def leaning(pose: TerminalPose, leans: Leans, pair: blobs.Pair, intrinsics: Intrinsics) -> list[TerminalPose]:
    """Return the pose leaning across and along the bars by these tangents; large leans start from a frontal view."""
    axis = pose.translation if leans is LARGE_LEANS else pose.rotation[:, 2]
    along, across, upright = tilted(pose, axis, pair, intrinsics).rotation.T
    return [tilted(pose, upright + a * across + b * along, pair, intrinsics) for a, b in leans]


def tilted(pose: TerminalPose, axis: Array, pair: blobs.Pair, intrinsics: Intrinsics) -> TerminalPose:
    """Return the pose with its z axis turned to the direction `axis` (3,), and its x axis along the pair's bars."""
    axis = axis / np.linalg.norm(axis)
    middle, along = pair.centre.mean(axis=0), pair.along.mean(axis=0)
    ends = np.ones((2, 3))
    ends[:, :2] = rays(np.stack([middle - along, middle + along]), intrinsics)
    # The bars lie in the plane of both ends' rays, perpendicular to the axis.
    bars = np.cross(np.cross(ends[0], ends[1]), axis)
    bars = bars / max(float(np.linalg.norm(bars)), 1e-9)
    if bars @ (ends[1] - ends[0]) < 0.0:
        bars = -bars
    return TerminalPose(np.stack([bars, np.cross(axis, bars), axis], axis=1), pose.translation)


def laid_over(
    pose: TerminalPose, pair: blobs.Pair, terminal: Terminal, intrinsics: Intrinsics, sides: bool
) -> TerminalPose:
    """Return the pose translated until the bars lie over a pair's blobs.

    Args:
        pose: with the tilt and a rough position.
        pair: the blobs.
        terminal: size of the bars.
        intrinsics: of the camera.
        sides: whether the blobs include the bars' sides, which may be bright or dark.
    """
    face = terminal.corners()
    whole = np.concatenate([face, face + np.array([0.0, 0.0, terminal.bar_thickness if sides else 0.0])], axis=1)
    along = pair.along.sum(axis=0)
    along = along / np.linalg.norm(along)
    across = np.array([-along[1], along[0]])
    frame = np.stack([along, across])
    seen = np.array([np.hypot(*pair.along.T).sum(), float((pair.centre[1] - pair.centre[0]) @ across)])
    middle = pair.centre.mean(axis=0)
    for _ in range(_ROUNDS):
        placed = project(pose.points(whole), intrinsics) @ frame.T
        low, high = placed.min(axis=1), placed.max(axis=1)
        centre = 0.5 * (low + high)
        shown = np.array([(high - low)[:, 0].mean(), centre[1, 1] - centre[0, 1]])
        scale = float(shown @ seen) / float(seen @ seen)
        now = rays(centre.mean(axis=0) @ frame, intrinsics)
        shift = np.append(rays(middle, intrinsics) - now, 0.0) * pose.translation[2]
        pose = TerminalPose(pose.rotation, np.asarray((pose.translation + shift) * min(max(scale, 0.5), 2.0)))
    return pose


def by_spacing(pair: blobs.Pair, terminal: Terminal, intrinsics: Intrinsics) -> TerminalPose:
    """Return the frontal pose of a terminal whose bars have the distance of a pair's lines."""
    middle = pair.centre.mean(axis=0)
    spacing = float(np.hypot(*(pair.centre[1] - pair.centre[0])))
    place = np.append(rays(middle, intrinsics), 1.0) * terminal.spacing * intrinsics.fy / max(spacing, 1e-6)
    return tilted(TerminalPose(np.eye(3), place), place, pair, intrinsics)


def on_plane(
    pose: TerminalPose, coefficients: Array, pair: blobs.Pair, terminal: Terminal, intrinsics: Intrinsics
) -> list[TerminalPose]:
    """Return poses on the plate's plane q·X = 1 whose bars end where a cut pair ends, at one end or the other.

    A single pose if the pair has the bars' length.
    """
    turned = tilted(pose, coefficients, pair, intrinsics)
    along = pair.along[0] / np.hypot(*pair.along[0])
    half = float(np.hypot(*pair.along[0]))
    middle = pair.centre.mean(axis=0)
    face = terminal.corners()
    whole = np.concatenate([face, face + np.array([0.0, 0.0, terminal.bar_thickness])], axis=1)

    def placed(pixel: Array) -> TerminalPose:
        ray = np.append(rays(pixel, intrinsics), 1.0)
        ahead = (1.0 - terminal.bar_thickness * float(np.linalg.norm(coefficients))) / float(coefficients @ ray)
        return TerminalPose(turned.rotation, ray * ahead)

    ends = (project(placed(middle).points(whole), intrinsics) - middle) @ along
    low, high = -half - float(ends.min(axis=1).mean()), half - float(ends.max(axis=1).mean())
    if abs(high - low) <= max(_SAME * 2.0 * half, _SAME_PX):
        return [placed(middle + 0.5 * (low + high) * along)]
    return [placed(middle + low * along), placed(middle + high * along)]


EDGE_BIAS = 0.07  # px, standard deviation of the shift of an entire edge (blur, glare, machining)
_BLURRED = 0.1  # additional standard deviation per px of blur
EDGE_NOISE = 0.12  # px, least standard deviation of one edge point
_SPREAD = 0.05  # px, standard deviation of the spread of light over every edge
_GLARE = 0.5  # px, additional spread per saturated share of the bars
_OUTLIER = 4.7  # standard deviations beyond which a point has no weight (Tukey)

ROUNDS = 10
"""Most steps of a fit."""
_ENOUGH = 1e-2  # squared length of a step in standard deviations
_LARGEST = 0.3  # rad per step
_FEWEST = 24  # edge points
_TILT = 0.7  # rad: weak prior for a frontal view, which keeps the tilt finite


@dataclass(frozen=True)
class PoseFit:
    """A pose and how well it fits.

    Attributes:
        pose: the pose.
        covariance: (6, 6) of position (m) and rotation about the optical axes (rad).
        used: (L, S) edge points that agree with the pose.
        scatter: px, robust standard deviation of the edge points.
        spread: px, apparent enlargement of the bars on every side, as bright metal shows.
        residual: (N,) px, distances of the lines from the N edge points.
    """

    pose: TerminalPose
    covariance: Array
    used: Mask
    scatter: float
    spread: float
    residual: Array


class Edges:
    """Edge points for fitting a terminal's pose.

    Args:
        points: the edge points.
        terminal: size of the bars.
        focal: px, of an ideal camera with the rays of the points.
    """

    def __init__(self, points: observed.EdgePoints, terminal: Terminal, focal: float) -> None:
        self.points = points
        self._terminal = terminal
        self._focal = focal
        self._line, self._place = np.nonzero(points.seen)
        self._model = points.model[points.seen].T
        self._rays = points.rays[points.seen].T
        self._ends = np.concatenate([points.lines.start, points.lines.end]).T
        self._outer = points.lines.outer[self._line].astype(float)
        bias = points.lines.bias[self._line]
        self._bias = np.hypot(bias, _BLURRED * points.blur[self._line])
        # The pull of a narrow side's other line varies along the edge, so such points have little weight each.
        drawn = np.maximum(bias**2 - EDGE_BIAS**2, 0.0)
        self._independent = points.weight[self._line] / (1.0 + drawn / EDGE_NOISE**2)
        _, self._first, self._group = np.unique(self._line, return_index=True, return_inverse=True)
        self._spread = _SPREAD + _GLARE * points.saturated

    def without_ends(self, ends: Mask) -> Edges:
        """Return the edges without the ends (2, 2) of each bar, at +x and at −x, that are False."""
        lines = self.points.lines
        hidden = (lines.side == 1) & ~ends[lines.bar, 0] | (lines.side == 3) & ~ends[lines.bar, 1]
        points = replace(self.points, seen=self.points.seen & ~hidden[:, None])
        return Edges(points, self._terminal, self._focal)

    def fit(self, start: TerminalPose, plane: observed.Plane | None = None, rounds: int = ROUNDS) -> PoseFit | None:
        """Return the pose near `start` that fits edges and plane; None if they do not determine it.

        Args:
            start: initial pose.
            plane: plane of the plate.
            rounds: most steps.
        """
        if len(self._line) < _FEWEST:
            return None
        pose, spread, covariance = start, 0.0, np.eye(7)
        columns = self._linear(pose, spread)
        scatter, robust = self._trust(columns[-1], np.ones(len(self._line)), 2.0)
        for round_ in range(rounds):
            white = self._whitened(columns, scatter, robust)
            product = (white * (self._independent * robust / scatter**2)) @ white.T
            information, gradient = product[:7, :7], product[:7, 7]
            information[6, 6] += 1.0 / self._spread**2
            gradient[6] += spread / self._spread**2
            for off, slope, precision in _beliefs(pose, self._terminal, plane):
                information[:6, :6] += slope.T @ precision @ slope
                gradient[:6] += slope.T @ precision @ off
            try:
                covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
            except np.linalg.LinAlgError:  # the edges determine nothing
                return None
            step = -covariance @ gradient
            step *= min(1.0, _LARGEST / max(float(np.abs(step[3:6]).max()), 1e-12))
            pose = pose.moved(step[:6])
            spread += float(step[6])
            if not np.all(np.isfinite(step)) or pose.translation[2] <= 0.01 or facing(pose) <= 0.2:
                return None
            columns = self._linear(pose, spread)
            # Outliers are tolerated at first, while the start is still rough.
            scatter, robust = self._trust(columns[-1], robust, 2.0 if round_ == 0 else 1.0)
            if round_ > 0 and -float(step @ gradient) < _ENOUGH:
                break
        used = np.zeros(self.points.seen.shape, dtype=bool)
        used[self._line, self._place] = robust > 0.0
        # Scaled by the edges' own bias: otherwise merged ends alone would look like a failed fit.
        scatter = max(scatter, _spread(columns[-1] * EDGE_NOISE / np.hypot(EDGE_NOISE, self._bias)))
        return PoseFit(pose, covariance[:6, :6], used, scatter, spread, columns[-1])

    def misfit(self, found: PoseFit, scatter: float, plane: observed.Plane | None = None, missed: bool = True) -> float:
        """Return the robust sum of squares of a fit to these edges, in standard deviations of this scatter (px).

        With `missed`, places without an edge count as outliers, so that explanations by other lines are comparable.
        """
        residual = found.residual
        limit = _OUTLIER**2 / 3.0
        near = (np.abs(residual) < self._tolerance(scatter)).astype(float)
        white = self._whitened(residual[None], scatter, near)[0]
        within = np.where(near > 0.0, np.minimum((white / (_OUTLIER * scatter)) ** 2, 1.0), 1.0)
        squares = limit * (missed * self.points.missed + float(np.sum(self._independent * (1.0 - (1.0 - within) ** 3))))
        squares += (found.spread / self._spread) ** 2
        for off, _, precision in _beliefs(found.pose, self._terminal, plane):
            squares += float(off @ precision @ off)
        return squares

    def _trust(self, residual: Array, robust: Array, width: float) -> tuple[float, Array]:
        """Return the scatter (px) of residuals (N,) about each line's mean, and Tukey's weights (N,)."""
        mean = self._means(residual[None], robust)[0]
        scatter = max(EDGE_NOISE, _spread(residual - mean))
        whole = max(scatter, _spread(residual))
        return scatter, np.maximum(1.0 - (residual / (width * self._tolerance(whole))) ** 2, 0.0) ** 2

    def _tolerance(self, scatter: float) -> Array:
        return np.asarray(_OUTLIER * np.hypot(scatter, self._bias))

    def _means(self, rows: Array, robust: Array) -> Array:
        """Return the mean over each line (k, N) of rows (k, N)."""
        weight = self._independent * robust
        total = np.maximum(np.add.reduceat(weight, self._first), 1e-9)
        return np.asarray((np.add.reduceat(weight * rows, self._first, axis=1) / total)[:, self._group])

    def _whitened(self, rows: Array, scatter: float, robust: Array) -> Array:
        """Return rows (k, N) scaled so that points of a line, which share its bias, become independent.

        The inverse root of σ² I + b² 1 1ᵀ over n points is (I − (1 − 1/√(1 + n b²/σ²)) 1 1ᵀ/n)/σ. The caller divides
        by σ.
        """
        count = np.add.reduceat(self._independent * robust, self._first)[self._group]
        share = 1.0 - 1.0 / np.sqrt(1.0 + count * (self._bias / scatter) ** 2)
        return rows - share * self._means(rows, robust)

    def _linear(self, pose: TerminalPose, spread: float) -> Array:
        """Return (8, N): the Jacobian's seven columns and the distances (px) of the lines from the edge points.

        Args:
            pose: of the terminal.
            spread: of the lines, px.
        """
        turned = pose.rotation @ self._model
        inverse = 1.0 / (turned[2] + pose.translation[2])
        ideal = (turned[:2] + pose.translation[:2, None]) * inverse
        nx, ny = self._focal * self._normals(pose)[:, self._line]
        rows = np.empty((8, len(self._line)))
        rows[0], rows[1] = nx * inverse, ny * inverse
        rows[2] = -(rows[0] * ideal[0] + rows[1] * ideal[1])
        rows[3] = turned[1] * rows[2] - turned[2] * rows[1]
        rows[4] = turned[2] * rows[0] - turned[0] * rows[2]
        rows[5] = turned[0] * rows[1] - turned[1] * rows[0]
        rows[6] = self._outer
        rows[7] = nx * (ideal[0] - self._rays[0]) + ny * (ideal[1] - self._rays[1]) + spread * self._outer
        return rows

    def _normals(self, pose: TerminalPose) -> Array:
        """Return (2, L) unit normals of the lines in an ideal camera, away from the bars."""
        ends = pose.rotation @ self._ends + pose.translation[:, None]
        seen = ends[:2] / ends[2]
        count = seen.shape[1] // 2
        x, y = seen[:, count:] - seen[:, :count]
        outward = self.points.lines.outward
        flipped = np.where(y * outward[:, 0] - x * outward[:, 1] > 0.0, 1.0, -1.0)
        return np.asarray(np.stack([y, -x]) * (flipped / np.maximum(np.hypot(x, y), 1e-12)))


def _spread(residual: Array) -> float:
    """Return the robust standard deviation of residuals (N,): their median size, scaled to the normal distribution."""
    middle = len(residual) // 2
    return 1.4826 * float(np.partition(np.abs(residual), middle)[middle])


def _beliefs(pose: TerminalPose, terminal: Terminal, plane: observed.Plane | None) -> list[tuple[Array, Array, Array]]:
    """Return residual, Jacobian (k, 6) and precision (k, k) of other knowledge than edges."""
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
