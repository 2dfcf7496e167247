# SPDX-License-Identifier: Apache-2.0
"""Arithmetic beyond doubles, for points whose result depends on rounding.

Double-double arithmetic: a number as an unevaluated sum (high, low) of two doubles, about 106 bits.
All functions work on floats and numpy arrays. Error-free sums after Knuth, products after Dekker and Veltkamp; relative
error of one operation below 2^-102 (Joldes, Muller and Popescu, "Tight and rigorous error bounds for basic building
blocks of double-word arithmetic", 2017). Operands above 1e300 overflow in the split; the caller must exclude them.

Solves one limb in double-double, for points whose result depends on rounding to double.
Near the edge of reach the angle depends on √Q, and an error ε in Q causes √ε: 1e-8 rad in doubles. Here u, v, w, K and
Q of `deltacharger_kinematics.delta` have about 106 bits. The doubles of position and lengths count as exact, cos and
sin of 120° as −1/2 and ±√3/2. If the sign of Q is still undecided, exact arithmetic decides it.
"""

import math
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_kinematics.geometry import Limb

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


# √Q as a share of u² + v² + w² + a² + L² below which plain doubles are not precise enough. Their error grows with its
# inverse, 1e-15 rad here. In the default workspace the share is at least 0.26.
DOUBTFUL_ROOT = 0.25
HOPELESS = 1e-13  # share of the same sum squared; a more negative Q is negative in any arithmetic
_UNDECIDED = 2.0**-88  # of (u² + v² + w² + a² + L²)²; below it √Q in double-double is not precise to 1e-17 of its scale
_ROOT_THREE = Fraction(math.isqrt(3 << 1200), 1 << 600)
Surd = tuple[Fraction, Fraction]  # p + q√3


def solve_limb(x: Array, y: Array, z: Array, limb: Limb) -> tuple[Array, Array]:
    """Return the commanded angles (n,) rad and Q (n,) m⁴ of one limb at positions x, y, z (n,) m in charger_base.

    The error of an angle is below 4e-16 rad. The sign of Q is exact; if it is negative, the angle is NaN.
    """
    u, w, k, (high, low) = _terms(x, y, z, limb)
    size = k[0] + 2.0 * limb.rod**2
    for index in np.flatnonzero(np.abs(high) < _UNDECIDED * size * size):
        high[index], low[index] = exact_discriminant(float(x[index]), float(y[index]), float(z[index]), limb), 0.0
    plain = np.sqrt(high)
    root = square_root((high, low), np.where(plain > 0.0, plain, 1.0))
    root = np.where(plain > 0.0, root[0], plain), np.where(plain > 0.0, root[1], 0.0)
    sine, cosine = _direction(u, w, k, root)
    # In long double, because numpy's vectorised arc tangent of doubles is precise to 0.76 ulp only.
    angle = np.arctan2(_extended(sine), _extended(cosine)) - limb.angle_offset
    return angle.astype(np.float64), high


def solve_limb_at(x: float, y: float, z: float, limb: Limb) -> tuple[float, float]:
    """Return commanded angle and Q, as `solve_limb`, for one finite position."""
    u, w, k, (high, low) = _terms(x, y, z, limb)
    if abs(high) < _UNDECIDED * (k[0] + 2.0 * limb.rod**2) ** 2:
        high, low = exact_discriminant(x, y, z, limb), 0.0
    if high < 0.0:
        return math.nan, high
    root = square_root((high, low), math.sqrt(high)) if high > 0.0 else (0.0, 0.0)
    sine, cosine = _direction(u, w, k, root)
    rest = (sine[1] * cosine[0] - cosine[1] * sine[0]) / (sine[0] * sine[0] + cosine[0] * cosine[0])
    return math.atan2(sine[0], cosine[0]) + (rest - limb.angle_offset), high


def _extended(number: DoubleDouble) -> NDArray[np.longdouble]:
    return np.asarray(np.asarray(number[0], dtype=np.longdouble) + number[1])


def _terms(
    x: Number, y: Number, z: Number, limb: Limb
) -> tuple[DoubleDouble, DoubleDouble, DoubleDouble, DoubleDouble]:
    """Return u, w, K and Q."""
    along: DoubleDouble = (x, 0.0 * x)
    across: DoubleDouble = (y, 0.0 * y)
    if limb.sine != 0.0:
        sine = HALF_ROOT_THREE if limb.sine > 0.0 else scale(HALF_ROOT_THREE, -1.0)
        turned = add(scale(along, -0.5), multiply(across, sine))
        across = subtract(scale(across, -0.5), multiply(along, sine))
        along = turned
    u = subtract(along, exact_sum(limb.base_radius, -limb.platform_radius, limb.radius_offset))
    v = subtract(across, (limb.tangential_offset, 0.0))
    w = add((z, 0.0 * z), exact_sum(limb.z_offset, -limb.height_offset))
    arm, rod = two_product(limb.arm, limb.arm), two_product(limb.rod, limb.rod)
    reach = add(multiply(u, u), multiply(w, w))
    k = add(add(reach, multiply(v, v)), subtract(arm, rod))
    q = subtract(scale(multiply(arm, reach), 4.0), multiply(k, k))
    return u, w, k, q


def _direction(
    u: DoubleDouble, w: DoubleDouble, k: DoubleDouble, root: DoubleDouble
) -> tuple[DoubleDouble, DoubleDouble]:
    """Return 2a(u² + w²)·(sin θ, cos θ)."""
    return subtract(multiply(k, w), multiply(root, u)), add(multiply(k, u), multiply(root, w))


def exact_discriminant(x: float, y: float, z: float, limb: Limb) -> float:
    """Return Q (m⁴) of the exact values of the doubles, rounded once; 0.0 only if it is exactly zero."""
    px, py, pz = Fraction(x), Fraction(y), Fraction(z)
    cosine, sine = (Fraction(1), Fraction(0)) if limb.sine == 0.0 else (Fraction(-1, 2), Fraction(1, 2))
    if limb.sine < 0.0:
        sine = -sine
    difference = Fraction(limb.base_radius) - Fraction(limb.platform_radius) + Fraction(limb.radius_offset)
    u = (px * cosine - difference, py * sine)
    v = (py * cosine - Fraction(limb.tangential_offset), -px * sine)
    w = pz + Fraction(limb.z_offset) - Fraction(limb.height_offset)
    arm, rod = Fraction(limb.arm) ** 2, Fraction(limb.rod) ** 2
    reach = _add(_square(u), (w * w, Fraction(0)))
    k = _add(_add(reach, _square(v)), (arm - rod, Fraction(0)))
    kk = _square(k)
    p, q = 4 * arm * reach[0] - kk[0], 4 * arm * reach[1] - kk[1]
    return _rounded(p, q)


def _add(a: Surd, b: Surd) -> Surd:
    return a[0] + b[0], a[1] + b[1]


def _square(a: Surd) -> Surd:
    return a[0] * a[0] + 3 * a[1] * a[1], 2 * a[0] * a[1]


def _rounded(p: Fraction, q: Fraction) -> float:
    """Return p + q√3 as a double with the exact sign."""
    if p == 0 and q == 0:
        return 0.0
    # √3 is irrational, so p² = 3q² only for p = q = 0; the comparison decides the sign.
    positive = (p > 0) if p * p > 3 * q * q else (q > 0)
    value = abs(float(p + q * _ROOT_THREE))
    return math.copysign(max(value, 5e-324), 1.0 if positive else -1.0)
