# SPDX-License-Identifier: Apache-2.0
"""Closed forms of inverse and forward kinematics from books, forums and printer firmware.

Each is written once, over a set of functions: numpy's for arrays, `math`'s for one point. There a division by zero or
the root of a negative number means no answer. All return the knee-out angle θ, measured from radially outward toward
+z; their input is the platform centre along the limb (r), sideways (v) and from the motor plane (w).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_kinematics import DeltaGeometry
from deltacharger_kinematics.geometry import LIMB_DIRECTIONS

Vector = tuple[float, float, float]
_NAN3: Vector = (math.nan, math.nan, math.nan)
# A float or an array of floats; both have the operators used here, but no common type.
Number = Any


# `math`, or numpy's functions under the same names.
Functions = Any
ARRAYS: Functions = SimpleNamespace(
    sqrt=np.sqrt, sin=np.sin, cos=np.cos, atan=np.arctan, atan2=np.arctan2, acos=np.arccos
)

LimbForm = Callable[[Number, Number, Number, DeltaGeometry, Functions], Number]


def tutorial(r: Number, v: Number, w: Number, geometry: DeltaGeometry, m: Functions) -> Number:
    """Intersect the circle of the elbow with a line z = a + b·y; divides by w (tutorial on hobby deltas, 2009)."""
    motor, joint = -geometry.base_radius, -(r + geometry.platform_radius)
    arm, rod = geometry.arm, geometry.rod
    a = (v * v + joint * joint + w * w + arm * arm - rod * rod - motor * motor) / (2.0 * w)
    b = (motor - joint) / w
    discriminant = arm * arm * (b * b + 1.0) - (a + b * motor) * (a + b * motor)
    y = (motor - a * b - m.sqrt(discriminant)) / (b * b + 1.0)
    return m.atan((a + b * y) / (motor - y)) + math.pi * (y > motor)


def firmware(r: Number, v: Number, w: Number, geometry: DeltaGeometry, m: Functions) -> Number:
    """Solve the elbow's scaled x after dividing by the height w (as in Klipper's rotary delta)."""
    x = r - geometry.radius_difference
    inverse = 1.0 / w
    arm2, rod2 = geometry.arm * geometry.arm, geometry.rod * geometry.rod - v * v
    height, slope = 0.5 * inverse * (x * x + w * w + arm2 - rod2), x * inverse
    scale = slope * slope + 1.0
    elbow_x = height * slope + m.sqrt(scale * arm2 - height * height)
    return m.atan2(height * scale - slope * elbow_x, elbow_x)


def cosine_law(r: Number, v: Number, w: Number, geometry: DeltaGeometry, m: Functions) -> Number:
    """Law of cosines: direction of the platform joint minus acos."""
    u, arm = r - geometry.radius_difference, geometry.arm
    reach = u * u + w * w
    k = reach + v * v + arm * arm - geometry.rod * geometry.rod
    return m.atan2(w, u) - m.acos(k / (2.0 * arm * m.sqrt(reach)))


def two_arc_tangents(r: Number, v: Number, w: Number, geometry: DeltaGeometry, m: Functions) -> Number:
    """Direction of the platform joint minus atan2(√Q, K)."""
    u, k, q = _terms(r, v, w, geometry)
    return m.atan2(w, u) - m.atan2(m.sqrt(q), k)


def half_angle(r: Number, v: Number, w: Number, geometry: DeltaGeometry, m: Functions) -> Number:
    """Quadratic in tan(θ/2), after Codourey and the textbooks."""
    u, k, _ = _terms(r, v, w, geometry)
    a, b, c = k + 2.0 * geometry.arm * u, -4.0 * geometry.arm * w, k - 2.0 * geometry.arm * u
    return 2.0 * m.atan((-b - m.sqrt(b * b - 4.0 * a * c)) / (2.0 * a))


def one_arc_tangent(r: Number, v: Number, w: Number, geometry: DeltaGeometry, m: Functions) -> Number:
    """Single atan2(Kw − √Q u, Ku + √Q w) in plain doubles: no division, no branch."""
    u, k, q = _terms(r, v, w, geometry)
    root = m.sqrt(q)
    return m.atan2(k * w - root * u, k * u + root * w)


def _terms(r: Number, v: Number, w: Number, geometry: DeltaGeometry) -> tuple[Number, Number, Number]:
    u, arm = r - geometry.radius_difference, geometry.arm
    reach = u * u + w * w
    k = reach + v * v + arm * arm - geometry.rod * geometry.rod
    return u, k, 4.0 * arm * arm * reach - k * k


INVERSE_FORMS: dict[str, LimbForm] = {
    "tutorial, divides by z": tutorial,
    "Klipper, divides by dy": firmware,
    "law of cosines, acos": cosine_law,
    "two atan2": two_arc_tangents,
    "tan-half quadratic": half_angle,
    "single atan2": one_arc_tangent,
}


def inverse_array(form: LimbForm, geometry: DeltaGeometry, points: Array) -> Array:
    """Return the arm angles (n, 3) of points (n, 3) by one form; NaN for no answer."""
    x, y, z = points.T
    w = z + geometry.z_offset
    angles = np.empty_like(points)
    with np.errstate(all="ignore"):
        for index, (cosine, sine) in enumerate(LIMB_DIRECTIONS):
            angles[:, index] = form(x * cosine + y * sine, y * cosine - x * sine, w, geometry, ARRAYS)
    return angles


def inverse_one(form: LimbForm, geometry: DeltaGeometry, x: float, y: float, z: float) -> Vector:
    """Return the arm angles of one point by one form; NaN for no answer."""
    w = z + geometry.z_offset
    try:
        return (
            form(x, y, w, geometry, math),
            form(x * _C1 + y * _S1, y * _C1 - x * _S1, w, geometry, math),
            form(x * _C1 - y * _S1, y * _C1 + x * _S1, w, geometry, math),
        )
    except (ValueError, ZeroDivisionError):
        return _NAN3


_C1, _S1 = LIMB_DIRECTIONS[1]
Centres = Sequence[tuple[Number, Number, Number]]
SphereForm = Callable[[Centres, float, Functions], tuple[Number, Number, Number]]


def trilateration(centres: Centres, rod: float, m: Functions) -> tuple[Number, Number, Number]:
    """Intersect three spheres in the frame of their centres (as in Klipper and encyclopaedias)."""
    (x0, y0, z0), (x1, y1, z1), (x2, y2, z2) = centres
    ax, ay, az, bx, by, bz = x1 - x0, y1 - y0, z1 - z0, x2 - x0, y2 - y0, z2 - z0
    d = m.sqrt(ax * ax + ay * ay + az * az)
    ex, ey, ez = ax / d, ay / d, az / d
    i = ex * bx + ey * by + ez * bz
    fx, fy, fz = bx - i * ex, by - i * ey, bz - i * ez
    j = m.sqrt(fx * fx + fy * fy + fz * fz)
    fx, fy, fz = fx / j, fy / j, fz / j
    gx, gy, gz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
    p = d / 2.0
    q = ((p - i) * (p - i) + j * j - p * p) / (2.0 * j)
    h = m.sqrt(rod * rod - p * p - q * q)
    return x0 + p * ex + q * fx + h * gx, y0 + p * ey + q * fy + h * gy, z0 + p * ez + q * fz + h * gz


def elimination(centres: Centres, rod: float, m: Functions) -> tuple[Number, Number, Number]:
    """Eliminate x and y, solve a quadratic in z; divides by the elbows' area seen along z (the forum tutorial)."""
    (x0, y0, z0), (x1, y1, z1), (x2, y2, z2) = centres
    area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    w0, w1, w2 = (x * x + y * y + z * z for x, y, z in centres)
    a1 = ((z2 - z0) * (y1 - y0) - (z1 - z0) * (y2 - y0)) / area
    b1 = ((w1 - w0) * (y2 - y0) - (w2 - w0) * (y1 - y0)) / (2.0 * area)
    a2 = ((z1 - z0) * (x2 - x0) - (z2 - z0) * (x1 - x0)) / area
    b2 = ((w2 - w0) * (x1 - x0) - (w1 - w0) * (x2 - x0)) / (2.0 * area)
    a = a1 * a1 + a2 * a2 + 1.0
    b = 2.0 * (a1 * (b1 - x0) + a2 * (b2 - y0) - z0)
    c = (b1 - x0) * (b1 - x0) + (b2 - y0) * (b2 - y0) + z0 * z0 - rod * rod
    z = (m.sqrt(b * b - 4.0 * a * c) - b) / (2.0 * a)
    return a1 * z + b1, a2 * z + b2, z


FORWARD_FORMS: dict[str, SphereForm] = {
    "trilateration (Klipper)": trilateration,
    "quadratic in z (tutorial)": elimination,
}


def _elbow(angle: Number, cosine: float, sine: float, geometry: DeltaGeometry, m: Functions) -> tuple[Number, ...]:
    radius = geometry.radius_difference + geometry.arm * m.cos(angle)
    return radius * cosine, radius * sine, geometry.arm * m.sin(angle)


def _forward(form: SphereForm, geometry: DeltaGeometry, angles: Any, m: Functions) -> tuple[Number, Number, Number]:
    centres: Any = [_elbow(a, c, s, geometry, m) for a, (c, s) in zip(angles, LIMB_DIRECTIONS, strict=True)]
    x, y, z = form(centres, geometry.rod, m)
    return x, y, z - geometry.z_offset


def forward_array(form: SphereForm, geometry: DeltaGeometry, angles: Array) -> Array:
    """Return the positions (n, 3) of arm angles (n, 3) by one form; NaN for no answer."""
    with np.errstate(all="ignore"):
        return np.stack(_forward(form, geometry, angles.T, ARRAYS), axis=-1)


def forward_one(form: SphereForm, geometry: DeltaGeometry, *angles: float) -> Vector:
    """Return the position of three arm angles by one form; NaN for no answer."""
    try:
        return _forward(form, geometry, angles, math)
    except (ValueError, ZeroDivisionError):
        return _NAN3
