"""The dimensions and limits of the inverted delta."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

Vector = tuple[float, float, float]

LIMB_COUNT = 3
# Azimuths 0, 120, 240° from +x toward +y, with the exact values of cosine and sine in double precision.
LIMB_DIRECTIONS: tuple[tuple[float, float], ...] = (
    (1.0, 0.0),
    (-0.5, math.sqrt(3.0) / 2.0),
    (-0.5, -math.sqrt(3.0) / 2.0),
)


@dataclass(frozen=True)
class DeltaGeometry:
    """Dimensions (m, kg, rad) of the delta; the defaults reach the whole published workspace.

    The paper gives the workspace (±60, ±60, 0…110 mm) and the platform's mass but no link lengths, so every length is a
    parameter. Only ``base_radius - platform_radius`` enters the kinematics.

    Attributes:
        base_radius: motor axis from the centre of the setup ring.
        arm: driven link, motor axis to elbow.
        rod: passive parallelogram link, elbow to platform joint.
        platform_radius: platform joint from the centre of the platform.
        z_offset: motor plane to the plane z = 0 of ``charger_base``.
        joint_min: smallest arm angle.
        joint_max: largest arm angle.
        workspace_min: lower corner of the workspace box in ``charger_base``.
        workspace_max: upper corner of the workspace box in ``charger_base``.
        swing_max: largest angle between a rod and the plane in which its arm turns.
        platform_mass: end effector with electrodes, magnets and pads (paper: 274 g).
        rod_mass: one rod pair; half of it moves with the platform and half with the elbow.

    Raises:
        ValueError: a length is not positive and finite, or a lower limit is not below its upper limit.
    """

    base_radius: float = 0.055
    arm: float = 0.100
    rod: float = 0.180
    platform_radius: float = 0.050
    z_offset: float = 0.095
    joint_min: float = math.radians(-65.0)
    joint_max: float = math.radians(70.0)
    workspace_min: Vector = (-0.060, -0.060, 0.0)
    workspace_max: Vector = (0.060, 0.060, 0.110)
    swing_max: float = math.radians(32.0)
    platform_mass: float = 0.274
    rod_mass: float = 0.030

    def __post_init__(self) -> None:
        for name in ("base_radius", "arm", "rod", "platform_radius", "swing_max"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"DeltaGeometry.{name} is {value!r}: give a positive, finite number")
        for name in ("platform_mass", "rod_mass"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"DeltaGeometry.{name} is {value!r}: give a finite number of kg, 0 or more")
        if not math.isfinite(self.z_offset):
            raise ValueError(f"DeltaGeometry.z_offset is {self.z_offset!r}: give a finite number")
        if not self.joint_min < self.joint_max:
            raise ValueError(f"DeltaGeometry.joint_min {self.joint_min!r} is not below joint_max {self.joint_max!r}")
        for low, high in zip(self.workspace_min, self.workspace_max, strict=True):
            if not low < high:
                raise ValueError(
                    f"DeltaGeometry.workspace_min {self.workspace_min!r} is not below "
                    f"workspace_max {self.workspace_max!r}"
                )

    @property
    def radius_difference(self) -> float:
        """base_radius − platform_radius, the D of the formulas (m)."""
        return self.base_radius - self.platform_radius

    def with_values(self, **changes: Any) -> DeltaGeometry:
        """Return a copy with some fields changed.

        Raises:
            ValueError: a name is not a field, or the new value is refused.
        """
        unknown = set(changes) - {field.name for field in fields(self)}
        if unknown:
            raise ValueError(f"DeltaGeometry has no field {sorted(unknown)}")
        return replace(self, **changes)
