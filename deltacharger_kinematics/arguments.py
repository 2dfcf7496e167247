# SPDX-License-Identifier: Apache-2.0
"""Converts arguments to arrays of doubles, and refuses anything else with the argument's name."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_kinematics.geometry import Vector

_DOUBLE = np.dtype(np.float64)


def as_point(value: Any) -> Vector | None:
    """Return the three floats of a single point without numpy's cost; None = use `as_vectors`."""
    kind = type(value)
    if kind is np.ndarray:
        return tuple(value.tolist()) if value.shape == (3,) and value.dtype is _DOUBLE else None
    if (kind is tuple or kind is list) and len(value) == 3:
        x, y, z = value
        return (x, y, z) if type(x) is type(y) is type(z) is float else None
    return None


def as_vectors(value: Any, name: str) -> Array:
    """Return `value` as float64 (..., 3).

    Raises:
        ValueError: names the argument; the values are no numbers or ragged, or the last axis is not 3.
    """
    try:
        array = np.asarray(np.ma.filled(value.astype(float), np.nan) if np.ma.isMaskedArray(value) else value)
    except ValueError as error:
        raise ValueError(f"{name}: rows of different lengths; give numbers (..., 3)") from error
    if array.dtype.kind not in "fiu" or array.dtype.itemsize > 8:
        array = _converted(array, name)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"{name}: shape {array.shape}; give numbers (..., 3)")
    return array.astype(np.float64, copy=False)


def _converted(array: NDArray[np.generic], name: str) -> Array:
    if array.dtype.kind not in "fO" or (array.dtype.kind == "O" and not _all_numbers(array)):
        raise ValueError(f"{name}: {array.dtype} is not a supported number type; give floats (..., 3)")
    try:
        with np.errstate(over="ignore"):
            return array.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name}: {error}; give floats (..., 3)") from error


def _all_numbers(array: NDArray[np.generic]) -> bool:
    return all(isinstance(item, int | float | np.integer | np.floating) for item in array.flat)


def broadcast(first: Array, second: Array, name: str) -> tuple[Array, Array]:
    """Return both arrays with their common shape.

    Raises:
        ValueError: names the second argument; the shapes do not match.
    """
    try:
        shape = np.broadcast_shapes(first.shape, second.shape)
    except ValueError as error:
        raise ValueError(f"{name}: shape {second.shape} does not fit {first.shape} of position") from error
    return np.broadcast_to(first, shape), np.broadcast_to(second, shape)
