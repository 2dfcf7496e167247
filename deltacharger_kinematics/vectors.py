# SPDX-License-Identifier: Apache-2.0
"""Products of many 3-vectors, axis first: arrays (3, ...)."""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Array


def dot(a: Array, b: Array) -> Array:
    """Return the scalar products (...)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: Array, b: Array) -> Array:
    """Return the vector products (3, ...)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def determinant(rows: Array) -> Array:
    """Return the determinants (n,) of the matrices whose three rows are rows[:, i, :]."""
    (x0, x1, x2), (y0, y1, y2), (z0, z1, z2) = rows
    return np.asarray(x0 * (y1 * z2 - z1 * y2) + y0 * (z1 * x2 - x1 * z2) + z0 * (x1 * y2 - y1 * x2))
