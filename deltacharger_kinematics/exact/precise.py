# SPDX-License-Identifier: Apache-2.0
"""Solves one limb in double-double, for points whose result depends on rounding to double.

Near the edge of reach the angle depends on √Q, and an error ε in Q causes √ε: 1e-8 rad in doubles. Here u, v, w, K and
Q of `deltacharger_kinematics.delta` have about 106 bits. The doubles of position and lengths count as exact, cos and
sin of 120° as −1/2 and ±√3/2. If the sign of Q is still undecided, exact arithmetic decides it.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_kinematics.exact import double_double as dd
from deltacharger_kinematics.exact.double_double import DoubleDouble, Number
from deltacharger_kinematics.geometry import Limb

# √Q as a share of u² + v² + w² + a² + L² below which plain doubles are not precise enough. Their error grows with its
# inverse, 1e-15 rad here. In the default workspace the share is at least 0.26.
DOUBTFUL_ROOT = 0.25
HOPELESS = 1e-13  # share of the same sum squared; a more negative Q is negative in any arithmetic
_UNDECIDED = 2.0**-88  # of (u² + v² + w² + a² + L²)²; below it √Q in double-double is not precise to 1e-17 of its scale
_ROOT_THREE = Fraction(math.isqrt(3 << 1200), 1 << 600)
Surd = tuple[Fraction, Fraction]  # p + q√3


def solve_limb(x: Array, y: Array, z: Array, limb: Limb, knee: int) -> tuple[Array, Array]:
    """Return the commanded angles (n,) rad and Q (n,) m⁴ of one limb at positions x, y, z (n,) m in charger_base.

    The error of an angle is below 4e-16 rad. The sign of Q is exact; if it is negative, the angle is NaN.
    """
    u, w, k, (high, low) = _terms(x, y, z, limb)
    size = k[0] + 2.0 * limb.rod**2
    for index in np.flatnonzero(np.abs(high) < _UNDECIDED * size * size):
        high[index], low[index] = exact_discriminant(float(x[index]), float(y[index]), float(z[index]), limb), 0.0
    plain = np.sqrt(high)
    root = dd.square_root((high, low), np.where(plain > 0.0, plain, 1.0))
    root = np.where(plain > 0.0, root[0], plain), np.where(plain > 0.0, root[1], 0.0)
    sine, cosine = _direction(u, w, k, root, knee)
    # In long double, because numpy's vectorised arc tangent of doubles is precise to 0.76 ulp only.
    angle = np.arctan2(_extended(sine), _extended(cosine)) - limb.angle_offset
    return angle.astype(np.float64), high


def solve_limb_at(x: float, y: float, z: float, limb: Limb, knee: int) -> tuple[float, float]:
    """Return commanded angle and Q, as `solve_limb`, for one finite position."""
    u, w, k, (high, low) = _terms(x, y, z, limb)
    if abs(high) < _UNDECIDED * (k[0] + 2.0 * limb.rod**2) ** 2:
        high, low = exact_discriminant(x, y, z, limb), 0.0
    if high < 0.0:
        return math.nan, high
    root = dd.square_root((high, low), math.sqrt(high)) if high > 0.0 else (0.0, 0.0)
    sine, cosine = _direction(u, w, k, root, knee)
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
        sine = dd.HALF_ROOT_THREE if limb.sine > 0.0 else dd.scale(dd.HALF_ROOT_THREE, -1.0)
        turned = dd.add(dd.scale(along, -0.5), dd.multiply(across, sine))
        across = dd.subtract(dd.scale(across, -0.5), dd.multiply(along, sine))
        along = turned
    u = dd.subtract(along, dd.exact_sum(limb.base_radius, -limb.platform_radius, limb.radius_offset))
    v = dd.subtract(across, (limb.tangential_offset, 0.0))
    w = dd.add((z, 0.0 * z), dd.exact_sum(limb.z_offset, -limb.height_offset))
    arm, rod = dd.two_product(limb.arm, limb.arm), dd.two_product(limb.rod, limb.rod)
    reach = dd.add(dd.multiply(u, u), dd.multiply(w, w))
    k = dd.add(dd.add(reach, dd.multiply(v, v)), dd.subtract(arm, rod))
    q = dd.subtract(dd.scale(dd.multiply(arm, reach), 4.0), dd.multiply(k, k))
    return u, w, k, q


def _direction(
    u: DoubleDouble, w: DoubleDouble, k: DoubleDouble, root: DoubleDouble, knee: int
) -> tuple[DoubleDouble, DoubleDouble]:
    """Return 2a(u² + w²)·(sin θ, cos θ)."""
    turn = dd.scale(root, float(knee))
    return (
        dd.add(dd.multiply(k, w), dd.multiply(turn, u)),
        dd.subtract(dd.multiply(k, u), dd.multiply(turn, w)),
    )


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
