# SPDX-License-Identifier: Apache-2.0
"""Quaternions as messages and parameters give them: x, y, z, w; and how far the rotation that they make leans."""

from __future__ import annotations

import math

Matrix = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


def rotation(x: float, y: float, z: float, w: float) -> Matrix:
    """Return the rows (3, 3) of the rotation that a quaternion of any length makes; NaN for one of length zero."""
    length = math.hypot(x, y, z, w) or math.nan
    x, y, z, w = x / length, y / length, z / length, w / length
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )


def lean(rows: Matrix) -> tuple[float, float]:
    """Return yaw and pitch (rad) of a frame whose axes are the columns of `rows` (3, 3).

    How its z axis is turned about +y and about +x; the roll about z is no part of it.
    """
    x, y, z = (row[2] for row in rows)
    return math.atan2(x, z), math.atan2(-y, z)
