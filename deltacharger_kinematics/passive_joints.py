# SPDX-License-Identifier: Apache-2.0
"""Joints without a motor, as the URDF names them: universal joints of the rods, and the platform's translation."""

import math
from collections.abc import Sequence

from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_kinematics.scalar import ScalarDelta


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
