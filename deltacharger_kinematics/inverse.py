# SPDX-License-Identifier: Apache-2.0
"""Inverse kinematics of many points in plain doubles, and in double-double if doubles are not precise enough.

`deltacharger_kinematics.delta` explains the formulas. A point is solved again by `exact.precise` if some limb's √Q is
small relative to the terms whose difference it is. There the plain angle loses digits, and nearer to the edge of reach
rounding may change the sign of Q, which decides whether the point is reachable.
"""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_kinematics.exact.precise import DOUBTFUL_ROOT, HOPELESS, solve_limb
from deltacharger_kinematics.flags import ALL_LIMBS, WarningFlags, limb_flag
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.limb_arrays import LimbArrays
from deltacharger_kinematics.status import Status
from deltacharger_kinematics.vectors import determinant

Bits = NDArray[np.uint32]

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

    def __init__(self, geometry: DeltaGeometry, working_mode: tuple[int, int, int], assembly: int) -> None:
        self._arrays = arrays = LimbArrays(geometry, working_mode)
        self._warnings = WarningFlags(geometry, arrays, assembly)
        self._knees = working_mode
        self._size = float(max(arrays.arm.max(), arrays.rod.max()))
        self._four_arm_squared = 4.0 * arrays.arm**2
        self._constant = arrays.arm**2 - arrays.rod**2
        self._two_rod_squared = 2.0 * arrays.rod**2

    def solve(self, points: Array, precise: bool) -> tuple[Array, Bits, Array]:
        """Return angles (n, 3), status (n,) and margin (n,) of `points` (n, 3)."""
        angles = np.empty(points.shape)
        status = np.empty(len(points), dtype=np.uint32)
        margin = np.empty(len(points))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
            for start in range(0, len(points), CHUNK):
                part = slice(start, start + CHUNK)
                angles[part], status[part], margin[part] = self._chunk(np.ascontiguousarray(points[part].T), precise)
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
                limbs = self._limbs(np.where(self._hopeless(given), np.nan, given), precise=False)
                rods[..., part] = self._rods(limbs)
                lever[:, part] = np.where(limbs.q >= 0.0, -0.5 * self._arrays.knee * limbs.root, np.nan)
        return rods + 0.0 * lever, lever

    def _hopeless(self, points: Array) -> Mask:
        """Return which `points` (3, n) are not finite or too far for meaningful squares; (n,)."""
        largest = LARGEST * self._size
        if points.max() <= largest and points.min() >= -largest:  # false also for NaN
            return np.zeros(points.shape[1], dtype=np.bool_)
        return np.asarray(~(np.abs(points) <= largest).all(axis=0))

    def _chunk(self, points: Array, precise: bool) -> tuple[Array, Bits, Array]:
        """Return angles (n, 3), status (n,) and margin (n,) of `points` (3, n)."""
        hopeless = self._hopeless(points)
        invalid = ~np.asarray(np.isfinite(points[:, hopeless]).all(axis=0))
        if len(invalid):
            points = np.where(hopeless, 0.0, points)
        limbs = self._limbs(points, precise)
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

    def _limbs(self, points: Array, precise: bool) -> _Limbs:
        limbs = self._plain(points)
        self._resolve(points, limbs, precise)
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
        turn = np.multiply(arrays.knee, root, out=spare)
        np.multiply(k, w, out=sine)
        sine += np.multiply(turn, u, out=angle)
        np.multiply(k, u, out=cosine)
        cosine -= np.multiply(turn, w, out=angle)
        np.arctan2(sine, cosine, out=angle)
        angle -= arrays.angle_offset
        return limbs

    def _resolve(self, points: Array, limbs: _Limbs, precise: bool) -> None:
        """Solve again, in double-double, the points for which plain doubles are not precise enough."""
        doubtful = np.ones(points.shape[1], dtype=np.bool_)
        if not precise:
            size = np.add(limbs.k, self._two_rod_squared, out=limbs.spare)
            small = limbs.root < DOUBTFUL_ROOT * size
            if not small.any():
                return
            doubtful = np.asarray((small & (limbs.q > -HOPELESS * size * size)).any(axis=0))
        chosen = np.flatnonzero(doubtful)
        x, y, z = points[:, chosen]
        for row, (limb, knee) in enumerate(zip(self._arrays.limbs, self._knees, strict=True)):
            angle, q = solve_limb(x, y, z, limb, knee)
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
