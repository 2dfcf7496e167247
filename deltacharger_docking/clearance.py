# SPDX-License-Identifier: Apache-2.0
"""When may current flow: the distance between a charger bar and the wrong bar of the target.

Both terminals carry two parallel bars, 2h long, with a gap of 2g between them. Turned by an angle about the midpoint
and shifted by v across the target's bars, the nearest corner of a charger bar keeps a distance of
c(angle, v) = g (1 + cos angle) − h |sin angle| − |v| from the opposite bar. With g = 3.7 mm and h = 35 mm it vanishes
at 12.07° for v = 0 and already at 3.9° for v = 5 mm; the sizes were chosen for the paper's critical angle, 12°.

v = y cos angle − x sin angle is what the pads feel best: a lean of the faces, which they take for an offset along the
bars, leaks into y but not into v.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from enum import Enum
from typing import Any

from deltacharger_docking.parameters import DockingParameters


@dataclass(frozen=True)
class MisalignmentClasses:
    """Centres of the paper's most probable classes; NaN where an axis has none.

    Attributes:
        angle: rad, of the size of the angle: 0, 1, … 5°, so that nothing above 5° is ever told.
        vertical: m along y: −10, −5, 0, 5 or 10 mm.
        horizontal: m along x, likewise.
    """

    angle: float
    vertical: float
    horizontal: float


@dataclass(frozen=True)
class FeltPose:
    """Misalignment as felt: pose of the target in end_effector with standard deviations (rad, m).

    Beside the pose, where they were asked for, stand the paper's classes; None = not told. `across` is the offset
    across the target's bars (m), forces are sums over each pad (N), yaw and pitch lean the target's faces; NaN = not
    told.
    """

    angle: float
    angle_stddev: float
    vertical: float
    vertical_stddev: float
    horizontal: float
    horizontal_stddev: float
    contact: bool = True
    sure: bool = True
    in_range: bool = True
    classes: MisalignmentClasses | None = None
    left_force: float = math.nan
    right_force: float = math.nan
    across: float = math.nan
    across_stddev: float = math.nan
    yaw: float = math.nan
    yaw_stddev: float = math.nan
    pitch: float = math.nan
    pitch_stddev: float = math.nan

    @classmethod
    def of(cls, told: Any, classes: MisalignmentClasses | None = None) -> FeltPose:
        """Return the values of an estimate or message; what it does not have is not told."""
        names = (item.name for item in fields(cls) if item.name != "classes")
        return cls(**{name: getattr(told, name) for name in names if hasattr(told, name)}, classes=classes)

    def __post_init__(self) -> None:
        """Work out the offset across the bars where nobody told it, as if both errors were independent.

        One without an error is what a publisher leaves that does not know the field: it must not pass for exact.
        """
        if math.isnan(self.across) or not self.across_stddev > 0.0:
            cosine, sine = math.cos(self.angle), math.sin(self.angle)
            spread = math.hypot(cosine * self.vertical_stddev, sine * self.horizontal_stddev)
            object.__setattr__(self, "across", cosine * self.vertical - sine * self.horizontal)
            object.__setattr__(self, "across_stddev", spread)

    def is_of(self, other: FeltPose) -> bool:
        """Return whether both are of the same frames, by values that docking never changes."""
        pairs = ((getattr(self, name), getattr(other, name)) for name in ("angle", "across", "left_force", "sure"))
        return all(one == two or (one != one and two != two) for one, two in pairs)  # NaN is of the same frames, too

    @property
    def stddevs(self) -> tuple[float, float, float]:
        """Standard deviations of angle (rad), vertical and horizontal (m)."""
        return self.angle_stddev, self.vertical_stddev, self.horizontal_stddev

    @property
    def numbers(self) -> dict[str, float]:
        """What was felt, by names that end in the unit."""
        told: dict[str, float] = {}
        for name, unit in (("angle", "rad"), ("vertical", "m"), ("horizontal", "m"), ("across", "m")):
            told |= {f"{name}_{unit}": getattr(self, name), f"{name}_stddev_{unit}": getattr(self, f"{name}_stddev")}
        return told

    @property
    def usable(self) -> bool:
        """Whether clearance may be judged by it."""
        return self.contact and self.sure and self.in_range and self.complete and min(self.stddevs) >= 0.0

    @property
    def complete(self) -> bool:
        """Whether every number is finite."""
        poses = self.angle, self.vertical, self.horizontal, self.across, self.across_stddev
        return all(map(math.isfinite, (*poses, *self.stddevs)))


class Verdict(Enum):
    """What an estimate allows."""

    SAFE = "safe at six standard deviations"
    PROBABLY_SAFE = "safe at three standard deviations"
    TOO_CLOSE = "the offset across the bars leaves no clearance"
    CRITICAL = "the angle leaves no clearance even without an offset across the bars"

    @property
    def leaves_clearance(self) -> bool:
        """Whether `clearance_sigmas` standard deviations do."""
        return self in (Verdict.SAFE, Verdict.PROBABLY_SAFE)


def clearance(angle: float, across: float, half_gap: float, half_length: float) -> float:
    """Return the clearance (m); negative where a charger bar touches the wrong target bar."""
    return half_gap * (1.0 + math.cos(angle)) - half_length * abs(math.sin(angle)) - abs(across)


def clearance_stddev(estimate: FeltPose, half_gap: float, half_length: float) -> float:
    """Return the standard deviation (m) of the clearance to first order in the errors of angle and offset across."""
    slope = half_gap * abs(math.sin(estimate.angle)) + half_length * math.cos(estimate.angle)
    return math.hypot(slope * estimate.angle_stddev, estimate.across_stddev)


def pitch_shift(estimate: FeltPose, parameters: DockingParameters) -> float:
    """Return by how much (m) a pitch that is known may shift what the pads feel across the bars; 0 where unknown.

    An unknown one is in the estimate's own error: its model has learnt from contacts that lean.
    """
    pitch = abs(estimate.pitch) + parameters.lean_sigmas * estimate.pitch_stddev
    return parameters.pitch_shift * pitch if math.isfinite(pitch) else 0.0


def judge(estimate: FeltPose, parameters: DockingParameters, critical_angle: float | None = None) -> Verdict:
    """Decide what `estimate` allows.

    Args:
        estimate: complete and sure.
        parameters: terminal geometry, the clearance to keep and the critical angle.
        critical_angle: a lower limit (rad) than the parameter's.
    """
    gap, length = parameters.electrode_half_gap, parameters.electrode_half_length
    limit = parameters.critical_angle if critical_angle is None else min(critical_angle, parameters.critical_angle)
    sigma = clearance_stddev(estimate, gap, length)
    shifted = abs(estimate.across) + pitch_shift(estimate, parameters)
    centred = clearance(estimate.angle, 0.0, gap, length)
    actual = clearance(estimate.angle, shifted, gap, length)
    worst_angle = abs(estimate.angle) + parameters.clearance_sigmas * estimate.angle_stddev
    if worst_angle >= limit or centred - parameters.clearance_sigmas * sigma < parameters.clearance_min:
        return Verdict.CRITICAL
    if actual - parameters.clearance_sigmas * sigma < parameters.clearance_min:
        return Verdict.TOO_CLOSE
    if actual - parameters.clearance_sigmas_sure * sigma < parameters.clearance_min:
        return Verdict.PROBABLY_SAFE
    return Verdict.SAFE
