"""One point at a time in plain Python floats: what a simulator or a control loop calls thousands of times a second.

numpy costs 30–60 µs for a single point whatever it computes; these forms cost a few. The formulas are those of
`deltacharger_kinematics.delta`, and a test holds the two against each other.
"""

from __future__ import annotations

import math

from deltacharger_kinematics.geometry import LIMB_DIRECTIONS, DeltaGeometry, Vector

_NAN3: Vector = (math.nan, math.nan, math.nan)
Matrix = tuple[float, float, float, float, float, float, float, float, float]
_NAN9: Matrix = (math.nan,) * 9


class ScalarDelta:
    """Inverse and forward kinematics and the Jacobian of one point, in ``charger_base`` (m, rad)."""

    def __init__(self, geometry: DeltaGeometry | None = None) -> None:
        self.geometry = geometry or DeltaGeometry()
        self._arm = self.geometry.arm
        self._rod = self.geometry.rod
        self._difference = self.geometry.radius_difference
        self._z_offset = self.geometry.z_offset

    def inverse(self, x: float, y: float, z: float) -> Vector:
        """Return the three arm angles (rad) that put the platform at (x, y, z); NaN where it is out of reach."""
        arm, rod, difference = self._arm, self._rod, self._difference
        w = z + self._z_offset
        angles = []
        for cosine, sine in LIMB_DIRECTIONS:
            u = x * cosine + y * sine - difference
            v = y * cosine - x * sine
            reach = u * u + w * w
            k = reach + v * v + arm * arm - rod * rod
            q = 4.0 * arm * arm * reach - k * k
            if not q >= 0.0:
                return _NAN3
            root = math.sqrt(q)
            angles.append(math.atan2(k * w - root * u, k * u + root * w))
        return angles[0], angles[1], angles[2]

    def forward(self, a0: float, a1: float, a2: float) -> Vector:
        """Return the platform position (m) ahead of the elbows; NaN where the rods do not meet."""
        arm, difference = self._arm, self._difference
        centres = []
        for angle, (cosine, sine) in zip((a0, a1, a2), LIMB_DIRECTIONS, strict=True):
            radius = difference + arm * math.cos(angle)
            centres.append((radius * cosine, radius * sine, arm * math.sin(angle)))
        (x0, y0, z0), (x1, y1, z1), (x2, y2, z2) = centres
        ax, ay, az = x1 - x0, y1 - y0, z1 - z0
        bx, by, bz = x2 - x0, y2 - y0, z2 - z0
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        normal = nx * nx + ny * ny + nz * nz
        if not normal > 0.0:
            return _NAN3
        aa, bb = (ax * ax + ay * ay + az * az) / (2.0 * normal), (bx * bx + by * by + bz * bz) / (2.0 * normal)
        # Centre of the circle through the three elbows, relative to the first.
        ox = bb * (ny * az - nz * ay) + aa * (by * nz - bz * ny)
        oy = bb * (nz * ax - nx * az) + aa * (bz * nx - bx * nz)
        oz = bb * (nx * ay - ny * ax) + aa * (bx * ny - by * nx)
        height = self._rod * self._rod - (ox * ox + oy * oy + oz * oz)
        if not height >= 0.0:
            return _NAN3
        scale = math.sqrt(height / normal)
        return x0 + ox + scale * nx, y0 + oy + scale * ny, z0 + oz + scale * nz - self._z_offset

    def jacobian(self, x: float, y: float, z: float) -> Matrix:
        """Return dp/dangle (m/rad), nine floats row by row; NaN where the point is out of reach or singular."""
        arm, difference = self._arm, self._difference
        w = z + self._z_offset
        rods = []
        lever = []
        for cosine, sine in LIMB_DIRECTIONS:
            u = x * cosine + y * sine - difference
            v = y * cosine - x * sine
            reach = u * u + w * w
            k = reach + v * v + arm * arm - self._rod * self._rod
            q = 4.0 * arm * arm * reach - k * k
            if not q >= 0.0 or not reach > 0.0:
                return _NAN9
            root = math.sqrt(q)
            # Elbow in the limb's plane: a·cosθ and a·sinθ, from the same atan2 arguments, normalised.
            scale = 1.0 / (2.0 * reach)
            elbow_u = (k * u + root * w) * scale
            elbow_w = (k * w - root * u) * scale
            du, dw = u - elbow_u, w - elbow_w
            rods.append((du * cosine - v * sine, du * sine + v * cosine, dw))
            lever.append(0.5 * root)
        (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = rods
        c0x, c0y, c0z = r11 * r22 - r12 * r21, r12 * r20 - r10 * r22, r10 * r21 - r11 * r20
        determinant = r00 * c0x + r01 * c0y + r02 * c0z
        if determinant == 0.0:
            return _NAN9
        c1x, c1y, c1z = r21 * r02 - r22 * r01, r22 * r00 - r20 * r02, r20 * r01 - r21 * r00
        c2x, c2y, c2z = r01 * r12 - r02 * r11, r02 * r10 - r00 * r12, r00 * r11 - r01 * r10
        g0, g1, g2 = lever[0] / determinant, lever[1] / determinant, lever[2] / determinant
        return c0x * g0, c1x * g1, c2x * g2, c0y * g0, c1y * g1, c2y * g2, c0z * g0, c1z * g1, c2z * g2

    def torque(self, x: float, y: float, z: float, force: Vector) -> Vector:
        """Return the arm torques (N·m) that press with `force` (N, what the platform exerts), τ = Jᵀ f."""
        j = self.jacobian(x, y, z)
        fx, fy, fz = force
        return (
            j[0] * fx + j[3] * fy + j[6] * fz,
            j[1] * fx + j[4] * fy + j[7] * fz,
            j[2] * fx + j[5] * fy + j[8] * fz,
        )

    def force(self, x: float, y: float, z: float, torque: Vector) -> Vector:
        """Return the force (N) that the platform exerts for arm torques (N·m), f = J⁻ᵀ τ; NaN where singular."""
        a, b, c, d, e, f, g, h, i = self.jacobian(x, y, z)
        t0, t1, t2 = torque
        determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
        if determinant == 0.0 or determinant != determinant:
            return _NAN3
        return (
            (t0 * (e * i - f * h) - t1 * (d * i - f * g) + t2 * (d * h - e * g)) / determinant,
            (-t0 * (b * i - c * h) + t1 * (a * i - c * g) - t2 * (a * h - b * g)) / determinant,
            (t0 * (b * f - c * e) - t1 * (a * f - c * d) + t2 * (a * e - b * d)) / determinant,
        )

    def holding_torque(self, x: float, y: float, z: float, gravity: Vector) -> Vector:
        """Return the arm torques (N·m) that carry platform and rods at rest against `gravity` (m/s²).

        Half of each rod pair counts with the platform and half with its elbow.
        """
        geometry = self.geometry
        carried = geometry.platform_mass + 1.5 * geometry.rod_mass
        gx, gy, gz = gravity
        platform = self.torque(x, y, z, (-carried * gx, -carried * gy, -carried * gz))
        half_rod = 0.5 * geometry.rod_mass * geometry.arm
        held = []
        for share, angle, (cosine, sine) in zip(platform, self.inverse(x, y, z), LIMB_DIRECTIONS, strict=True):
            outward = gx * cosine + gy * sine
            held.append(share - half_rod * (gz * math.cos(angle) - outward * math.sin(angle)))
        return held[0], held[1], held[2]
