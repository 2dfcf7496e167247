# SPDX-License-Identifier: Apache-2.0
"""Inverse kinematics and its gradient from one pass over the limbs, for a step of mechanics.

With u, v, w the elbow-free coordinates of a limb (see `deltacharger_kinematics.delta`), a its arm, K = u² + v² + w² +
a² − L² and Q = 4a²(u² + w²) − K², one arc tangent gives the angle, and its gradient is dθ = −2 [(u − a
cos θ) du + v dv + (w − a sin θ) dw] / (σ√Q). No matrix is inverted, so it stays finite if the rods lie in one
plane. Near the edge of a limb's reach, where √Q loses its digits, `ScalarDelta` is used.
"""

from __future__ import annotations

from math import atan2, cos, sin, sqrt

from deltacharger_kinematics.geometry import LIMB_COUNT, DeltaGeometry, Vector
from deltacharger_kinematics.modes import KNEE_OUT
from deltacharger_kinematics.scalar import ScalarDelta

Rows = tuple[Vector, Vector, Vector]
Turns = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]

_PLAIN = 1e-4  # √Q relative to its largest value; below it, an angle from plain doubles is worse than 1e-11 rad
_STEEPEST = 1e-3  # as above; bounds the gradient, so that a step at the edge of reach stays finite


class Linkage:
    """Inverse kinematics with its gradient, in ``charger_base`` (m, rad)."""

    def __init__(self, geometry: DeltaGeometry) -> None:
        self._edge = ScalarDelta(geometry)
        numbers = []
        for index in range(LIMB_COUNT):
            limb = geometry.limb(index)
            numbers.append(
                (
                    *(limb.cosine, limb.sine, limb.difference, limb.tangential_offset, limb.motor_height),
                    *(4.0 * limb.arm**2, limb.arm**2 - limb.rod**2, 2.0 * limb.arm * limb.rod),
                    *(float(KNEE_OUT[index]), limb.angle_offset, 1.0 / limb.arm),
                )
            )
        self._limbs = tuple(numbers)

    def linearise(self, x: float, y: float, z: float) -> tuple[Vector, Rows, Turns] | None:
        """Return angles and gradient for a position of the platform (m).

        Returns:
            The commanded angles (rad), the rows dθ/dp (rad/m), and cosine and sine of each arm's true angle; None if
            a limb does not reach it.
        """
        angles, rows, turns = [], [], []
        for cosine, sine, difference, tangential, height, four, constant, size, knee, zero, per_arm in self._limbs:
            u = x * cosine + y * sine - difference
            v = y * cosine - x * sine - tangential
            w = z + height
            reach = u * u + w * w
            k = reach + v * v + constant
            q = four * reach - k * k
            root = sqrt(q) if q > 0.0 else 0.0
            if not root > _PLAIN * size:
                return self._at_the_edge(x, y, z)
            root *= knee
            sine_part = k * w + root * u
            cosine_part = k * u - root * w
            angles.append(atan2(sine_part, cosine_part) - zero)
            half, scale = 0.5 / reach, -2.0 / root
            elbow_u, elbow_w = cosine_part * half, sine_part * half
            gu = scale * (u - elbow_u)
            gv = scale * v
            rows.append((gu * cosine - gv * sine, gu * sine + gv * cosine, scale * (w - elbow_w)))
            turns.append((elbow_u * per_arm, elbow_w * per_arm))
        return (angles[0], angles[1], angles[2]), (rows[0], rows[1], rows[2]), (turns[0], turns[1], turns[2])

    def _at_the_edge(self, x: float, y: float, z: float) -> tuple[Vector, Rows, Turns] | None:
        """As `linearise`, near the edge of reach: exact angles and a bounded gradient."""
        angles = self._edge.inverse(x, y, z)
        if angles[0] != angles[0]:
            return None
        rows, turns = [], []
        for angle, limb in zip(angles, self._limbs, strict=True):
            cosine, sine, difference, tangential, height, four, constant, size, knee, zero, _ = limb
            u = x * cosine + y * sine - difference
            v = y * cosine - x * sine - tangential
            w = z + height
            reach = u * u + w * w
            if reach == 0.0:
                return None
            k = reach + v * v + constant
            root = knee * max(sqrt(max(four * reach - k * k, 0.0)), _STEEPEST * size)
            half, scale = 0.5 / reach, -2.0 / root
            gu, gv = scale * (u - (k * u - root * w) * half), scale * v
            gz = scale * (w - (k * w + root * u) * half)
            rows.append((gu * cosine - gv * sine, gu * sine + gv * cosine, gz))
            turns.append((cos(angle + zero), sin(angle + zero)))
        return angles, (rows[0], rows[1], rows[2]), (turns[0], turns[1], turns[2])
