# SPDX-License-Identifier: Apache-2.0
"""Wrong assumptions of docking about arm and gravity: keys `assumed`, and the assumed values that they give."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from deltacharger_core.machine import GRAVITY, GRAVITY_STRENGTH
from deltacharger_core.parameters import declared, number
from deltacharger_kinematics.geometry import LIMB_COUNT, DeltaGeometry, LimbAdjustment, Vector
from deltacharger_lab.campaigns.spread import Value

_WRONG = 0.005  # m; a larger error is seen when the arm is built or measured
_TURNED = 0.1  # rad; a zero that errs by more puts the platform 12 mm off, which homing shows
_GEOMETRY = "assumed.geometry."
_COMMON = ("base_radius", "arm", "rod", "platform_radius", "z_offset")


@dataclass(frozen=True)
class AssumedLimb:
    """Errors of docking's parameters of one limb."""

    radius_offset: float = number(0.0, -_WRONG, _WRONG, "m", "error of base radius − platform radius of this limb")
    tangential_offset: float = number(0.0, -_WRONG, _WRONG, "m", "error of its plane, counter-clockwise about z")
    height_offset: float = number(0.0, -_WRONG, _WRONG, "m", "error of its motor axis, toward +z")
    arm: float = number(0.0, -_WRONG, _WRONG, "m", "error of the length of this arm")
    rod: float = number(0.0, -_WRONG, _WRONG, "m", "error of the length of this rod")
    angle_offset: float = number(0.0, -_TURNED, _TURNED, "rad", "error of this arm's zero: assumed − true angle")


@dataclass(frozen=True)
class AssumedGeometry:
    """Errors of docking's dimensions of the arm: assumed − true."""

    base_radius: float = number(
        0.0, -_WRONG, _WRONG, "m", "error of the base radius; only its difference to platform_radius's error counts"
    )
    arm: float = number(0.0, -_WRONG, _WRONG, "m", "error of the length of all arms")
    rod: float = number(0.0, -_WRONG, _WRONG, "m", "error of the length of all rods")
    platform_radius: float = number(0.0, -_WRONG, _WRONG, "m", "error of the platform's radius")
    z_offset: float = number(0.0, -_WRONG, _WRONG, "m", "error of the motor plane's position along z")
    limb_0: AssumedLimb = field(default_factory=AssumedLimb)
    limb_1: AssumedLimb = field(default_factory=AssumedLimb)
    limb_2: AssumedLimb = field(default_factory=AssumedLimb)


@dataclass(frozen=True)
class Assumed:
    """Docking's assumptions about arm and gravity."""

    servo_stiffness: float = number(1.0, 0.25, 4.0, "", "servo stiffness that docking assumes, over the true one")
    torque_constant: float = number(
        1.0, 0.5, 2.0, "", "torque constant that docking and servo_node assume, over the true one"
    )
    gravity_tilt: float = number(
        0.0, 0.0, math.pi, "rad", "angle from true gravity to the gravity that docking assumes"
    )
    gravity_azimuth: float = number(0.0, -math.pi, math.pi, "rad", "direction of that angle, as gravity.azimuth")
    geometry: AssumedGeometry = field(default_factory=AssumedGeometry)


def assumed_gravity(values: Mapping[str, Value], true: Vector) -> Vector:
    """Return the gravity (m/s², charger_base) that docking assumes.

    `assumed.gravity_tilt` turns the true gravity: first −y, as `gravity.tilt` and `gravity.azimuth` do, then the result
    by the shortest rotation that brings −y to the true direction. Without it docking assumes the true gravity if
    `gravity.known`, else −y.
    """
    if "assumed.gravity_tilt" not in values:
        return true if values.get("gravity.known", False) else GRAVITY
    tilt, azimuth = float(values["assumed.gravity_tilt"]), float(values.get("assumed.gravity_azimuth", 0.0))
    return _turned(tilted_gravity(tilt, azimuth), true)


def tilted_gravity(tilt: float, azimuth: float) -> Vector:
    """Return gravity (m/s², charger_base) of a robot tilted by `tilt` toward `azimuth` (0 = +z, π/2 = +x)."""
    level = GRAVITY_STRENGTH * math.sin(tilt)
    return level * math.sin(azimuth), -GRAVITY_STRENGTH * math.cos(tilt), level * math.cos(azimuth)


def _turned(vector: Vector, true: Vector) -> Vector:
    """Return a vector turned by the shortest rotation from −y to the direction of `true`.

    With b = −y and the unit vector a of `true` this is v − ((a + b)·v / (1 + a·b)) (a + b) + 2 (b·v) a (Rodrigues).
    If they are opposite, all half turns about an axis across y are equally short: the one about x is taken.
    """
    size = math.hypot(*true)
    ax, ay, az = (each / size for each in true)
    x, y, z = vector
    along = 1.0 - ay
    if along < 1e-9:
        return x, -y, -z
    share = (ax * x + (ay - 1.0) * y + az * z) / along
    return x - share * ax - 2.0 * y * ax, y - share * (ay - 1.0) - 2.0 * y * ay, z - share * az - 2.0 * y * az


def assumed_geometry(values: Mapping[str, Value]) -> DeltaGeometry | None:
    """Return the dimensions that docking assumes for the arm; None = the true ones."""
    names = (name for name in values if name.startswith(_GEOMETRY))
    errors = {name.removeprefix(_GEOMETRY): float(values[name]) for name in names}
    if not any(errors.values()):
        return None
    true = DeltaGeometry()
    common = replace(true, **{name: getattr(true, name) + errors.get(name, 0.0) for name in _COMMON})
    first, second, third = (_limb(common, index, errors) for index in range(LIMB_COUNT))
    return replace(common, limbs=(first, second, third))


def _limb(common: DeltaGeometry, index: int, errors: Mapping[str, float]) -> LimbAdjustment:
    """Return the assumed differences of a limb from the common dimensions."""
    found: dict[str, Any] = {}
    for item in declared(AssumedLimb):
        error = errors.get(f"limb_{index}.{item.name}", 0.0)
        if error:
            found[item.name] = error + (getattr(common, item.name) if item.name in ("arm", "rod") else 0.0)
    return LimbAdjustment(**found)
