# SPDX-License-Identifier: Apache-2.0
"""What an image shows of a terminal: the visible lines of its bars, their edges, and its plate's plane by depth.

A bar rises above its plate, so at a slant it shows a side beside its touched face. If that side is wide enough, its
root on the plate is a separate line. If it is too narrow for two lines, the edge lies somewhere between them and has
less weight.

The plane of the dark plate around the bars, from depth: linear least squares on inverse depth.
Noise of a stereo camera is uniform in disparity, that is in inverse depth. A plane's inverse depth is linear in the
ray: q·(x/z, y/z, 1) with q = n/D. Metal is excluded: stereo sees reflections there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_vision.images import DEPTH_BIAS, Intrinsics, project, rays
from deltacharger_vision.terminal import Terminal, TerminalPose

_OUTWARD = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
_FLAT = 0.7
"""A narrower side is invisible, px."""
_APART = 3.0
"""A wider side shows two edges, px."""
_MERGED = 0.3
"""Standard deviation of a narrow side's merged edge, in widths of the side."""
_DRAWN = 0.5
"""Standard deviation of an edge whose neighbour is just far enough to separate them, px."""
_BARS = np.repeat([0, 1], 4)
_SIDES = np.tile([0, 1, 2, 3], 2)


@dataclass(frozen=True)
class Lines:
    """L line segments in the terminal's frame that may appear as edges.

    Attributes:
        start: (L, 3) m.
        end: (L, 3) m.
        pixels: (L, 2, 2) px, both ends in the image.
        outward: (L, 2) unit normal in the image, away from the bar.
        bar: (L,) 0 at −y, 1 at +y.
        side: (L,) 0 at −y, 1 at +x, 2 at +y, 3 at −x of the bar.
        outer: (L,) the outermost line of its side: bright inside, dark outside.
        room: (L,) px to the next line of the same side, inf if there is none.
        bias: (L,) px, standard deviation of the shift of an entire edge.
    """

    start: Array
    end: Array
    pixels: Array
    outward: Array
    bar: NDArray[np.int64]
    side: NDArray[np.int64]
    outer: Mask
    room: Array
    bias: Array


def visible_lines(pose: TerminalPose, terminal: Terminal, intrinsics: Intrinsics, bias: float) -> Lines:
    """Return the lines of the touched faces, and of the roots of visible sides."""
    corners = terminal.corners()
    start, end = corners.reshape(8, 3), np.roll(corners, -1, axis=1).reshape(8, 3)
    camera = -pose.rotation.T @ pose.translation
    depth = np.array([0.0, 0.0, terminal.bar_thickness])
    middle = 0.5 * (start + end)
    seen = np.sum((camera - middle) * _OUTWARD[_SIDES], axis=1) > 0.0
    pixels = project(pose.points(np.stack([start, end], axis=1)), intrinsics)
    roots = project(pose.points(np.stack([start, end], axis=1) + depth), intrinsics)
    normal = _normals(pixels, pose, intrinsics, middle)
    width = np.where(seen, np.abs(np.sum((roots - pixels).mean(axis=1) * normal, axis=1)), 0.0)
    two = width >= _APART
    merged = (width > _FLAT) & ~two
    shift = np.where(merged, 0.5, 0.0)
    pixels = pixels + shift[:, None, None] * (roots - pixels)
    front = shift[:, None] * depth
    rows = np.flatnonzero(two)
    # The blur of one edge still affects the other.
    near = _DRAWN * np.maximum(1.0 - (width - _APART) / _APART, 0.0)
    return Lines(
        np.concatenate([start + front, start[rows] + depth]),
        np.concatenate([end + front, end[rows] + depth]),
        np.concatenate([pixels, roots[rows]]),
        np.concatenate([normal, normal[rows]]),
        np.concatenate([_BARS, _BARS[rows]]),
        np.concatenate([_SIDES, _SIDES[rows]]),
        np.concatenate([~two, np.ones(len(rows), dtype=bool)]),
        np.concatenate([np.where(two, width, np.inf), width[rows]]),
        np.hypot(bias, np.concatenate([np.where(two, 0.0, _MERGED * width), near[rows]])),
    )


def _normals(pixels: Array, pose: TerminalPose, intrinsics: Intrinsics, middle: Array) -> Array:
    """Return unit normals (L, 2) of segments (L, 2, 2) px, away from the bar."""
    along = pixels[:, 1] - pixels[:, 0]
    along = along / np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)[:, None]
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    # Project the middle itself: with lens distortion, the middle of both ends is beside the line.
    at, beyond = project(pose.points(np.stack([middle, middle + 1e-4 * _OUTWARD[_SIDES]])), intrinsics)
    return np.where(np.sum((beyond - at) * normal, axis=1)[:, None] < 0.0, -normal, normal)


EDGE_SEARCH = 5.0  # px, first search distance on either side of a line's expected position
EDGE_FOLLOW = 2.5  # px, search distance once the pose has been refined
_CONTRAST = 1.0  # least step of light within a pixel, of 255
_SHARE = 0.3  # least step as a share of the median step

SAMPLES = 24
"""Places per line."""
_STEP = 0.5
_REACH = 3  # steps on either side of the steepest place that enter its centroid
_CORNER = 1.5  # px near a corner that another edge disturbs
_PULL = 0.3  # of the peak
_SATURATED = 250.0  # of 255
_SHARP = 2.5  # px: width of an edge's ramp (step over steepest slope) in a sharp image
_INDEPENDENT = 2.0  # px between samples of an edge that share little noise


@dataclass(frozen=True)
class EdgePoints:
    """Edge points of L lines, SAMPLES per line.

    Attributes:
        lines: the lines.
        model: (L, S, 3) m, in the terminal's frame.
        rays: (L, S, 2) x/z, y/z of the edge.
        seen: (L, S) whether the edge was found.
        weight: (L,) independent samples per sample.
        missed: independent samples of the bars' sides without an edge in the image.
        saturated: share of places where the bar beside the edge is saturated.
        blur: (L,) px, excess width of the line's ramp over a sharp image.
    """

    lines: Lines
    model: Array
    rays: Array
    seen: Mask
    weight: Array
    missed: float
    saturated: float
    blur: Array


def find_edges(grey: NDArray[Any], lines: Lines, intrinsics: Intrinsics, window: float) -> EdgePoints:
    """Return the steepest places within `window` px of each line in a grey image (H, W) float32."""
    import cv2

    length = np.hypot(*(lines.pixels[:, 1] - lines.pixels[:, 0]).T)
    trim = np.minimum(0.3, _CORNER / np.maximum(length, 1e-6))[:, None]
    place = trim + (1.0 - 2.0 * trim) * np.linspace(0.0, 1.0, SAMPLES)
    centre = lines.pixels[:, None, 0] + place[..., None] * (lines.pixels[:, None, 1] - lines.pixels[:, None, 0])
    model = lines.start[:, None] + place[..., None] * (lines.end[:, None] - lines.start[:, None])
    steps = round(window / _STEP)
    offsets: Array = np.asarray(_STEP * np.arange(-steps - 1, steps + 2), dtype=np.float64)
    sampled = centre[:, :, None] + offsets[:, None] * lines.outward[:, None, None]
    flat = sampled.reshape(len(centre), -1, 2).astype(np.float32)
    profile = cv2.remap(grey, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = np.asarray(profile, dtype=float).reshape(sampled.shape[:3])
    change = (values[..., :-2] - values[..., 2:]) / (2.0 * _STEP)
    fall = np.where(lines.outer[:, None, None], np.maximum(change, 0.0), np.abs(change))
    offsets = offsets[1:-1]
    # A side's two lines are each searched on their own side of the middle between them.
    beyond = np.where(lines.outer[:, None], -offsets, offsets)
    offset, height, ramp = _steepest(fall, offsets, beyond <= 0.5 * lines.room[:, None])
    enough = max(_CONTRAST, _SHARE * float(np.median(height[lines.outer])))
    bounds = np.array(grey.shape[::-1], dtype=float) - 1.0
    inside = np.all((centre > 0.0) & (centre < bounds), axis=2)
    found = rays(np.clip(centre + offset[..., None] * lines.outward[:, None], 0.0, bounds), intrinsics)
    weight = np.minimum(1.0, length / (_INDEPENDENT * SAMPLES))
    seen = inside & (height >= enough)
    missed = _leave_inner(seen, inside, weight, lines)
    blur = np.maximum(np.median(np.where(seen, ramp, 0.0), axis=1) - _SHARP, 0.0)
    # Sampled well inside the bar.
    saturated = float(np.mean(values[lines.outer, :, : steps // 2].max(axis=2) >= _SATURATED))
    return EdgePoints(lines, model, found, seen, weight, missed, saturated, blur)


def _leave_inner(seen: Mask, inside: Mask, weight: Array, lines: Lines) -> float:
    """Drop inner edges whose outer edge was found, because streaks and blur pass for inner edges.

    Returns:
        Independent samples of the sides without either edge.
    """
    missed = 0.0
    for outer in np.flatnonzero(lines.outer):
        found = seen[outer]
        inner = np.flatnonzero((lines.bar == lines.bar[outer]) & (lines.side == lines.side[outer]) & ~lines.outer)
        if len(inner) and np.mean(found) > 0.5:
            seen[inner] = False
        elif len(inner):
            found = found | seen[inner[0]]
        missed += float(weight[outer] * np.count_nonzero(inside[outer] & ~found))
    return missed


def _steepest(fall: Array, offsets: Array, allowed: Mask) -> tuple[Array, Array, Array]:
    """Return the offset (L, S) px of the steepest place of profiles (L, S, K), its slope, and the ramp's width.

    Only allowed offsets (L, K) count. The slope is 0 if the steepest place is not a peak of the profile. The width is
    that of a straight ramp of the same height and slope, px.
    """
    near = fall * allowed[:, None]
    peak = np.argmax(near, axis=2)[..., None]
    last = fall.shape[2] - 1
    height = np.take_along_axis(near, peak, axis=2)[..., 0]
    inner = ((peak >= 2) & (peak <= last - 2))[..., 0]
    for step in (-1, 1):
        inner &= np.take_along_axis(fall, np.clip(peak + step, 0, last), axis=2)[..., 0] <= height
    reach = np.clip(peak + np.arange(-_REACH, _REACH + 1), 0, last)
    # Only the excess over part of the peak counts, so that a neighbouring edge does not pull.
    strong = np.maximum(np.take_along_axis(near, reach, axis=2) - _PULL * height[..., None], 0.0)
    offset = np.sum(strong * offsets[reach], axis=2) / np.maximum(strong.sum(axis=2), 1e-9)
    ramp = _STEP * near.sum(axis=2) / np.maximum(height, 1e-9)
    return offset, np.where(inner, height, 0.0), ramp


_BESIDE = 0.006  # m, width of the examined plate beyond the bars' ends
_ABOVE = 0.020  # m, width of the examined plate above and below the bars
_METAL = 0.004  # m, excluded width around the bars
_SHADOW = 3.0  # px, excluded width in the image: stereo smears depth
_MOST = 3000  # most depth samples used
FEWEST_DEPTHS = 60  # least samples for a plane
KNOWN_SHARE = 0.25  # share of the region's depth that must be known
_INLIERS = 0.65  # share of the known depth that must lie on the plane
_TOLERANCE = 0.05  # 1/m, largest deviation of inverse depth from the plane
_NOISE = 0.0035  # 1/m, least standard deviation of inverse depth: its steps are 1/8 px
_DEPTH_STEP = 0.001  # m, steps of depth: millimetres, as in 16UC1
_SHIFT = 0.001  # 1/m, standard deviation of a shift of all inverse depths: 0.03 px
_SLOPE = 0.002  # 1/m, standard deviation of their tilt, per unit ray: 0.03 px over a plate

_TRIALS, _THIN, _CONCENTRATED = 40, 500, 3  # planes tried, samples that test them, repetitions of their fit
_ROUNDS = 6
_NEAR, _MEDIAN = 2.0, 0.639  # standard deviations within which the scatter is measured, and their median size there
_BLOCK = 8  # samples on a side, over which correlated noise is measured
_USUAL = 0.055  # of the samples within _NEAR standard deviations lie within twice as many
_BLOCKS = 12  # needed for a scatter of their means
_TUKEY = 3.5
_NOISY = 0.05  # relative scatter of inverse depth within a block
_HIDDEN, _CROSSED = 0.4, 1.2  # of a step across the plate; steps


@dataclass(frozen=True)
class Plane:
    """A plane in the optical frame.

    Attributes:
        coefficients: (3,) 1/m: unit normal (away from the camera) over distance from the camera.
        precision: (3, 3) inverse covariance of the coefficients.
        scatter: 1/m, standard deviation of inverse depth.
        bias: standard deviation of the relative error of all depth, which `precision` leaves out.
    """

    coefficients: Array
    precision: Array
    scatter: float
    bias: float = 0.0

    def with_bias(self) -> Plane:
        """Return the plane with the bias in its precision: all depth off by a share, which changes over the image."""
        q = self.coefficients
        spread = np.outer(q, q) + q[2] ** 2 * np.diag([1.0, 1.0, 0.0])
        covariance = np.linalg.inv(self.precision) + self.bias**2 * spread
        return replace(self, precision=np.linalg.inv(covariance), bias=0.0)


@dataclass(frozen=True)
class Region:
    """Depth where the plate should be.

    Attributes:
        rays: (N, 3) rays with z = 1.
        inverse: (N,) 1/m.
        block: (N,) number of each sample's block of the image.
        share: of the region with known depth.
    """

    rays: Array
    inverse: Array
    block: NDArray[np.int64]
    share: float


def plate_region(
    depth: NDArray[Any],
    pose: TerminalPose,
    terminal: Terminal,
    intrinsics: Intrinsics,
    dark: Mask | None = None,
) -> Region:
    """Return the known depth (H, W) m around the bars of a terminal at `pose`, where the image is `dark` (H, W)."""
    half = np.array([0.5 * terminal.bar_length, terminal.bar_height + 0.5 * terminal.gap])
    clear = max(_METAL, _SHADOW * pose.translation[2] / intrinsics.fx)
    reach = half + clear + [_BESIDE, _ABOVE]
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    corners = pose.points(np.column_stack([signs * reach, np.full(4, terminal.bar_thickness)]))
    pixels = project(corners, intrinsics)
    height, width = depth.shape
    low = np.clip(np.floor(pixels.min(axis=0)), 0, [width, height]).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)) + 1, 0, [width, height]).astype(int)
    size = np.maximum(high - low, 0)
    stride = max(1, int(np.ceil(np.sqrt(size[0] * size[1] / _MOST))))
    grid = np.meshgrid(np.arange(low[0], high[0], stride), np.arange(low[1], high[1], stride))
    columns, rows = (part.ravel() for part in grid)
    ray = np.ones((len(columns), 3))
    ray[:, :2] = rays(np.stack([columns, rows], axis=1).astype(float), intrinsics)
    axis = pose.rotation[:, 2]
    distance = axis @ pose.translation + terminal.bar_thickness
    place = (ray * (distance / (ray @ axis))[:, None] - pose.translation) @ pose.rotation
    metal = np.abs(place[:, :2]) < half + clear
    plate = np.all(np.abs(place[:, :2]) < reach, axis=1) & ~metal.all(axis=1)
    columns, rows, ray = columns[plate], rows[plate], ray[plate]
    values = depth[rows, columns].astype(float)
    known = np.isfinite(values) & (values > 0.0)
    if dark is not None:
        known &= dark[rows, columns]
    block = (rows // (stride * _BLOCK)) * 100_000 + columns // (stride * _BLOCK)
    share = float(known.mean()) if len(known) else 0.0
    return Region(ray[known], 1.0 / values[known], block[known].astype(np.int64), share)


def fit_plane(region: Region, random: np.random.Generator) -> Plane | None:
    """Return the plane that two thirds of the region's depth lie on, or None if there is none."""
    count = len(region.inverse)
    if count < FEWEST_DEPTHS or region.share < KNOWN_SHARE:
        return None
    coefficients = _consensus(region, random)
    if coefficients is None:
        return None
    # With rounded depth, most samples may lie on one step; a scatter smaller than rounding would fit that step alone.
    rounded = _DEPTH_STEP / math.sqrt(12.0) * float(np.median(region.inverse)) ** 2
    least = math.hypot(_NOISE, rounded)
    # The neighbouring step must stay in, too.
    narrowest = math.sqrt(12.0) / _NEAR * rounded
    block = np.unique(region.block, return_inverse=True)[1]
    residual = region.inverse - region.rays @ coefficients
    scatter, weight = max(least, 1.4826 * float(np.median(np.abs(residual)))), np.ones(count)
    for _ in range(_ROUNDS):
        # Objects in front of the plate would widen the scatter if they counted, and thus be accepted.
        near = np.abs(residual) < min(_TOLERANCE, _NEAR * max(scatter, 1.1 * narrowest))
        if np.count_nonzero(near) < 0.5 * FEWEST_DEPTHS:
            return None
        scatter = max(least, float(np.median(np.abs(residual[near]))) / _MEDIAN)
        weight = _tukey(residual / max(scatter, narrowest)) * _in_line(block, residual, near, rounded)
        normal = (region.rays * weight[:, None]).T @ region.rays
        coefficients = np.asarray(
            np.linalg.solve(normal + 1e-9 * np.eye(3), region.rays.T @ (weight * region.inverse)), dtype=np.float64
        )
        residual = region.inverse - region.rays @ coefficients
    # Checked last: a few samples agree better with their nearer half than with the plane.
    if np.count_nonzero(near) < max(FEWEST_DEPTHS, _INLIERS * count):
        return None
    normal = (region.rays * weight[:, None]).T @ region.rays
    covariance = scatter**2 * _correlation(region, residual, weight > 0.0) * np.linalg.inv(normal + 1e-9 * np.eye(3))
    covariance *= _doubt(residual / max(scatter, narrowest))
    covariance += np.diag([_SLOPE, _SLOPE, _SHIFT]) ** 2
    covariance[:2, :2] += np.diag(_stairs(region, coefficients, math.sqrt(12.0) * rounded)) ** 2
    return Plane(coefficients, np.linalg.inv(covariance), scatter, DEPTH_BIAS)


def is_noise(region: Region) -> bool:
    """Return whether depth scatters as widely within the blocks of the image as no surface does."""
    _, block = np.unique(region.block, return_inverse=True)
    size = np.maximum(np.bincount(block), 1)
    mean = np.bincount(block, weights=region.inverse) / size
    scatter = np.sqrt(np.bincount(block, weights=(region.inverse - mean[block]) ** 2) / size) / mean
    return bool(float(np.median(scatter)) > _NOISY)


def _consensus(region: Region, random: np.random.Generator) -> Array | None:
    """Return the plane closest to its nearer half of the samples (fast least trimmed squares).

    Rousseeuw, Van Driessen, "Computing LTS regression for large data sets", DMKD 12 (2006): refitting a plane through
    three samples to its nearest half never makes it worse.
    """
    picks = random.integers(0, len(region.inverse), size=(_TRIALS, 3))
    triples = region.rays[picks]
    usable = np.abs(np.linalg.det(triples)) > 1e-6
    if not usable.any():
        return None
    planes = np.linalg.solve(triples[usable], region.inverse[picks[usable]][..., None])[..., 0]
    stride = max(1, len(region.rays) // _THIN)
    thin, inverse = region.rays[::stride], region.inverse[::stride]
    half = len(thin) // 2
    for _ in range(_CONCENTRATED):
        near = np.argpartition(np.abs(inverse - planes @ thin.T), half, axis=1)[:, :half]
        ray, seen = thin[near], inverse[near]
        normal = np.swapaxes(ray, 1, 2) @ ray + 1e-9 * np.eye(3)
        planes = np.linalg.solve(normal, np.swapaxes(ray, 1, 2) @ seen[..., None])[..., 0]
    off = np.partition(np.abs(inverse - planes @ thin.T), half, axis=1)[:, :half]
    return np.asarray(planes[np.argmin(np.sum(off**2, axis=1))])


def _tukey(residual: Array) -> Array:
    """Return weights of residuals in standard deviations, 0 from _TUKEY on."""
    return np.asarray(np.maximum(1.0 - (residual / _TUKEY) ** 2, 0.0) ** 2)


def _in_line(block: NDArray[np.int64], residual: Array, near: Mask, least: float) -> Array:
    """Return the weights of samples by the mean of their block, with a scatter of at least `least` (1/m).

    A strap or cable on the plate is within the noise of one sample, but far outside the noise of a block.
    """
    size = np.bincount(block, weights=near)
    mean = np.bincount(block, weights=residual * near) / np.maximum(size, 1.0)
    full = size >= 0.5 * size.max()
    scatter = max(least, 1.4826 * float(np.median(np.abs(mean[full]))))
    return _tukey(mean / max(scatter, 1e-9))[block] if full.sum() >= _BLOCKS else np.ones(len(residual))


def _doubt(residual: Array) -> float:
    """Return the factor (≥ 1) on a plane's covariance, by the number of residuals (in standard deviations) far out.

    A plane through two things, such as a plate and a hand in front of it, has more small deviations than chance.
    """
    size = np.abs(residual)
    within, twice = (int(np.count_nonzero(size < width)) for width in (_NEAR, 2.0 * _NEAR))
    return max(1.0, (twice - within) / max(1, within) / _USUAL) ** 2


def _stairs(region: Region, coefficients: Array, step: float) -> Array:
    """Return (2,) 1/m: uncertainty of the slope by rounding, for a plane that crosses few steps (1/m) of inverse depth.

    Within one step the slope is invisible; over several, their edges show it. Fitted to random planes.
    """
    crossed = float(np.ptp(region.rays @ coefficients)) / max(step, 1e-12)
    width = np.maximum(np.ptp(region.rays[:, :2], axis=0), 1e-6)
    return np.asarray(_HIDDEN * step / width / math.hypot(1.0, (crossed / _CROSSED) ** 2))


def _correlation(region: Region, residual: Array, good: Mask) -> float:
    """Return the reduction of independent samples: the variance of block means over its value without correlation."""
    _, block = np.unique(region.block[good], return_inverse=True)
    size = np.bincount(block).astype(float)
    mean = np.bincount(block, weights=residual[good]) / size
    full = size >= 0.5 * size.max()
    variance = float(np.mean(residual[good] ** 2))
    if variance <= 0.0:
        return 1.0
    # The plane itself takes three degrees of freedom from few block means.
    means = float(np.sum(mean[full] ** 2 * size[full])) / max(1, int(full.sum()) - 3)
    return float(np.clip(means / variance, 1.0, size.max()))
