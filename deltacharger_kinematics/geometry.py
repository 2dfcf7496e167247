# SPDX-License-Identifier: Apache-2.0
"""The dimensions and limits of the inverted delta."""

from __future__ import annotations

import math
import numbers
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

Vector = tuple[float, float, float]

LIMB_COUNT = 3
# Azimuths 0, 120, 240° from +x toward +y, with the exact values of cosine and sine in double precision.
LIMB_DIRECTIONS: tuple[tuple[float, float], ...] = (
    (1.0, 0.0),
    (-0.5, math.sqrt(3.0) / 2.0),
    (-0.5, -math.sqrt(3.0) / 2.0),
)
SHORTEST, LONGEST = 1e-6, 1e6  # m; products of four lengths stay clear of underflow and overflow


def _check(owner: str, name: str, value: Any, low: float, high: float, unit: str) -> None:
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not low <= float(value) <= high:
        raise ValueError(f"{owner}.{name} is {value!r}: give a number from {low:g} to {high:g} {unit}")


@dataclass(frozen=True)
class LimbAdjustment:
    """How one limb differs from the common dimensions: what a calibration finds (m, rad).

    Attributes:
        radius_offset: added to base_radius − platform_radius; the two radii are not separately observable.
        tangential_offset: of the limb's plane, counter-clockwise about z.
        height_offset: of the motor axis, toward +z.
        arm: length of this arm; None = the common one.
        rod: length of this rod; None = the common one.
        angle_offset: true arm angle minus the commanded one.

    Raises:
        ValueError: names the field; a length is not positive or a number is not finite or out of bounds.
    """

    radius_offset: float = 0.0
    tangential_offset: float = 0.0
    height_offset: float = 0.0
    arm: float | None = None
    rod: float | None = None
    angle_offset: float = 0.0

    def __post_init__(self) -> None:
        for name in ("radius_offset", "tangential_offset", "height_offset"):
            _check("LimbAdjustment", name, getattr(self, name), -LONGEST, LONGEST, "m")
        for name in ("arm", "rod"):
            if getattr(self, name) is not None:
                _check("LimbAdjustment", name, getattr(self, name), SHORTEST, LONGEST, "m")
        _check("LimbAdjustment", "angle_offset", self.angle_offset, -math.pi, math.pi, "rad")


class Limb(NamedTuple):
    """One limb's own numbers, adjustment applied, as the formulas use them (m, rad)."""

    cosine: float
    sine: float
    base_radius: float
    platform_radius: float
    radius_offset: float
    tangential_offset: float
    z_offset: float
    height_offset: float
    arm: float
    rod: float
    angle_offset: float

    @property
    def difference(self) -> float:
        """The D of the formulas: base radius − platform radius + radius offset."""
        return self.base_radius - self.platform_radius + self.radius_offset

    @property
    def motor_height(self) -> float:
        """What turns z of ``charger_base`` into w: z_offset − height offset."""
        return self.z_offset - self.height_offset


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
        joint_min: smallest commanded arm angle.
        joint_max: largest commanded arm angle.
        workspace_min: lower corner of the workspace box in ``charger_base``.
        workspace_max: upper corner of the workspace box in ``charger_base``.
        swing_max: largest angle between a rod and the plane in which its arm turns.
        platform_mass: end effector with electrodes, magnets and pads (paper: 274 g).
        rod_mass: one rod pair; half of it moves with the platform and half with the elbow.
        limbs: what distinguishes limbs 0, 1 and 2 from these dimensions, as calibrated.

    Raises:
        ValueError: names the field; a length is not positive and finite, or a lower limit is not below its upper one.
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
    limbs: tuple[LimbAdjustment, LimbAdjustment, LimbAdjustment] = (
        LimbAdjustment(),
        LimbAdjustment(),
        LimbAdjustment(),
    )

    def __post_init__(self) -> None:
        for name in ("base_radius", "arm", "rod", "platform_radius"):
            self._check(name, SHORTEST, LONGEST, "m")
        self._check("z_offset", -LONGEST, LONGEST, "m")
        self._check("swing_max", 1e-6, math.pi / 2, "rad")
        for name in ("platform_mass", "rod_mass"):
            self._check(name, 0.0, 1e6, "kg")
        for name in ("joint_min", "joint_max"):
            self._check(name, -math.pi, math.pi, "rad")
        if not self.joint_min < self.joint_max:
            raise ValueError(f"DeltaGeometry.joint_min {self.joint_min!r} is not below joint_max {self.joint_max!r}")
        self._check_box()
        if not isinstance(self.limbs, tuple) or len(self.limbs) != LIMB_COUNT:
            raise ValueError(f"DeltaGeometry.limbs is {self.limbs!r}: give a tuple of three LimbAdjustment")
        if not all(isinstance(limb, LimbAdjustment) for limb in self.limbs):
            raise ValueError(f"DeltaGeometry.limbs is {self.limbs!r}: give a tuple of three LimbAdjustment")

    def _check(self, name: str, low: float, high: float, unit: str) -> None:
        _check("DeltaGeometry", name, getattr(self, name), low, high, unit)

    def _check_box(self) -> None:
        for name in ("workspace_min", "workspace_max"):
            corner = getattr(self, name)
            if not isinstance(corner, Sequence) or isinstance(corner, str) or len(corner) != 3:
                raise ValueError(f"DeltaGeometry.{name} is {corner!r}: give x, y and z in m")
            for value in corner:
                _check("DeltaGeometry", name, value, -LONGEST, LONGEST, "m")
        if not all(low < high for low, high in zip(self.workspace_min, self.workspace_max, strict=True)):
            raise ValueError(
                f"DeltaGeometry.workspace_min {self.workspace_min!r} is not below workspace_max {self.workspace_max!r}"
            )

    @property
    def radius_difference(self) -> float:
        """base_radius − platform_radius, the D of the formulas (m)."""
        return self.base_radius - self.platform_radius

    def limb(self, index: int) -> Limb:
        """Return the numbers of limb `index` (0, 1 or 2), its adjustment applied."""
        own = self.limbs[index]
        cosine, sine = LIMB_DIRECTIONS[index]
        return Limb(
            cosine,
            sine,
            self.base_radius,
            self.platform_radius,
            own.radius_offset,
            own.tangential_offset,
            self.z_offset,
            own.height_offset,
            self.arm if own.arm is None else own.arm,
            self.rod if own.rod is None else own.rod,
            own.angle_offset,
        )

    def with_values(self, **changes: Any) -> DeltaGeometry:
        """Return a copy with some fields changed.

        Raises:
            ValueError: a name is not a field, or the new value is refused.
        """
        unknown = set(changes) - {field.name for field in fields(self)}
        if unknown:
            raise ValueError(f"DeltaGeometry has no field {sorted(unknown)}")
        return replace(self, **changes)
