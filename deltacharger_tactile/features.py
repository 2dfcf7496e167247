# SPDX-License-Identifier: Apache-2.0
"""Physical features of two tactile frames: loads, centres, moments, slopes and profiles, in N and mm.

Frames are never divided by their own force: how much each pad carries is the horizontal signal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deltacharger_core.arrays import Array
from deltacharger_core.machine import COLUMNS, ROWS
from deltacharger_tactile.errors import FrameError
from deltacharger_tactile.parameters import PadContactParameters

_PITCH = 1e3 * PadContactParameters().pad_side / ROWS
_BASELINE = 2e3 * PadContactParameters().pad_distance
# Taxel centres in mm: row 0 at +y, column 0 at +x.
_V = _PITCH * (0.5 * (ROWS - 1) - np.arange(ROWS))
_U = _PITCH * (0.5 * (COLUMNS - 1) - np.arange(COLUMNS))
_SMALL = 1e-3
"""Added to loads (N) before dividing, so that an untouched pad gives zeros instead of NaN."""

MIRROR_SIGNS = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
"""Signs of (horizontal, vertical, angle) in each image of `mirrors`."""


def stack(left: ArrayLike, right: ArrayLike) -> Array:
    """Return both pads as (N, 2, 10, 10) float.

    Raises:
        FrameError: a pad is not (..., 10, 10) or the two differ in shape.
    """
    a, b = np.asarray(left, dtype=float), np.asarray(right, dtype=float)
    if a.shape != b.shape or a.shape[-2:] != (ROWS, COLUMNS):
        raise FrameError(a.shape, b.shape)
    return np.stack([a.reshape(-1, ROWS, COLUMNS), b.reshape(-1, ROWS, COLUMNS)], axis=1)


def fill_dead(frames: Array) -> Array:
    """Replace NaN by the mean of the live neighbours; those along the row, as the ridge, count threefold.

    A taxel without a live neighbour becomes 0.
    """
    dead = ~np.isfinite(frames)
    if not dead.any():
        return frames
    rows = np.flatnonzero(dead.any(axis=(1, 2, 3)))
    part = np.where(dead[rows], 0.0, frames[rows])
    live = (~dead[rows]).astype(float)
    weighted, weights = np.zeros_like(part), np.zeros_like(part)
    for axis, step, weight in ((3, 1, 3.0), (3, -1, 3.0), (2, 1, 1.0), (2, -1, 1.0)):
        weighted += weight * _shift(part, axis, step)
        weights += weight * _shift(live, axis, step)
    filled = frames.copy()
    estimate = weighted / np.maximum(weights, 1.0)
    filled[rows] = np.where(dead[rows], estimate, part)
    return filled


def _shift(frames: Array, axis: int, step: int) -> Array:
    result = np.zeros_like(frames)
    source: list[slice] = [slice(None)] * frames.ndim
    target = list(source)
    source[axis], target[axis] = (slice(None, -1), slice(1, None)) if step > 0 else (slice(1, None), slice(None, -1))
    result[tuple(target)] = frames[tuple(source)]
    return result


@dataclass(frozen=True)
class PadFeatures:
    """Features of N frame pairs.

    Attributes:
        values: (N, F) what the estimator sees.
        force: (N, 2) N, load of each pad (+x first).
        active: (N, 2) taxels above the threshold.
    """

    values: Array
    force: Array
    active: Array


def names() -> list[str]:
    """Name every column of `PadFeatures.values`, unit last."""
    per_pad = [
        "force_N",
        "u_mm",
        "v_mm",
        "uu_mm2",
        "uv_mm2",
        "vv_mm2",
        "slope",
        "principal_rad",
        "active",
        "peak_N",
    ]
    per_pad += [f"row{i}_N" for i in range(ROWS)] + [f"column{i}_N" for i in range(COLUMNS)]
    per_pad += [f"centre{i}_mm" for i in range(COLUMNS)]
    across = ["total_N", "log_right_left", "angle_by_centres", "centre_mm"]
    return [f"{side}_{name}" for side in ("left", "right") for name in per_pad] + across


def mirrors(frames: Array) -> Array:
    """Return the four mirror images (4, N, 2, 10, 10) of frames: as is, y mirrored, x mirrored, both.

    Mirroring x swaps the pads. The pose follows with MIRROR_SIGNS: a device and its mirror image are equally
    likely.
    """
    flipped = frames[:, :, ::-1, :]
    return np.stack([frames, flipped, frames[:, ::-1, :, ::-1], flipped[:, ::-1, :, ::-1]])


def extract(frames: Array, threshold: float) -> PadFeatures:
    """Compute the features of tared frames.

    Args:
        frames: (N, 2, 10, 10) N, without NaN (see `fill_dead`).
        threshold: N; readings below it are noise and count as 0.
    """
    felt = np.where(frames >= threshold, frames, 0.0)
    count = len(felt)
    rows, columns = felt.sum(axis=3), felt.sum(axis=2)
    force = rows.sum(axis=2)
    safe = force + _SMALL
    u, v = columns @ _U / safe, rows @ _V / safe
    du, dv = _U - u[..., None], _V - v[..., None]
    uu = np.sum(columns * du * du, axis=2) / safe
    vv = np.sum(rows * dv * dv, axis=2) / safe
    centre = np.einsum("npij,i->npj", felt, _V)
    uv = np.sum(centre * du, axis=2) / safe
    per_column = centre / (columns + _SMALL)
    slope = uv / (uu + 0.5)
    active = np.count_nonzero(felt, axis=(2, 3)).astype(float)
    principal = 0.5 * np.arctan2(2.0 * uv, uu - vv + 1e-9)
    peak = felt.max(axis=(2, 3))
    single = np.stack([force, u, v, uu, uv, vv, slope, principal, active, peak], axis=2)
    per_pad = np.concatenate([single, rows, columns, per_column], axis=2).reshape(count, -1)
    lever = _BASELINE + u[:, 0] - u[:, 1]
    across = np.stack(
        [
            force.sum(axis=1),
            np.log((force[:, 1] + 0.5) / (force[:, 0] + 0.5)),
            np.arctan((v[:, 0] - v[:, 1]) / lever),
            0.5 * (v[:, 0] + v[:, 1]),
        ],
        axis=1,
    )
    return PadFeatures(np.concatenate([per_pad, across], axis=1), force, active)
