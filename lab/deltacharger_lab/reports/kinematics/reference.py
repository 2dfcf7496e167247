# SPDX-License-Identifier: Apache-2.0
"""Kinematics of the delta in 60-digit arithmetic: the reference of the report.

The doubles of a position, of the angles and of the geometry count as exact, cos and sin of 120° as −1/2 and ±√3/2. Edge
of reach: the elbow turns on a circle, and the limb reaches a platform joint whose distance to that circle's nearest
point is at most the rod and to its farthest point at least the rod. Both differences are distances in m, so a
point's distance inside or outside reach is exact, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_kinematics import DeltaGeometry

DIGITS = 60
_TWO_PI = (6.283185307179586, 2.4492935982947064e-16)  # 2π as the sum of two doubles


@dataclass(frozen=True)
class Exact:
    """Numbers (..., 3) rounded to the sum of two doubles, about 32 digits."""

    high: Array
    low: Array

    def angle_error(self, angles: Array) -> Array:
        """Return |angles − exact| (..., 3) rad in the shorter direction; NaN if either has no answer."""
        with np.errstate(invalid="ignore"):
            rest = (angles - self.high) - self.low
            turns = np.round(rest / _TWO_PI[0])
            return np.asarray(np.abs((rest - turns * _TWO_PI[0]) - turns * _TWO_PI[1]), dtype=np.float64)

    def distance(self, positions: Array) -> Array:
        """Return the distance (...) m of positions (..., 3) m to the exact ones; NaN if either has no answer."""
        rest = (positions - self.high) - self.low
        return np.asarray(np.sqrt((rest * rest).sum(-1)), dtype=np.float64)


class ExactInverse(NamedTuple):
    """Arm angles (n, 3) rad with knees outward, and of each limb's other knee; NaN out of reach."""

    angles: Exact
    other: Exact


class ExactDelta:
    """The delta of one geometry, knees outward, to 60 digits.

    Args:
        geometry: dimensions, adjustments of the limbs included; None = the defaults.
        ahead: whether the platform is ahead of the elbows; False = the mirror image.

    Raises:
        ImportError: mpmath is missing.
    """

    def __init__(self, geometry: DeltaGeometry | None = None, ahead: bool = True) -> None:
        import mpmath

        self._mp = mpmath.MPContext()  # a separate context: others use the global one
        self._mp.dps = DIGITS
        self.geometry = geometry or DeltaGeometry()
        self._side = 1 if ahead else -1
        real = self._mp.mpf
        root = self._mp.sqrt(3) / 2
        self._directions = ((real(1), real(0)), (real(-1) / 2, root), (real(-1) / 2, -root))
        self._limbs = [self._limb(index) for index in range(3)]

    def inverse(self, points: Array) -> ExactInverse:
        """Return the arm angles for points (n, 3) m."""
        found = np.full((4, len(points), 3), np.nan)
        for row, point in enumerate(points.tolist()):
            for index in range(3):
                solved = self._solve(index, point)
                if solved is not None:
                    found[:, row, index] = solved
        return ExactInverse(Exact(found[0], found[1]), Exact(found[2], found[3]))

    def edge(self, points: Array) -> Array:
        """Return the distance (n, 3) m inside reach of points (n, 3) m for each limb; negative outside."""
        return np.array([[float(self._edge(index, point)) for index in range(3)] for point in points.tolist()])

    def forward(self, angles: Array) -> Exact:
        """Return the positions (n, 3) m of arm angles (n, 3) rad; NaN if the rods do not meet."""
        found = np.full((2, len(angles), 3), np.nan)
        for row, arms in enumerate(angles.tolist()):
            position = self._assemble(arms)
            if position is not None:
                found[:, row] = np.array([self._split(value) for value in position]).T
        return Exact(found[0], found[1])

    def _limb(self, index: int) -> dict[str, Any]:
        real = self._mp.mpf
        limb = self.geometry.limb(index)
        return {
            "difference": real(limb.base_radius) - real(limb.platform_radius) + real(limb.radius_offset),
            "tangential": real(limb.tangential_offset),
            "height": real(limb.z_offset) - real(limb.height_offset),
            "arm": real(limb.arm),
            "rod": real(limb.rod),
            "angle": real(limb.angle_offset),
        }

    def _terms(self, index: int, point: Sequence[float]) -> tuple[Any, Any, Any]:
        """Return u, v and w of one limb: the platform joint seen from the motor axis."""
        limb, (cosine, sine) = self._limbs[index], self._directions[index]
        x, y, z = (self._mp.mpf(value) for value in point)
        u, v = x * cosine + y * sine - limb["difference"], y * cosine - x * sine - limb["tangential"]
        return u, v, z + limb["height"]

    def _solve(self, index: int, point: Sequence[float]) -> tuple[float, float, float, float] | None:
        limb = self._limbs[index]
        u, v, w = self._terms(index, point)
        reach = u * u + w * w
        k = reach + v * v + limb["arm"] ** 2 - limb["rod"] ** 2
        q = 4 * limb["arm"] ** 2 * reach - k * k
        if q < 0 or reach == 0:
            return None
        root = -self._mp.sqrt(q)
        right = self._mp.atan2(k * w + root * u, k * u - root * w) - limb["angle"]
        wrong = self._mp.atan2(k * w - root * u, k * u + root * w) - limb["angle"]
        return (*self._split(right), *self._split(wrong))

    def _edge(self, index: int, point: Sequence[float]) -> Any:
        limb = self._limbs[index]
        u, v, w = self._terms(index, point)
        across = self._mp.sqrt(u * u + w * w)
        nearest = self._mp.sqrt((across - limb["arm"]) ** 2 + v * v)
        farthest = self._mp.sqrt((across + limb["arm"]) ** 2 + v * v)
        return min(limb["rod"] - nearest, farthest - limb["rod"])

    def _assemble(self, arms: Sequence[float]) -> Any:
        """Return the common point (3,) of the elbows' spheres, by elimination: p = c0 + o + h·n; None if none."""
        elbows = [self._elbow(index, angle) for index, angle in enumerate(arms)]
        first, *others = [limb["rod"] ** 2 for limb in self._limbs]
        a, b = elbows[1] - elbows[0], elbows[2] - elbows[0]
        n = np.cross(a, b)
        square = n @ n
        if square == 0:
            return None
        # The centre o obeys 2 a·o = |a|² + L0² − L1², 2 b·o = |b|² + L0² − L2² and n·o = 0.
        p, q = ((side @ side + first - other) / (2 * square) for side, other in zip((a, b), others, strict=True))
        o = p * np.cross(b, n) + q * np.cross(n, a)
        height = (first - o @ o) / square
        return None if height < 0 else elbows[0] + o + self._side * self._mp.sqrt(height) * n

    def _elbow(self, index: int, angle: float) -> Any:
        """Return an elbow (3,) in charger_base, shifted inward by the platform's radius."""
        limb, (cosine, sine) = self._limbs[index], self._directions[index]
        true = self._mp.mpf(angle) + limb["angle"]
        radius = limb["difference"] + limb["arm"] * self._mp.cos(true)
        side = limb["tangential"]
        height = limb["arm"] * self._mp.sin(true) - limb["height"]
        return np.array([radius * cosine - side * sine, radius * sine + side * cosine, height])

    def _split(self, value: Any) -> tuple[float, float]:
        high = float(value)
        return high, float(value - self._mp.mpf(high))
