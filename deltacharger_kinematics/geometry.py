# SPDX-License-Identifier: Apache-2.0
"""Dimensions and limits of the inverted delta, YAML files of them, and the status of each solved point."""

import dataclasses
import math
from dataclasses import dataclass
from enum import IntFlag
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

from deltacharger_core import files, machine, parameters, texts, yaml_file
from deltacharger_core.parameters import number, numbers

Vector = tuple[float, float, float]

LIMB_COUNT = 3
# Azimuths 0, 120, 240° from +x toward +y: cosine and sine, exact in double precision.
LIMB_DIRECTIONS: tuple[tuple[float, float], ...] = (
    (1.0, 0.0),
    (-0.5, math.sqrt(3.0) / 2.0),
    (-0.5, -math.sqrt(3.0) / 2.0),
)
SHORTEST, LONGEST = 1e-6, 1e6  # m; products of four lengths neither underflow nor overflow


@dataclass(frozen=True)
class LimbAdjustment(parameters.Bounded):
    """Calibrated differences of one limb from the common dimensions (m, rad).

    Attributes:
        arm: length of this arm; None = the common length.
        rod: length of this rod; None = the common length.

    Raises:
        ParameterError: names the field; a length is not positive, or a number is not finite or out of bounds.
    """

    # The two radii are not separately observable.
    radius_offset: float = number(0.0, -LONGEST, LONGEST, "m", "added to base_radius − platform_radius")
    tangential_offset: float = number(0.0, -LONGEST, LONGEST, "m", "limb plane's offset, counter-clockwise about z")
    height_offset: float = number(0.0, -LONGEST, LONGEST, "m", "offset of the motor axis toward +z")
    arm: float | None = number(None, SHORTEST, LONGEST, "m", "length of this arm")
    rod: float | None = number(None, SHORTEST, LONGEST, "m", "length of this rod")
    angle_offset: float = number(0.0, -math.pi, math.pi, "rad", "true arm angle minus the commanded one")


class Limb(NamedTuple):
    """Dimensions of one limb with its adjustment applied, as the formulas use them (m, rad)."""

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
        """D of the formulas: base radius − platform radius + radius offset."""
        return self.base_radius - self.platform_radius + self.radius_offset

    @property
    def motor_height(self) -> float:
        """w − z: z_offset − height offset."""
        return self.z_offset - self.height_offset


@dataclass(frozen=True)
class DeltaGeometry(parameters.Bounded):
    """Dimensions (m, kg, rad) of the delta; the defaults reach the complete published workspace.

    The paper states the workspace (±60, ±60, 0…110 mm) and the platform's mass (274 g) but no link lengths, so every
    length is a parameter. Only ``base_radius - platform_radius`` enters the kinematics. Half of a rod pair's mass moves
    with the platform and half with the elbow.

    Attributes:
        limbs: calibrated adjustments of limbs 0, 1 and 2.

    Raises:
        ParameterError: names the field; a length is not positive and finite, or a lower limit is not below the upper
            limit.
    """

    base_radius: float = number(0.055, SHORTEST, LONGEST, "m", "radius of the motor axes on the setup ring")
    arm: float = number(0.100, SHORTEST, LONGEST, "m", "driven link, motor axis to elbow")
    rod: float = number(0.180, SHORTEST, LONGEST, "m", "passive link, elbow to platform joint")
    platform_radius: float = number(0.050, SHORTEST, LONGEST, "m", "radius of the rods' joints on the platform")
    z_offset: float = number(0.095, -LONGEST, LONGEST, "m", "distance from the motor plane to z = 0 of charger_base")
    joint_min: float = number(machine.JOINT_MIN, -math.pi, math.pi, "rad", "smallest arm angle")
    joint_max: float = number(machine.JOINT_MAX, -math.pi, math.pi, "rad", "largest arm angle")
    workspace_min: tuple[float, float, float] = numbers(
        (-0.060, -0.060, 0.0), -LONGEST, LONGEST, "m", "lower corner of the workspace in charger_base, x, y, z"
    )
    workspace_max: tuple[float, float, float] = numbers(
        (0.060, 0.060, 0.110), -LONGEST, LONGEST, "m", "upper corner of the workspace in charger_base, x, y, z"
    )
    swing_max: float = number(
        math.radians(32.0), 1e-6, math.pi / 2, "rad", "largest angle between a rod and its arm's plane"
    )
    platform_mass: float = number(0.274, 0.0, 1e6, "kg", "mass of the end effector with electrodes, magnets and pads")
    rod_mass: float = number(0.030, 0.0, 1e6, "kg", "mass of one rod pair")
    limbs: tuple[LimbAdjustment, LimbAdjustment, LimbAdjustment] = (
        LimbAdjustment(),
        LimbAdjustment(),
        LimbAdjustment(),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.joint_min < self.joint_max:
            raise parameters.ParameterError(
                "joint_min", self.joint_min, f"{files.brief(self.joint_min)} is not below joint_max"
            )
        if not all(low < high for low, high in zip(self.workspace_min, self.workspace_max, strict=True)):
            raise parameters.ParameterError(
                "workspace_min", self.workspace_min, f"{files.brief(self.workspace_min)} is not below workspace_max"
            )
        if not isinstance(self.limbs, tuple) or [type(limb) for limb in self.limbs] != LIMB_COUNT * [LimbAdjustment]:
            raise parameters.ParameterError(
                "limbs", self.limbs, f"{files.brief(self.limbs)}: give a tuple of three LimbAdjustment"
            )

    def limb(self, index: int) -> Limb:
        """Return the dimensions of limb `index` (0, 1 or 2) with its adjustment applied."""
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


LARGEST = 1.0  # m; a longer arm was written in millimetres


def load_geometry(path: str | Path) -> DeltaGeometry:
    """Read a geometry file; errors as in `read_declared`."""
    geometry = yaml_file.read_declared(path, DeltaGeometry)
    lengths = {name: getattr(geometry, name) for name in ("base_radius", "arm", "rod", "platform_radius", "z_offset")}
    far = max(map(abs, (*geometry.workspace_min, *geometry.workspace_max)))
    for name, value in (*lengths.items(), ("workspace_min and workspace_max", far)):
        if problem := texts.outside(value, -LARGEST, LARGEST, "m"):
            raise yaml_file.YamlError(path, f"'{name}': {problem}")
    return geometry


def save_geometry(geometry: DeltaGeometry, path: str | Path, comment: str = "") -> None:
    """Write `geometry` with every key and every digit, with `comment` above it.

    Raises:
        OSError: the file cannot be written.
    """
    yaml_file.write_yaml(path, geometry_to_mapping(geometry), comment)


def geometry_to_mapping(geometry: DeltaGeometry) -> dict[str, Any]:
    """Return `geometry` as plain numbers, lists and mappings, without default values of limbs."""
    mapping = dataclasses.asdict(geometry)
    neutral = dataclasses.asdict(LimbAdjustment())
    mapping["limbs"] = [
        {key: float(value) for key, value in limb.items() if value != neutral[key]} for limb in mapping["limbs"]
    ]
    return {key: float(value) if isinstance(value, Real) else value for key, value in mapping.items()}


class Status(IntFlag):
    """Bit mask per point; 0 is OK. The two .srv files define the same constants.

    With INVALID_INPUT, UNREACHABLE_*, INDETERMINATE, NOT_ASSEMBLABLE and DEGENERATE the result is NaN; with all others
    it is usable.
    """

    OK = 0
    INVALID_INPUT = 1
    UNREACHABLE_FAR = 2
    UNREACHABLE_NEAR = 4
    UNREACHABLE_LATERAL = 8
    NOT_ASSEMBLABLE = 16
    DEGENERATE = 32
    INDETERMINATE = 64
    WRONG_ASSEMBLY = 128
    NEAR_TYPE_1 = 256
    NEAR_TYPE_2 = 512
    JOINT_LIMIT = 1024
    SWING_LIMIT = 2048
    OUTSIDE_WORKSPACE = 4096
    LIMB_0 = 65536
    LIMB_1 = 131072
    LIMB_2 = 262144


UNREACHABLE = Status.UNREACHABLE_FAR | Status.UNREACHABLE_NEAR | Status.UNREACHABLE_LATERAL
NO_ANSWER = UNREACHABLE | Status.INVALID_INPUT | Status.INDETERMINATE | Status.NOT_ASSEMBLABLE | Status.DEGENERATE

NEAR_TYPE_1 = 0.02  # of the arm length: lever |b| below which a limb counts as nearly stretched or folded
NEAR_TYPE_2 = 0.02  # |det| of the unit rod vectors below which the platform counts as nearly unconstrained
COLLINEAR = 1e-12  # of rod or elbow distance: height of the elbows' triangle below which they count as collinear
