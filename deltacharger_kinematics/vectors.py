"""Products of many 3-vectors held axis first: arrays (3, ...)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def dot(a: Array, b: Array) -> Array:
    """Return the scalar products (...)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: Array, b: Array) -> Array:
    """Return the vector products (3, ...)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def determinant(rows: Array) -> Array:
    """Return the determinants (n,) of the matrices whose three rows are rows[:, i, :]."""
    return dot(rows[:, 0], cross(rows[:, 1], rows[:, 2]))
