# SPDX-License-Identifier: Apache-2.0
"""The plane of the dark plate around the bars, from depth: linear least squares on inverse depth.

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
from deltacharger_vision.images import Intrinsics, project, rays
from deltacharger_vision.terminal import Terminal, TerminalPose

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
_STEP = 0.001  # m, steps of depth: millimetres, as in 16UC1
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


def fit_plane(region: Region, bias: float, random: np.random.Generator) -> Plane | None:
    """Return the plane that two thirds of the region's depth lie on, or None if there is none."""
    count = len(region.inverse)
    if count < FEWEST_DEPTHS or region.share < KNOWN_SHARE:
        return None
    coefficients = _consensus(region, random)
    if coefficients is None:
        return None
    # With rounded depth, most samples may lie on one step; a scatter smaller than rounding would fit that step alone.
    rounded = _STEP / math.sqrt(12.0) * float(np.median(region.inverse)) ** 2
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
    return Plane(coefficients, np.linalg.inv(covariance), scatter, bias)


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
