# SPDX-License-Identifier: Apache-2.0
"""Physical features of two tactile frames: loads, centres, moments, slopes and profiles, in N and mm.

Frames are not normalised by force: the load of each pad is the signal of the horizontal offset.
"""

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_core import arrays, machine
from deltacharger_tactile import errors, parameters

_PITCH = 1e3 * parameters.PadContactParameters().pad_side / machine.ROWS
_BASELINE = 2e3 * parameters.PadContactParameters().pad_distance
# Taxel centres in mm: row 0 at +y, column 0 at +x.
_V = _PITCH * (0.5 * (machine.ROWS - 1) - np.arange(machine.ROWS))
_U = _PITCH * (0.5 * (machine.COLUMNS - 1) - np.arange(machine.COLUMNS))
# Neighbours of a taxel in frames with a margin of one: rows down, columns right, weight.
_DOWN, _RIGHT, _WEIGHT = np.array([[1, 1, 0, 2], [0, 2, 1, 1], [3, 3, 1, 1]])[:, :, None]
_SMALL = 1e-3
"""Added to loads (N) before dividing, so that an untouched pad gives 0 instead of NaN."""

MIRROR_SIGNS = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
"""Signs of (horizontal, vertical, angle) in each image of `mirrored`."""


def stack(left: ArrayLike, right: ArrayLike) -> arrays.Array:
    """Return both pads as (N, 2, 10, 10) float.

    Raises:
        FrameError: a pad is not (..., 10, 10), or the shapes differ.
    """
    a, b = np.asarray(left, dtype=float), np.asarray(right, dtype=float)
    if a.shape != b.shape or a.shape[-2:] != (machine.ROWS, machine.COLUMNS):
        raise errors.FrameError(a.shape, b.shape)
    return np.stack(
        [a.reshape(-1, machine.ROWS, machine.COLUMNS), b.reshape(-1, machine.ROWS, machine.COLUMNS)], axis=1
    )


def fill_dead(frames: arrays.Array) -> arrays.Array:
    """Replace NaN by the mean of the live neighbours; those along the row, like the ridge, have threefold weight.

    A taxel without a live neighbour becomes 0.
    """
    dead = ~np.isfinite(frames)
    if not dead.any():
        return frames
    frame, pad, row, column = np.nonzero(dead)
    around = np.full(
        (*frames.shape[:2], machine.ROWS + 2, machine.COLUMNS + 2), np.nan
    )  # with a margin: each has four neighbours
    around[:, :, 1:-1, 1:-1] = np.where(dead, np.nan, frames)
    neighbours = around[frame, pad, row + _DOWN, column + _RIGHT]
    live = np.isfinite(neighbours)
    weights = (live * _WEIGHT).sum(axis=0)
    filled = frames.copy()
    filled[dead] = np.where(live, neighbours * _WEIGHT, 0.0).sum(axis=0) / np.maximum(weights, 1.0)
    return filled


@dataclass(frozen=True)
class PadFeatures:
    """Features of N frame pairs.

    Attributes:
        values: (N, F) inputs of the estimator.
        force: (N, 2) N, load of each pad (+x first).
        active: (N, 2) taxels above the threshold.
    """

    values: arrays.Array
    force: arrays.Array
    active: arrays.Array


def names() -> list[str]:
    """Return the name of every column of `PadFeatures.values`, ending in its unit."""
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
    per_pad += [f"row{i}_N" for i in range(machine.ROWS)] + [f"column{i}_N" for i in range(machine.COLUMNS)]
    per_pad += [f"centre{i}_mm" for i in range(machine.COLUMNS)]
    across = ["total_N", "log_right_left", "angle_by_centres", "centre_mm"]
    return [f"{side}_{name}" for side in ("left", "right") for name in per_pad] + across


def mirrored(values: arrays.Array) -> arrays.Array:
    """Return the features (4, N, F) of four mirror images: unchanged, y mirrored, x mirrored, both.

    Mirroring x swaps the pads. MIRROR_SIGNS mirrors the pose: a device and its mirror image are equally likely.
    An image has the features of the frame, reordered and with other signs.
    """
    return values[:, _COLUMNS].swapaxes(0, 1) * _SIGNS


def extract(frames: arrays.Array, threshold: float) -> PadFeatures:
    """Compute the features of tared frames.

    Args:
        frames: (N, 2, 10, 10) N, without NaN (see `fill_dead`).
        threshold: N; lower readings are noise and count as 0.
    """
    seen = np.where(frames >= threshold, frames, 0.0)
    count = len(seen)
    rows, columns = seen.sum(axis=3), seen.sum(axis=2)
    force = rows.sum(axis=2)
    safe = force + _SMALL
    u, v = columns @ _U / safe, rows @ _V / safe
    du, dv = _U - u[..., None], _V - v[..., None]
    uu = np.sum(columns * du * du, axis=2) / safe
    vv = np.sum(rows * dv * dv, axis=2) / safe
    centre = np.einsum("npij,i->npj", seen, _V)
    uv = np.sum(centre * du, axis=2) / safe
    per_column = centre / (columns + _SMALL)
    slope = uv / (uu + 0.5)
    active = np.count_nonzero(seen, axis=(2, 3)).astype(float)
    principal = 0.5 * np.arctan2(2.0 * uv, uu - vv + 1e-9)
    peak = seen.max(axis=(2, 3))
    values = np.empty((count, len(_NAMES)))
    pads = values[:, : machine.PADS * _PER_PAD].reshape(count, machine.PADS, _PER_PAD)  # a view
    for index, feature in enumerate((force, u, v, uu, uv, vv, slope, principal, active, peak)):
        pads[:, :, index] = feature
    for index, profile in enumerate((rows, columns, per_column)):
        first = _SINGLE + index * machine.COLUMNS
        pads[:, :, first : first + machine.COLUMNS] = profile
    lever = _BASELINE + u[:, 0] - u[:, 1]
    values[:, -4] = force.sum(axis=1)
    values[:, -3] = np.log((force[:, 1] + 0.5) / (force[:, 0] + 0.5))
    values[:, -2] = np.arctan((v[:, 0] - v[:, 1]) / lever)
    values[:, -1] = 0.5 * (v[:, 0] + v[:, 1])
    return PadFeatures(values, force, active)


_ODD = {  # features whose sign changes if y is mirrored, and if x is
    "u_mm": (False, True),
    "v_mm": (True, False),
    "uv_mm2": (True, True),
    "slope": (True, True),
    "principal_rad": (True, True),
    "centre": (True, False),
    "log_right_left": (False, True),
    "angle_by_centres": (True, True),
    "centre_mm": (True, False),
}


def _image_of(name: str, over_y: bool, over_x: bool) -> tuple[str, float]:
    """Return the frame's feature that corresponds to `name` in an image, and its sign."""
    side, _, what = name.partition("_")
    pads = {"left": "right", "right": "left"}
    if side not in pads:
        side, what = "", name
    row_or_column = re.fullmatch(r"(row|column|centre)(\d)_(.*)", what)
    odd_y, odd_x = _ODD.get(row_or_column[1] if row_or_column else what, (False, False))
    if row_or_column and (over_y if row_or_column[1] == "row" else over_x):
        what = f"{row_or_column[1]}{9 - int(row_or_column[2])}_{row_or_column[3]}"
    source = f"{pads[side] if over_x else side}_{what}" if side else what
    return source, -1.0 if (over_y and odd_y) != (over_x and odd_x) else 1.0


def _images() -> tuple[NDArray[np.int64], arrays.Array]:
    """Return (4, F) the frame's feature for each of an image, and (4, 1, F) its sign."""
    order = {name: index for index, name in enumerate(names())}
    images = ((False, False), (True, False), (False, True), (True, True))
    sources = [[_image_of(name, *over) for name in order] for over in images]
    columns = [[order[name] for name, _ in image] for image in sources]
    return np.array(columns), np.array([[[sign for _, sign in image]] for image in sources])


_NAMES = names()
_SINGLE, _PER_PAD = 10, (len(_NAMES) - 4) // machine.PADS
_COLUMNS, _SIGNS = _images()
