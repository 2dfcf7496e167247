# SPDX-License-Identifier: Apache-2.0
"""Kinematics of one point in plain Python floats, for simulators and control loops.

numpy costs 30–100 µs for any single point, this module a few µs. The formulas are those of
`deltacharger_kinematics.delta`; a test compares both.
"""

import math
from collections.abc import Sequence
from math import atan2, cos, sin, sqrt

from deltacharger_kinematics.exact import DOUBTFUL_ROOT, HOPELESS, solve_limb_at
from deltacharger_kinematics.geometry import (
    COLLINEAR,
    LIMB_COUNT,
    LIMB_DIRECTIONS,
    NEAR_TYPE_1,
    NEAR_TYPE_2,
    DeltaGeometry,
    Limb,
    Status,
    Vector,
)

Matrix = tuple[float, float, float, float, float, float, float, float, float]
# One limb at a point: angle, −√Q, v, u, w, 2a(u² + w²)·(sin θ, cos θ), u² + w².
_Reached = tuple[float, float, float, float, float, float, float, float]

_SINE_120 = LIMB_DIRECTIONS[1][1]
_NAN3: Vector = (math.nan, math.nan, math.nan)
_NAN9: Matrix = (math.nan,) * 9
_LIMB_BITS = (int(Status.LIMB_0), int(Status.LIMB_1), int(Status.LIMB_2))
_TYPE_1, _JOINT, _SWING = int(Status.NEAR_TYPE_1), int(Status.JOINT_LIMIT), int(Status.SWING_LIMIT)
_TYPE_2, _WRONG, _OUTSIDE = int(Status.NEAR_TYPE_2), int(Status.WRONG_ASSEMBLY), int(Status.OUTSIDE_WORKSPACE)


class ScalarDelta:
    """Kinematics and statics of one point, in ``charger_base`` (m, rad)."""

    def __init__(self, geometry: DeltaGeometry | None = None) -> None:
        self.geometry = geometry = geometry or DeltaGeometry()
        self._limbs = tuple(geometry.limb(index) for index in range(LIMB_COUNT))
        self._inverse_numbers = tuple(map(_inverse_numbers, self._limbs))
        self._limits = tuple(
            (2.0 * limb.rod * NEAR_TYPE_1 * limb.arm, limb.rod * sin(geometry.swing_max), bit)
            for limb, bit in zip(self._limbs, _LIMB_BITS, strict=True)
        )
        self._joint_min, self._joint_max = geometry.joint_min, geometry.joint_max
        self._box = geometry.workspace_min, geometry.workspace_max
        self._elbow_numbers = tuple(_elbow_numbers(limb) for limb in self._limbs)
        self._rods_squared = tuple(limb.rod * limb.rod for limb in self._limbs)
        self._z_offset = geometry.z_offset
        self._near_determinant = NEAR_TYPE_2 * math.prod(limb.rod for limb in self._limbs)
        self._four_arms_squared = tuple(4.0 * limb.arm**2 for limb in self._limbs)

    def inverse(self, x: float, y: float, z: float) -> Vector:
        """Return the arm angles (rad) for the platform at (x, y, z); NaN if a limb does not reach it."""
        limbs = self._reach(x, y, z)
        return (limbs[0][0], limbs[1][0], limbs[2][0]) if limbs else _NAN3

    def solve(self, x: float, y: float, z: float) -> tuple[Vector, int, float] | None:
        """Return angles (rad), Status bits and margin; None if a limb has no solution."""
        limbs = self._reach(x, y, z)
        if not limbs:
            return None
        first, second, third = limbs
        four_0, four_1, four_2 = self._four_arms_squared
        margin = min(
            first[1] * first[1] / (four_0 * first[7]),
            second[1] * second[1] / (four_1 * second[7]),
            third[1] * third[1] / (four_2 * third[7]),
        )
        bits = self._warnings((x, y, z), limbs, _determinant(_rods_of(limbs)))
        return (first[0], second[0], third[0]), bits, margin

    def _warnings(self, point: Vector, limbs: Sequence[tuple[float, ...]], determinant: float) -> int:
        """Return the warnings about a point; each limb begins with angle, 2·rod·lever, rod component across."""
        low, high = self._joint_min, self._joint_max
        bits = 0
        for limb, (near, swing, bit) in zip(limbs, self._limits):  # noqa: B905 strict costs a tenth of the solve
            if not low <= limb[0] <= high:
                bits |= _JOINT | bit
            if -near < limb[1] < near:
                bits |= _TYPE_1 | bit
            if not -swing <= limb[2] <= swing:
                bits |= _SWING | bit
        if determinant < self._near_determinant:
            bits |= _WRONG if determinant < 0.0 else 0
            bits |= _TYPE_2 if determinant > -self._near_determinant else 0
        x, y, z = point
        (x0, y0, z0), (x1, y1, z1) = self._box
        if not (x0 <= x <= x1 and y0 <= y <= y1 and z0 <= z <= z1):
            bits |= _OUTSIDE
        return bits

    def forward(self, a0: float, a1: float, a2: float) -> Vector:
        """Return the platform position (m) for commanded angles; NaN if the rods do not meet."""
        return self._intersect(self._elbows((a0, a1, a2)))

    def _intersect(self, elbows: list[Vector]) -> Vector:
        (x0, y0, z0), (x1, y1, z1), (x2, y2, z2) = elbows
        ax, ay, az = x1 - x0, y1 - y0, z1 - z0
        bx, by, bz = x2 - x0, y2 - y0, z2 - z0
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        normal = nx * nx + ny * ny + nz * nz
        r0, r1, r2 = self._rods_squared
        aa, bb = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz
        extent = max(aa, bb)
        if not normal > COLLINEAR**2 * extent * max(extent, r0):
            return _NAN3
        along_a, along_b = (aa + (r0 - r1)) / (2.0 * normal), (bb + (r0 - r2)) / (2.0 * normal)
        # Foot of the platform on the elbows' plane, relative to the first elbow.
        ox = along_b * (ny * az - nz * ay) + along_a * (by * nz - bz * ny)
        oy = along_b * (nz * ax - nx * az) + along_a * (bz * nx - bx * nz)
        oz = along_b * (nx * ay - ny * ax) + along_a * (bx * ny - by * nx)
        height = r0 - (ox * ox + oy * oy + oz * oz)
        if not height >= 0.0:
            return _NAN3
        scale = sqrt(height / normal)
        return x0 + ox + scale * nx, y0 + oy + scale * ny, z0 + oz + scale * nz - self._z_offset

    def jacobian(self, x: float, y: float, z: float) -> Matrix:
        """Return dp/dangle (m/rad), nine floats by rows; NaN if the point is out of reach or singular."""
        limbs = self._reach(x, y, z)
        if not limbs:
            return _NAN9
        (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = rods = _rods_of(limbs)
        determinant = _determinant(rods)
        if determinant == 0.0:
            return _NAN9
        scale = -0.5 / determinant
        g0, g1, g2 = limbs[0][1] * scale, limbs[1][1] * scale, limbs[2][1] * scale
        return (
            (r11 * r22 - r12 * r21) * g0,
            (r21 * r02 - r22 * r01) * g1,
            (r01 * r12 - r02 * r11) * g2,
            (r12 * r20 - r10 * r22) * g0,
            (r22 * r00 - r20 * r02) * g1,
            (r02 * r10 - r00 * r12) * g2,
            (r10 * r21 - r11 * r20) * g0,
            (r20 * r01 - r21 * r00) * g1,
            (r00 * r11 - r01 * r10) * g2,
        )

    def torque(self, x: float, y: float, z: float, force: Vector) -> Vector:
        """Return the arm torques (N·m) for the platform to exert `force` (N), τ = Jᵀ f."""
        j = self.jacobian(x, y, z)
        fx, fy, fz = force
        return (
            j[0] * fx + j[3] * fy + j[6] * fz,
            j[1] * fx + j[4] * fy + j[7] * fz,
            j[2] * fx + j[5] * fy + j[8] * fz,
        )

    def force(self, x: float, y: float, z: float, torque: Vector) -> Vector:
        """Return the force (N) that the platform exerts for arm torques (N·m); NaN if a limb is at its edge."""
        limbs = self._reach(x, y, z)
        if not limbs or 0.0 in (limbs[0][1], limbs[1][1], limbs[2][1]):
            return _NAN3
        # f = J⁻ᵀ τ = Rᵀ diag(b)⁻¹ τ acts along the rods, so no matrix is inverted.
        (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = _rods_of(limbs)
        t0, t1, t2 = (-2.0 * share / limb[1] for share, limb in zip(torque, limbs, strict=True))
        return r00 * t0 + r10 * t1 + r20 * t2, r01 * t0 + r11 * t1 + r21 * t2, r02 * t0 + r12 * t1 + r22 * t2

    def holding_torque(self, x: float, y: float, z: float, gravity: Vector) -> Vector:
        """Return the arm torques (N·m) that carry platform and rods at rest against `gravity` (m/s²).

        Half of each rod pair counts as platform and half as elbow.
        """
        geometry = self.geometry
        carried = geometry.platform_mass + 1.5 * geometry.rod_mass
        gx, gy, gz = gravity
        platform = self.torque(x, y, z, (-carried * gx, -carried * gy, -carried * gz))
        half_rod = 0.5 * geometry.rod_mass
        held = []
        for share, angle, (zero, arm, _, cosine, sine, _, _, _) in zip(
            platform, self.inverse(x, y, z), self._elbow_numbers, strict=True
        ):
            angle += zero
            held.append(share - half_rod * arm * (gz * cos(angle) - (gx * cosine + gy * sine) * sin(angle)))
        return held[0], held[1], held[2]

    def _reach(self, x: float, y: float, z: float) -> list[_Reached]:
        """Return each limb at the point; empty if one does not reach it or has no unique angle."""
        limbs: list[_Reached] = []
        for cosine, sine, difference, tangential, height, four, constant, size, zero in self._inverse_numbers:
            u = x * cosine + y * sine - difference
            v = y * cosine - x * sine - tangential
            w = z + height
            reach = u * u + w * w
            k = reach + v * v + constant
            q = four * reach - k * k
            size += k
            root = sqrt(q) if q > 0.0 else 0.0
            if not root >= DOUBTFUL_ROOT * size:
                # NaN if the point is not finite or its squares overflow.
                return self._reach_edge(x, y, z) if q > -HOPELESS * size * size else []
            root = -root
            sine_part = k * w + root * u
            cosine_part = k * u - root * w
            limbs.append((atan2(sine_part, cosine_part) - zero, root, v, u, w, sine_part, cosine_part, reach))
        return limbs

    def _reach_edge(self, x: float, y: float, z: float) -> list[_Reached]:
        """Return the same as `_reach` in double-double, for a point near the edge of reach."""
        limbs: list[_Reached] = []
        for limb in self._limbs:
            u = x * limb.cosine + y * limb.sine - limb.difference
            v = y * limb.cosine - x * limb.sine - limb.tangential_offset
            w = z + limb.motor_height
            reach = u * u + w * w
            if reach == 0.0:
                return []
            angle, q = solve_limb_at(x, y, z, limb)
            if q < 0.0:
                return []
            length, true = 2.0 * limb.arm * reach, angle + limb.angle_offset
            limbs.append((angle, -sqrt(q), v, u, w, length * sin(true), length * cos(true), reach))
        return limbs

    def _elbows(self, commanded: Vector) -> list[Vector]:
        """Return the elbows (m) in delta_motor, minus the platform radius."""
        elbows = []
        try:
            for angle, (zero, arm, difference, cosine, sine, tangent_x, tangent_y, height) in zip(
                commanded, self._elbow_numbers, strict=True
            ):
                angle += zero
                radius = difference + arm * cos(angle)
                elbows.append((radius * cosine + tangent_x, radius * sine + tangent_y, arm * sin(angle) + height))
        except ValueError:  # an infinite angle has no cosine
            return [_NAN3] * LIMB_COUNT
        return elbows


def _inverse_numbers(limb: Limb) -> tuple[float, ...]:
    """Return a limb's constants in the order in which `_reach` unpacks them."""
    return (
        limb.cosine,
        limb.sine,
        limb.difference,
        limb.tangential_offset,
        limb.motor_height,
        4.0 * limb.arm**2,
        limb.arm**2 - limb.rod**2,
        2.0 * limb.rod**2,
        limb.angle_offset,
    )


def _elbow_numbers(limb: Limb) -> tuple[float, float, float, float, float, float, float, float]:
    """Return a limb's constants in the order in which `_elbows` unpacks them."""
    return (
        limb.angle_offset,
        limb.arm,
        limb.difference,
        limb.cosine,
        limb.sine,
        -limb.tangential_offset * limb.sine,
        limb.tangential_offset * limb.cosine,
        limb.height_offset,
    )


def _rods_of(limbs: list[_Reached]) -> tuple[Vector, Vector, Vector]:
    """Return the rod vectors (m), rotated from the limbs' planes (120° apart) to charger_base."""
    (_, _, v0, u0, w0, s0, c0, d0), (_, _, v1, u1, w1, s1, c1, d1), (_, _, v2, u2, w2, s2, c2, d2) = limbs
    # The elbow, a·cosθ and a·sinθ, from the normalised arguments of the arc tangent.
    h0, h1, h2 = 0.5 / d0, 0.5 / d1, 0.5 / d2
    o0, o1, o2 = u0 - c0 * h0, u1 - c1 * h1, u2 - c2 * h2
    return (
        (o0, v0, w0 - s0 * h0),
        (-0.5 * o1 - _SINE_120 * v1, _SINE_120 * o1 - 0.5 * v1, w1 - s1 * h1),
        (_SINE_120 * v2 - 0.5 * o2, -_SINE_120 * o2 - 0.5 * v2, w2 - s2 * h2),
    )


def _determinant(rods: Sequence[Vector]) -> float:
    (a, b, c), (d, e, f), (g, h, i) = rods
    return a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
