# SPDX-License-Identifier: Apache-2.0
"""Estimate of a misalignment: pose, standard deviations, whether it may be used, and the paper's classes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_tactile.dataset import ANGLE_CLASSES, POSITION_CLASSES


@dataclass(frozen=True)
class Limits:
    """When an estimate may be used.

    Attributes:
        pad_force: N, smallest load of a pad that holds its ridge.
        pad_active: smallest number of taxels above the threshold on each pad.
        pad_dead: largest number of dead taxels of a pad.
        angle_stddev: rad, largest standard deviation of a sure estimate.
        across_stddev: m, same. (The horizontal position has no limit: safety does not depend on it.)
    """

    pad_force: float = 3.0
    pad_active: int = 4
    pad_dead: int = 3
    angle_stddev: float = math.radians(0.5)
    across_stddev: float = 0.8e-3


@dataclass(frozen=True)
class Estimate:
    """Pose of the target in end_effector, measured by touch; floats for one frame pair, arrays (...) for a batch.

    NaN = unknown (no contact). Standard deviations are errors against the pose in contact, on rigs unseen in training.

    In one contact, a residual lean along the bars looks like a horizontal offset: 0.01° like 1 mm. `horizontal` counts
    all of it as an offset, and `vertical` follows from `across` and `horizontal`. A lean does not affect `across`.

    Attributes:
        angle: rad about +z, from +x to +y.
        angle_stddev: rad.
        vertical: m along y.
        vertical_stddev: m.
        horizontal: m along x.
        horizontal_stddev: m.
        in_range: both pads hold the ridge, frames look as in training, and the pose is within the limits.
        contact: a live taxel reads 1 N or more.
        sure: in range and precise.
        angle_probability: (..., 6) classes of |angle| 0–5°, the last one open.
        vertical_probability: (..., 5) classes −10…10 mm, both ends open.
        horizontal_probability: (..., 5) classes −10…10 mm, both ends open.
        left_force: N, load of the pad at +x.
        right_force: N, load of the pad at −x.
        across: m, offset across the target's bars: vertical · cos(angle) − horizontal · sin(angle).
        across_stddev: m.
    """

    angle: Any
    angle_stddev: Any
    vertical: Any
    vertical_stddev: Any
    horizontal: Any
    horizontal_stddev: Any
    in_range: Any
    contact: Any
    sure: Any
    angle_probability: Any
    vertical_probability: Any
    horizontal_probability: Any
    left_force: Any
    right_force: Any
    across: Any
    across_stddev: Any


_ROOT = math.sqrt(2.0)
_HALVES = np.append(np.radians(np.arange(ANGLE_CLASSES - 1) + 0.5), np.inf)
_ANGLE_EDGES = np.concatenate([_HALVES, -_HALVES])
_MIDDLES = np.array(POSITION_CLASSES)
_POSITION_EDGES = np.concatenate([[-np.inf], 0.5 * (_MIDDLES[1:] + _MIDDLES[:-1]), [np.inf]])


def angle_classes(angle: Array, stddev: Array) -> Array:
    """Probabilities (N, 6) that |angle| rounds to 0, 1, … 5°; the last class includes larger angles."""
    upper, lower = np.split(_normal((_ANGLE_EDGES - angle[:, None]) / stddev[:, None]), 2, axis=1)
    below = upper - lower
    return np.concatenate([below[:, :1], below[:, 1:] - below[:, :-1]], axis=1)


def position_classes(position: Array, stddev: Array) -> Array:
    """Probabilities (N, 5) of the classes −10, −5, 0, 5, 10 mm; the outer two are open."""
    below = _normal((_POSITION_EDGES - position[:, None]) / stddev[:, None])
    return below[:, 1:] - below[:, :-1]


def _normal(value: Array) -> Array:
    return np.asarray([0.5 * math.erfc(-x / _ROOT) for x in value.ravel().tolist()]).reshape(value.shape)


def shaped(column: NDArray[Any], shape: tuple[int, ...]) -> Any:
    """Return (N, …) values in the input's shape; a single one as a plain number."""
    result = column.reshape((*shape, *column.shape[1:]))
    return result if result.ndim else result.item()
