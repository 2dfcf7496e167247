# SPDX-License-Identifier: Apache-2.0
"""Warnings about solved points: exceeded limits, near singularities, the mirror assembly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.limb_arrays import LimbArrays
from deltacharger_kinematics.status import NEAR_TYPE_1, NEAR_TYPE_2, Status

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

    def __init__(self, geometry: DeltaGeometry, arrays: LimbArrays, assembly: int) -> None:
        self._joint_min, self._joint_max = geometry.joint_min, geometry.joint_max
        self._root = 2.0 * arrays.rod * NEAR_TYPE_1 * arrays.arm
        self._across = arrays.rod * np.sin(geometry.swing_max)
        self._assembly = float(assembly)
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
        bits |= point_flag(self._assembly * determinant < 0.0, Status.WRONG_ASSEMBLY)
        bits |= point_flag(np.abs(determinant) < self._determinant, Status.NEAR_TYPE_2)
        return np.where(np.isnan(determinant), np.uint32(0), bits)
