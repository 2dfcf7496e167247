# SPDX-License-Identifier: Apache-2.0
"""Forward kinematics of many points: intersection of the three spheres of the rods about the elbows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_kinematics.flags import WarningFlags, point_flag
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.inverse import CHUNK
from deltacharger_kinematics.limb_arrays import LimbArrays
from deltacharger_kinematics.status import COLLINEAR, Status
from deltacharger_kinematics.vectors import cross, determinant, dot

Bits = NDArray[np.uint32]


class ForwardSolver:
    """Position, status and determinant for joint angles, in chunks."""

    def __init__(self, geometry: DeltaGeometry, working_mode: tuple[int, int, int], assembly: int) -> None:
        self._geometry = geometry
        self._arrays = arrays = LimbArrays(geometry, working_mode)
        self._warnings = WarningFlags(geometry, arrays, assembly)
        self._rods_squared = [float(limb.rod) ** 2 for limb in arrays.limbs]
        self._scale = float(np.prod(arrays.rod))
        self._assembly = float(assembly)

    def solve(self, angles: Array) -> tuple[Array, Bits, Array]:
        """Return positions (n, 3), status (n,) and determinants (n,) of the unit rod vectors for `angles` (n, 3)."""
        positions = np.empty(angles.shape)
        status = np.empty(len(angles), dtype=np.uint32)
        determinants = np.empty(len(angles))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
            for start in range(0, len(angles), CHUNK):
                part = slice(start, start + CHUNK)
                positions[part], status[part], determinants[part] = self._chunk(np.ascontiguousarray(angles[part].T))
        return positions, status, determinants

    def _chunk(self, angles: Array) -> tuple[Array, Bits, Array]:
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
        return position.T, bits, det / self._scale

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
        return foot + self._assembly * np.sqrt(height / square) * normal, np.asarray(collinear), height

    def _lever(self, rods: Array, cosine: Array, sine: Array) -> Array:
        """Return rod length times lever (3, n): the rod's component along the elbow's motion, times the arm."""
        arrays = self._arrays
        outward = arrays.cosine * rods[0] + arrays.sine * rods[1]
        return np.asarray(arrays.arm * (cosine * rods[2] - sine * outward))

    def _across(self, rods: Array) -> Array:
        """Return the rods' component (3, n) normal to the planes of their arms."""
        return np.asarray(self._arrays.cosine * rods[1] - self._arrays.sine * rods[0])
