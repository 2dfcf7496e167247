# SPDX-License-Identifier: Apache-2.0
"""Double-double arithmetic: a number as an unevaluated sum (high, low) of two doubles, about 106 bits.

All functions work on floats and numpy arrays. Error-free sums after Knuth, products after Dekker and Veltkamp; relative
error of one operation below 2^-102 (Joldes, Muller and Popescu, "Tight and rigorous error bounds for basic building
blocks of double-word arithmetic", 2017). Operands above 1e300 overflow in the split; the caller must exclude them.
"""

from __future__ import annotations

import math
from typing import Any

# A float or an array of floats; they have no common type for the operators used here.
Number = Any
DoubleDouble = tuple[Number, Number]

_SPLITTER = 134217729.0  # 2^27 + 1


def two_sum(a: Number, b: Number) -> DoubleDouble:
    """Return a + b exactly."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def two_product(a: Number, b: Number) -> DoubleDouble:
    """Return a·b exactly, except for underflow."""
    product = a * b
    wide = _SPLITTER * a
    a_high = wide - (wide - a)
    a_low = a - a_high
    wide = _SPLITTER * b
    b_high = wide - (wide - b)
    b_low = b - b_high
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


def _renormalise(high: Number, low: Number) -> DoubleDouble:
    total = high + low
    return total, low - (total - high)


def add(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    """Return a + b, accurate even under cancellation."""
    high, error = two_sum(a[0], b[0])
    low, rest = two_sum(a[1], b[1])
    high, error = _renormalise(high, error + low)
    return _renormalise(high, error + rest)


def subtract(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    """Return a − b."""
    return add(a, (-b[0], -b[1]))


def multiply(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    """Return a·b."""
    high, low = two_product(a[0], b[0])
    return _renormalise(high, low + (a[0] * b[1] + a[1] * b[0]))


def scale(a: DoubleDouble, factor: float) -> DoubleDouble:
    """Return a·factor for a factor that is a power of two."""
    return a[0] * factor, a[1] * factor


def square_root(a: DoubleDouble, root: Number) -> DoubleDouble:
    """Return √a from `root`, the square root of its high part, by one Newton step; both must be positive."""
    high, low = two_product(root, root)
    return _renormalise(root, ((a[0] - high) - low + a[1]) / (2.0 * root))


def exact_sum(*terms: float) -> DoubleDouble:
    """Return the sum of plain numbers."""
    total: DoubleDouble = (0.0, 0.0)
    for term in terms:
        total = add(total, (term, 0.0))
    return total


HALF_ROOT_THREE: DoubleDouble = (math.sqrt(3.0) / 2.0, 5.0175421109034514e-17)
