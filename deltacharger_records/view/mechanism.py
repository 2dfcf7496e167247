# SPDX-License-Identifier: Apache-2.0
"""Positions of the delta's joints, for the URDF's passive joints and for pictures of the mechanism.

Dimensions that kinematics does not use are as in urdf/deltacharger.urdf.xacro; the paper gives no drawing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_kinematics.geometry import LIMB_COUNT, DeltaGeometry, Limb, Vector
from deltacharger_kinematics.scalar import ScalarDelta

ROD_SPACING = 0.040
"""Distance of a limb's two rods, m (assumed; kinematics does not use it)."""
SIDES = (("left", 0.5), ("right", -0.5))
"""The rods of a limb: name, and position along its tangent in units of ROD_SPACING."""


def motors(geometry: DeltaGeometry) -> Array:
    """Return the centres of the motor axes (3 limbs, 3) m in charger_base."""
    limbs = [geometry.limb(index) for index in range(LIMB_COUNT)]
    return np.array(
        [
            _around(limb, limb.base_radius + limb.radius_offset, limb.tangential_offset, -limb.motor_height)
            for limb in limbs
        ]
    )


def elbows(geometry: DeltaGeometry, angles: Sequence[float]) -> Array:
    """Return the centres of the elbow axes (3 limbs, 3) m in charger_base.

    Args:
        geometry: dimensions.
        angles: commanded arm angles, rad.
    """
    found = motors(geometry)
    for index, angle in enumerate(angles):
        limb = geometry.limb(index)
        true = angle + limb.angle_offset
        found[index] += _around(limb, limb.arm * math.cos(true), 0.0, limb.arm * math.sin(true))
    return found


def feet(geometry: DeltaGeometry) -> Array:
    """Return the centres of the platform's joint axes (3 limbs, 3) m in end_effector."""
    limbs = [geometry.limb(index) for index in range(LIMB_COUNT)]
    return np.array([_around(limb, limb.platform_radius, 0.0, 0.0) for limb in limbs])


def rods(geometry: DeltaGeometry, angles: Sequence[float], position: Sequence[float]) -> Array:
    """Return both ends, elbow first, of the six rods (6, 2, 3) m in charger_base, limb by limb, left before right.

    Args:
        geometry: dimensions.
        angles: commanded arm angles, rad.
        position: of end_effector, m in charger_base.
    """
    begin, end = elbows(geometry, angles), feet(geometry) + np.asarray(position, dtype=float)
    found = []
    for index in range(LIMB_COUNT):
        for _, share in SIDES:
            aside = _around(geometry.limb(index), 0.0, share * ROD_SPACING, 0.0)
            found.append((begin[index] + aside, end[index] + aside))
    return np.array(found)


def rod_angles(geometry: DeltaGeometry, index: int, position: Vector, angle: float) -> tuple[float, float]:
    """Return the two angles (rad) of a limb's universal joint for a platform position (m) and arm angle (rad)."""
    limb = geometry.limb(index)
    x, y, z = position
    u = x * limb.cosine + y * limb.sine - limb.difference
    v = y * limb.cosine - x * limb.sine - limb.tangential_offset
    w = z + limb.motor_height
    true = angle + limb.angle_offset
    pitch = math.atan2(w - limb.arm * math.sin(true), u - limb.arm * math.cos(true))
    return pitch - true, math.asin(max(-1.0, min(1.0, v / limb.rod)))


def passive_joints(delta: ScalarDelta, angles: Sequence[float]) -> dict[str, float]:
    """Return the URDF's passive joint values (m, rad) by name, except joints that mimic another.

    Args:
        delta: kinematics of the arm.
        angles: commanded arm angles, rad.

    Returns:
        Empty if forward kinematics has no solution.
    """
    position = delta.forward(*angles)
    if not all(math.isfinite(value) for value in position):
        return {}
    values = {f"platform_{axis}_joint": value for axis, value in zip("xyz", position, strict=True)}
    for index, angle in enumerate(angles):
        pitch, swing = rod_angles(delta.geometry, index, position, angle)
        values[f"limb_{index}_rod_left_pitch_joint"] = math.remainder(pitch, 2.0 * math.pi)
        values[f"limb_{index}_rod_left_swing_joint"] = swing
    return values


def _around(limb: Limb, radial: float, tangential: float, height: float) -> Array:
    cosine, sine = limb.cosine, limb.sine
    return np.array([radial * cosine - tangential * sine, radial * sine + tangential * cosine, height])
