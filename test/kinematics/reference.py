# SPDX-License-Identifier: Apache-2.0
"""Inverse kinematics in 60 digits, the reference of every precision test."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpmath import mp, mpf

from deltacharger_kinematics import KNEE_OUT, DeltaGeometry, LimbAdjustment

mp.dps = 60
CALIBRATED = DeltaGeometry(
    limbs=(
        LimbAdjustment(0.0004, -0.0003, 0.0002, 0.1003, 0.1796, 0.012),
        LimbAdjustment(-0.0002, 0.0005, -0.0004, 0.0998, None, -0.009),
        LimbAdjustment(arm=0.1001, rod=0.1802),
    )
)
DIRECTIONS = ((mpf(1), mpf(0)), (mpf(-1) / 2, mp.sqrt(3) / 2), (mpf(-1) / 2, -mp.sqrt(3) / 2))
Real = float | mpf


def limb_terms(point: Sequence[Real], geometry: DeltaGeometry, index: int) -> tuple[mpf, mpf, mpf, mpf]:
    """Return u, w, K and Q of the exact values of the doubles."""
    limb = geometry.limb(index)
    x, y, z = (mpf(value) for value in point)
    cosine, sine = DIRECTIONS[index]
    difference = mpf(limb.base_radius) - mpf(limb.platform_radius) + mpf(limb.radius_offset)
    u = x * cosine + y * sine - difference
    v = y * cosine - x * sine - mpf(limb.tangential_offset)
    w = z + mpf(limb.z_offset) - mpf(limb.height_offset)
    arm, rod = mpf(limb.arm), mpf(limb.rod)
    k = u * u + v * v + w * w + arm * arm - rod * rod
    return u, w, k, 4 * arm * arm * (u * u + w * w) - k * k


def discriminants(point: Sequence[Real], geometry: DeltaGeometry) -> list[mpf]:
    return [limb_terms(point, geometry, index)[3] for index in range(3)]


def angles(
    point: Sequence[Real], geometry: DeltaGeometry, working_mode: tuple[int, int, int] = KNEE_OUT
) -> list[mpf | None]:
    """Return the arm angles; None if the limb does not reach the point."""
    found: list[mpf | None] = []
    for index, knee in enumerate(working_mode):
        u, w, k, q = limb_terms(point, geometry, index)
        if q < 0:
            found.append(None)
            continue
        root = knee * mp.sqrt(q)
        found.append(mp.atan2(k * w + root * u, k * u - root * w) - mpf(geometry.limb(index).angle_offset))
    return found


def worst_error(given: np.ndarray, points: np.ndarray, geometry: DeltaGeometry) -> float:
    """Return the largest error (rad) of `given` angles (n, 3); infinite if reachability is wrong."""
    worst = 0.0
    for row, point in zip(given, points, strict=True):
        for angle, true in zip(row, angles([float(value) for value in point], geometry), strict=True):
            if np.isnan(angle) != (true is None):
                return float("inf")
            if true is not None:
                worst = max(worst, float(abs(mpf(float(angle)) - true)))
    return worst


def edge_of_reach(start: Sequence[float], direction: Sequence[float], geometry: DeltaGeometry) -> mpf:
    """Return the distance from `start` along `direction` at which the first limb loses its reach, to 1e-24 m."""
    low, high = mpf(0), mpf(1)
    for _ in range(80):
        middle = (low + high) / 2
        inside = min(discriminants(along(start, direction, middle), geometry)) >= 0
        low, high = (middle, high) if inside else (low, middle)
    return low


def along(start: Sequence[float], direction: Sequence[float], distance: mpf) -> list[mpf]:
    return [mpf(s) + distance * mpf(d) for s, d in zip(start, direction, strict=True)]
