# SPDX-License-Identifier: Apache-2.0
"""Inverse and forward kinematics of arrays of poses, and the flags of their results.

Inverse kinematics of many points in plain doubles, and in double-double if doubles are not precise enough.
`deltacharger_kinematics.delta` explains the formulas. A point is solved again by `exact.py` if some limb's √Q is
small relative to the terms whose difference it is. There the plain angle loses digits, and nearer to the edge of reach
rounding may change the sign of Q, which decides whether the point is reachable.
"""

import threading
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_kinematics.exact import DOUBTFUL_ROOT, HOPELESS, solve_limb
from deltacharger_kinematics.geometry import COLLINEAR, LIMB_COUNT, NEAR_TYPE_1, NEAR_TYPE_2, DeltaGeometry, Status


def dot(a: Array, b: Array) -> Array:
    """Return the scalar products (...)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: Array, b: Array) -> Array:
    """Return the vector products (3, ...)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def determinant(rows: Array) -> Array:
    """Return the determinants (n,) of the matrices whose three rows are rows[:, i, :]."""
    (x0, x1, x2), (y0, y1, y2), (z0, z1, z2) = rows
    return np.asarray(x0 * (y1 * z2 - z1 * y2) + y0 * (z1 * x2 - x1 * z2) + z0 * (x1 * y2 - y1 * x2))


class LimbArrays:
    """Columns of one geometry; names as in `deltacharger_kinematics.delta` (m, rad)."""

    def __init__(self, geometry: DeltaGeometry) -> None:
        self.limbs = tuple(geometry.limb(index) for index in range(LIMB_COUNT))

        def column(name: str) -> Array:
            return np.array([[getattr(limb, name)] for limb in self.limbs])

        self.cosine, self.sine = column("cosine"), column("sine")
        self.difference, self.tangential = column("difference"), column("tangential_offset")
        self.motor_height, self.height_offset = column("motor_height"), column("height_offset")
        self.arm, self.rod = column("arm"), column("rod")
        self.angle_offset = column("angle_offset")

    def elbows(self, cosine: Array, sine: Array) -> tuple[Array, Array, Array]:
        """Return x, y, z (3, n) of the elbows in delta_motor, minus the platform radius.

        Args:
            cosine: cosine of the true arm angles (3, n).
            sine: sine of the true arm angles (3, n).
        """
        radius = self.difference + self.arm * cosine
        x = radius * self.cosine - self.tangential * self.sine
        y = radius * self.sine + self.tangential * self.cosine
        return x, y, self.arm * sine + self.height_offset


Bits = NDArray[np.uint32]

ALL_LIMBS = np.uint32(Status.LIMB_0 | Status.LIMB_1 | Status.LIMB_2)
_LIMB_BITS = np.array([[Status.LIMB_0], [Status.LIMB_1], [Status.LIMB_2]], dtype=np.uint32)


def limb_flag(mask: Mask, flag: Status) -> Bits:
    """Return (n,) `flag` with the bits of the limbs whose `mask` (3, n) is set; 0 if none is set."""
    if not mask.any():
        return np.zeros(mask.shape[1], dtype=np.uint32)
    bits = (mask * _LIMB_BITS).sum(axis=0, dtype=np.uint32)
    return np.asarray(np.where(bits != 0, bits | np.uint32(flag), bits), dtype=np.uint32)


def point_flag(mask: Mask, flag: Status) -> Bits:
    """Return `flag` (n,) where `mask` (n,) is set."""
    return mask * np.uint32(flag)


class WarningFlags:
    """The limits of one geometry; arrays have one column per point."""

    def __init__(self, geometry: DeltaGeometry, arrays: LimbArrays) -> None:
        self._joint_min, self._joint_max = geometry.joint_min, geometry.joint_max
        self._root = 2.0 * arrays.rod * NEAR_TYPE_1 * arrays.arm
        self._across = arrays.rod * np.sin(geometry.swing_max)
        self._determinant = NEAR_TYPE_2 * float(np.prod(arrays.rod))
        self._low = np.array(geometry.workspace_min)[:, None]
        self._high = np.array(geometry.workspace_max)[:, None]

    def check(self, points: Array, angles: Array, root: Array, across: Array, determinant: Array) -> Bits:
        """Return the warnings (n,); none for points whose determinant is NaN.

        Args:
            points: (3 axes, n) m in charger_base.
            angles: (3 limbs, n) commanded, rad.
            root: (3, n) √Q = 2 · rod · lever, m².
            across: (3, n) component of the rods normal to their arms' planes, m.
            determinant: (n,) determinant of the rod vectors, m³.
        """
        bits = limb_flag(root < self._root, Status.NEAR_TYPE_1)
        bits |= limb_flag((angles < self._joint_min) | (angles > self._joint_max), Status.JOINT_LIMIT)
        bits |= limb_flag(np.abs(across) > self._across, Status.SWING_LIMIT)
        outside = ((points < self._low) | (points > self._high)).any(axis=0)
        bits |= point_flag(np.asarray(outside), Status.OUTSIDE_WORKSPACE)
        bits |= point_flag(determinant < 0.0, Status.WRONG_ASSEMBLY)
        bits |= point_flag(np.abs(determinant) < self._determinant, Status.NEAR_TYPE_2)
        return np.where(np.isnan(determinant), np.uint32(0), bits)


CHUNK = 8192  # points; larger chunks exceed the caches, smaller ones have more call overhead
LARGEST = 1e6  # robot sizes; a point farther away is out of reach regardless of rounding


class _Limbs(NamedTuple):
    """Terms of the formulas for the limbs (3, n) of a chunk; sine and cosine times 2a(u² + w²)."""

    u: Array
    v: Array
    w: Array
    k: Array
    q: Array
    reach: Array
    root: Array
    sine: Array
    cosine: Array
    angle: Array
    spare: Array


class _Scratch(threading.local):
    """Scratch memory for one chunk, one per thread.

    New arrays of this size for each step would return to the system in between, and their page faults would cost more
    than the arithmetic: up to four times the total time, depending on the process's other allocations.
    """

    def __init__(self) -> None:
        self._limbs = np.empty((len(_Limbs._fields), 3, CHUNK))
        self._rods = np.empty((3, 3, CHUNK))

    def limbs(self, count: int) -> _Limbs:
        """Return arrays (3, count)."""
        return _Limbs(*self._limbs[..., :count])

    def rods(self, count: int) -> Array:
        """Return an array (3, 3, count)."""
        return self._rods[..., :count]


_SCRATCH = _Scratch()


class InverseSolver:
    """Angles, status and margin of points, in chunks."""

    def __init__(self, geometry: DeltaGeometry, arrays: LimbArrays) -> None:
        self._arrays = arrays
        self._warnings = WarningFlags(geometry, arrays)
        self._size = float(max(arrays.arm.max(), arrays.rod.max()))
        self._four_arm_squared = 4.0 * arrays.arm**2
        self._constant = arrays.arm**2 - arrays.rod**2
        self._two_rod_squared = 2.0 * arrays.rod**2

    def solve(self, points: Array) -> tuple[Array, Bits, Array]:
        """Return angles (n, 3), status (n,) and margin (n,) of `points` (n, 3)."""
        angles = np.empty(points.shape)
        status = np.empty(len(points), dtype=np.uint32)
        margin = np.empty(len(points))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
            for start in range(0, len(points), CHUNK):
                part = slice(start, start + CHUNK)
                angles[part], status[part], margin[part] = self._chunk(np.ascontiguousarray(points[part].T))
        return angles, status, margin

    def rods(self, points: Array) -> tuple[Array, Array]:
        """Return rod vectors (3 axes, 3 limbs, n) m and rod times lever (3, n) m² at `points` (n, 3).

        NaN if the limb does not reach the point.
        """
        rods = np.empty((3, 3, len(points)))
        lever = np.empty((3, len(points)))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
            for start in range(0, len(points), CHUNK):
                part = slice(start, start + CHUNK)
                given = np.ascontiguousarray(points[part].T)
                limbs = self._limbs(np.where(self._hopeless(given), np.nan, given))
                rods[..., part] = self._rods(limbs)
                lever[:, part] = np.where(limbs.q >= 0.0, 0.5 * limbs.root, np.nan)
        return rods + 0.0 * lever, lever

    def _hopeless(self, points: Array) -> Mask:
        """Return which `points` (3, n) are not finite or too far for meaningful squares; (n,)."""
        largest = LARGEST * self._size
        if points.max() <= largest and points.min() >= -largest:  # false also for NaN
            return np.zeros(points.shape[1], dtype=np.bool_)
        return np.asarray(~(np.abs(points) <= largest).all(axis=0))

    def _chunk(self, points: Array) -> tuple[Array, Bits, Array]:
        """Return angles (n, 3), status (n,) and margin (n,) of `points` (3, n)."""
        hopeless = self._hopeless(points)
        invalid = ~np.asarray(np.isfinite(points[:, hopeless]).all(axis=0))
        if len(invalid):
            points = np.where(hopeless, 0.0, points)
        limbs = self._limbs(points)
        bits = self._reach_flags(limbs)
        scale = np.multiply(self._four_arm_squared, limbs.reach, out=limbs.spare)
        margin = np.divide(limbs.q, scale, out=scale).min(axis=0)
        rods = self._rods(limbs)
        warnings = self._warnings.check(points, limbs.angle, limbs.root, limbs.v, determinant(rods))
        bits |= np.where(bits == 0, warnings, np.uint32(0))
        if len(invalid):
            limbs.angle[:, hopeless] = np.nan
            margin[hopeless] = np.where(invalid, np.nan, -np.inf)
            bits[hopeless] = np.where(invalid, np.uint32(Status.INVALID_INPUT), Status.UNREACHABLE_FAR | ALL_LIMBS)
        return limbs.angle.T, bits, margin

    def _limbs(self, points: Array) -> _Limbs:
        limbs = self._plain(points)
        self._resolve(points, limbs)
        return limbs

    def _plain(self, points: Array) -> _Limbs:
        """Solve in plain doubles; the arrays are this thread's scratch memory."""
        arrays = self._arrays
        x, y, z = points
        limbs = _SCRATCH.limbs(len(x))
        u, v, w, k, q, reach, root, sine, cosine, angle, spare = limbs
        np.multiply(arrays.cosine, x, out=u)
        u += np.multiply(arrays.sine, y, out=spare)
        u -= arrays.difference
        np.multiply(arrays.cosine, y, out=v)
        v -= np.multiply(arrays.sine, x, out=spare)
        v -= arrays.tangential
        np.add(z, arrays.motor_height, out=w)
        np.multiply(u, u, out=reach)
        reach += np.multiply(w, w, out=spare)
        np.multiply(v, v, out=k)
        k += reach
        k += self._constant
        np.multiply(self._four_arm_squared, reach, out=q)
        q -= np.multiply(k, k, out=spare)
        np.sqrt(np.maximum(q, 0.0, out=root), out=root)
        np.multiply(k, w, out=sine)
        sine -= np.multiply(root, u, out=angle)
        np.multiply(k, u, out=cosine)
        cosine += np.multiply(root, w, out=angle)
        np.arctan2(sine, cosine, out=angle)
        angle -= arrays.angle_offset
        return limbs

    def _resolve(self, points: Array, limbs: _Limbs) -> None:
        """Solve again, in double-double, the points for which plain doubles are not precise enough."""
        size = np.add(limbs.k, self._two_rod_squared, out=limbs.spare)
        small = limbs.root < DOUBTFUL_ROOT * size
        if not small.any():
            return
        chosen = np.flatnonzero((small & (limbs.q > -HOPELESS * size * size)).any(axis=0))
        x, y, z = points[:, chosen]
        for row, limb in enumerate(self._arrays.limbs):
            angle, q = solve_limb(x, y, z, limb)
            limbs.angle[row, chosen], limbs.q[row, chosen] = angle, q
            limbs.root[row, chosen] = np.sqrt(np.maximum(q, 0.0))
            length, true = 2.0 * limb.arm * limbs.reach[row, chosen], angle + limb.angle_offset
            limbs.sine[row, chosen], limbs.cosine[row, chosen] = length * np.sin(true), length * np.cos(true)

    def _reach_flags(self, limbs: _Limbs) -> Bits:
        """Return why points are out of reach, and set the angles of those limbs to NaN."""
        missed = limbs.q < 0.0
        indeterminate = (limbs.reach == 0.0) & ~missed  # or too close to its axis for squares of doubles
        if not (missed.any() or indeterminate.any()):
            return np.zeros(limbs.q.shape[1], dtype=np.uint32)
        limbs.angle[missed | indeterminate] = np.nan
        limbs.q[indeterminate] = np.nan
        lateral = missed & (np.abs(limbs.v) > self._arrays.rod)
        # d < |a − ρ| implies K < 0 or d < a, and d > a + ρ implies neither, so no root is needed.
        near = missed & ~lateral & ((limbs.k < 0.0) | (limbs.reach < self._arrays.arm**2))
        bits = limb_flag(lateral, Status.UNREACHABLE_LATERAL) | limb_flag(near, Status.UNREACHABLE_NEAR)
        bits |= limb_flag(missed & ~lateral & ~near, Status.UNREACHABLE_FAR)
        bits |= limb_flag(indeterminate, Status.INDETERMINATE)
        return np.asarray(bits)

    def _rods(self, limbs: _Limbs) -> Array:
        """Return the rod vectors (3 axes, 3 limbs, n) m, without computing sine and cosine of the angles."""
        arrays = self._arrays
        x, y, z = rods = _SCRATCH.rods(limbs.u.shape[1])
        half = np.divide(0.5, limbs.reach, out=limbs.spare)
        outward = limbs.cosine
        outward *= half
        np.subtract(limbs.u, outward, out=outward)
        np.multiply(limbs.sine, half, out=z)
        np.subtract(limbs.w, z, out=z)
        np.multiply(arrays.cosine, outward, out=x)
        x -= np.multiply(arrays.sine, limbs.v, out=limbs.spare)
        np.multiply(arrays.sine, outward, out=y)
        y += np.multiply(arrays.cosine, limbs.v, out=limbs.spare)
        return rods


class ForwardSolver:
    """Position and status for joint angles, in chunks."""

    def __init__(self, geometry: DeltaGeometry, arrays: LimbArrays) -> None:
        self._geometry = geometry
        self._arrays = arrays
        self._warnings = WarningFlags(geometry, arrays)
        self._rods_squared = [float(limb.rod) ** 2 for limb in arrays.limbs]

    def solve(self, angles: Array) -> tuple[Array, Bits]:
        """Return positions (n, 3) and status (n,) for `angles` (n, 3)."""
        positions = np.empty(angles.shape)
        status = np.empty(len(angles), dtype=np.uint32)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
            for start in range(0, len(angles), CHUNK):
                part = slice(start, start + CHUNK)
                positions[part], status[part] = self._chunk(np.ascontiguousarray(angles[part].T))
        return positions, status

    def _chunk(self, angles: Array) -> tuple[Array, Bits]:
        arrays = self._arrays
        turned = angles + arrays.angle_offset
        cosine, sine = np.cos(turned), np.sin(turned)
        elbows = np.stack(arrays.elbows(cosine, sine))
        apart = elbows - elbows[:, :1]
        offset, collinear, height = self._intersect(apart)
        finite = np.isfinite(angles).all(axis=0)
        bits = np.where(
            finite,
            point_flag(collinear, Status.DEGENERATE) | point_flag(~collinear & (height < 0.0), Status.NOT_ASSEMBLABLE),
            np.uint32(Status.INVALID_INPUT),
        )
        position = elbows[:, 0] + offset
        position[2] -= self._geometry.z_offset
        rods = offset[:, None] - apart  # not from position, which has lost digits by adding the first elbow
        det = determinant(rods)
        solved = bits == 0
        if not solved.all():
            position[:, ~solved] = det[~solved] = np.nan
        root = 2.0 * np.abs(self._lever(rods, cosine, sine))
        bits |= self._warnings.check(position, angles, root, self._across(rods), det)
        return position.T, bits

    def _intersect(self, apart: Array) -> tuple[Array, Mask, Array]:
        """Return the intersection of the spheres about elbows 0, 1 and 2.

        Args:
            apart: elbows (3 axes, 3 limbs, n) relative to the first.

        Returns:
            the point (3, n) relative to the first elbow; whether the elbows are collinear (n,); the squared height (n,)
            of the point above their plane, negative if the rods are too short.
        """
        a, b = apart[:, 1], apart[:, 2]
        normal = cross(a, b)
        aa, bb, square = dot(a, a), dot(b, b), dot(normal, normal)
        r0, r1, r2 = self._rods_squared
        extent = np.maximum(aa, bb)
        collinear = square <= COLLINEAR**2 * extent * np.maximum(extent, r0)
        along_a, along_b = 0.5 * (aa + (r0 - r1)) / square, 0.5 * (bb + (r0 - r2)) / square
        foot = along_a * cross(b, normal) + along_b * cross(normal, a)
        height = r0 - dot(foot, foot)
        return foot + np.sqrt(height / square) * normal, np.asarray(collinear), height

    def _lever(self, rods: Array, cosine: Array, sine: Array) -> Array:
        """Return rod length times lever (3, n): the rod's component along the elbow's motion, times the arm."""
        arrays = self._arrays
        outward = arrays.cosine * rods[0] + arrays.sine * rods[1]
        return np.asarray(arrays.arm * (cosine * rods[2] - sine * outward))

    def _across(self, rods: Array) -> Array:
        """Return the rods' component (3, n) normal to the planes of their arms."""
        return np.asarray(self._arrays.cosine * rods[1] - self._arrays.sine * rods[0])
