# SPDX-License-Identifier: Apache-2.0
"""Condition for current: the distance between a charger bar and the wrong bar of the target.

Both terminals have two parallel bars, 2h long, with a gap of 2g between them. For a rotation by an angle about the
midpoint and a shift by v across the target's bars, the nearest corner of a charger bar has a distance of
c(angle, v) = g (1 + cos angle) − h |sin angle| − |v| from the opposite bar. With g = 3.7 mm and h = 35 mm it is zero
at 12.07° for v = 0, and at 3.9° for v = 5 mm. The sizes were chosen for the paper's critical angle, 12°.

The pads measure v = y cos angle − x sin angle best. They mistake a lean of the faces for an offset along the bars,
which changes y but not v.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from enum import Enum
from typing import Any

from deltacharger_core.texts import IN_TOUCH, untouchable
from deltacharger_docking.parameters import DockingParameters

# From leaning contacts of the world and of the pose model at up to 5°, then seed 5.
LEAN_SIGMAS = 2.0  # standard deviations by which a refused lean exceeds its limit
_PITCH_SHIFT = 0.0086  # m/rad, error across the bars per pitch: 0.15 mm per degree
# From the formula of the clearance, and a rate of unsafe acts by the normal distribution and its tails.
CLEARANCE_SIGMAS = 3.0  # standard deviations required before current flows
CLEARANCE_SIGMAS_SURE = 6.0  # standard deviations at which one contact is enough


@dataclass(frozen=True)
class MisalignmentEstimate:
    """Estimated misalignment: pose of the target in end_effector with standard deviations (rad, m).

    `across` is the offset across the target's bars (m), forces are sums over each pad (N), yaw and pitch are leans of
    the target's faces; NaN = unknown. `source` is the message that it came in; None = none.
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
    left_force: float = math.nan
    right_force: float = math.nan
    across: float = math.nan
    across_stddev: float = math.nan
    yaw: float = math.nan
    yaw_stddev: float = math.nan
    pitch: float = math.nan
    pitch_stddev: float = math.nan
    source: Any = field(default=None, compare=False, repr=False)

    @classmethod
    def of(cls, source: Any) -> MisalignmentEstimate:
        """Return the values of an estimate or message; fields that it lacks keep their defaults.

        Raises:
            ValueError: the pose is none in touch, such as one in millimetres or degrees.
        """
        if problem := untouchable(**{name: float(getattr(source, name)) for name in IN_TOUCH}):
            raise ValueError(problem)
        names = (item.name for item in fields(cls))
        return cls(**{name: getattr(source, name) for name in names if hasattr(source, name)})

    def __post_init__(self) -> None:
        """Calculate an unknown offset across the bars, as if both errors were independent.

        An offset with error 0 comes from a publisher that does not know the field, so it is also calculated.
        """
        if math.isnan(self.across) or not self.across_stddev > 0.0:
            cosine, sine = math.cos(self.angle), math.sin(self.angle)
            spread = math.hypot(cosine * self.vertical_stddev, sine * self.horizontal_stddev)
            object.__setattr__(self, "across", cosine * self.vertical - sine * self.horizontal)
            object.__setattr__(self, "across_stddev", spread)

    @property
    def stddevs(self) -> tuple[float, float, float]:
        """Standard deviations of angle (rad), vertical and horizontal (m)."""
        return self.angle_stddev, self.vertical_stddev, self.horizontal_stddev

    @property
    def numbers(self) -> dict[str, float]:
        """Its values, by names that end in the unit."""
        values: dict[str, float] = {}
        for name, unit in (("angle", "rad"), ("vertical", "m"), ("horizontal", "m"), ("across", "m")):
            values |= {f"{name}_{unit}": getattr(self, name), f"{name}_stddev_{unit}": getattr(self, f"{name}_stddev")}
        return values

    @property
    def usable(self) -> bool:
        """Whether clearance can be judged by it."""
        return self.contact and self.sure and self.in_range and self.complete and min(self.stddevs) >= 0.0

    @property
    def complete(self) -> bool:
        """Whether every number is finite."""
        poses = self.angle, self.vertical, self.horizontal, self.across, self.across_stddev
        return all(map(math.isfinite, (*poses, *self.stddevs)))


class Verdict(Enum):
    """What an estimate allows."""

    SAFE = "safe at CLEARANCE_SIGMAS_SURE standard deviations"
    PROBABLY_SAFE = "safe at CLEARANCE_SIGMAS standard deviations"
    TOO_CLOSE = "the offset across the bars leaves no clearance"
    CRITICAL = "the angle leaves no clearance even without an offset across the bars"

    @property
    def leaves_clearance(self) -> bool:
        """Whether it leaves clearance at CLEARANCE_SIGMAS standard deviations."""
        return self in (Verdict.SAFE, Verdict.PROBABLY_SAFE)


def clearance(angle: float, across: float, half_gap: float, half_length: float) -> float:
    """Return the clearance (m); negative if a charger bar touches the wrong target bar."""
    return half_gap * (1.0 + math.cos(angle)) - half_length * abs(math.sin(angle)) - abs(across)


def clearance_stddev(estimate: MisalignmentEstimate, half_gap: float, half_length: float) -> float:
    """Return the clearance's standard deviation (m), to first order in the errors of angle and offset across."""
    slope = half_gap * abs(math.sin(estimate.angle)) + half_length * math.cos(estimate.angle)
    return math.hypot(slope * estimate.angle_stddev, estimate.across_stddev)


def pitch_shift(estimate: MisalignmentEstimate) -> float:
    """Return the shift (m) that a known pitch may cause in the measured offset across the bars; 0 if unknown.

    An unknown pitch is part of the estimate's own error: its model was trained with leaning contacts.
    """
    pitch = abs(estimate.pitch) + LEAN_SIGMAS * estimate.pitch_stddev
    return _PITCH_SHIFT * pitch if math.isfinite(pitch) else 0.0


def least_clearance(estimate: MisalignmentEstimate, parameters: DockingParameters, sigmas: float) -> float:
    """Return the clearance (m) that is left at so many standard deviations."""
    gap, length = parameters.electrode_half_gap, parameters.electrode_half_length
    shifted = abs(estimate.across) + pitch_shift(estimate)
    return clearance(estimate.angle, shifted, gap, length) - sigmas * clearance_stddev(estimate, gap, length)


def limit_of(parameters: DockingParameters, critical_angle: float | None = None) -> float:
    """Return the critical angle (rad) that applies: the parameter's, or a goal's if that is lower; None = no goal's."""
    return parameters.critical_angle if critical_angle is None else min(critical_angle, parameters.critical_angle)


def reaches_limit(angle: float, parameters: DockingParameters, critical_angle: float, error: float = 0.0) -> bool:
    """Return whether an angle (rad) with this error reaches the critical one by itself; NaN does."""
    return not abs(angle) + error < limit_of(parameters, critical_angle)


def judge(
    estimate: MisalignmentEstimate, parameters: DockingParameters, critical_angle: float | None = None
) -> Verdict:
    """Return what `estimate` allows.

    Args:
        estimate: complete and sure.
        parameters: terminal geometry, the clearance to keep and the critical angle.
        critical_angle: a lower limit (rad) than the parameter's.
    """
    gap, length = parameters.electrode_half_gap, parameters.electrode_half_length
    limit = limit_of(parameters, critical_angle)
    sigma = clearance_stddev(estimate, gap, length)
    centred = clearance(estimate.angle, 0.0, gap, length)
    worst_angle = abs(estimate.angle) + CLEARANCE_SIGMAS * estimate.angle_stddev
    # Written so that NaN never passes.
    if not (worst_angle < limit and centred - CLEARANCE_SIGMAS * sigma >= parameters.clearance_min):
        return Verdict.CRITICAL
    if not least_clearance(estimate, parameters, CLEARANCE_SIGMAS) >= parameters.clearance_min:
        return Verdict.TOO_CLOSE
    if not least_clearance(estimate, parameters, CLEARANCE_SIGMAS_SURE) >= parameters.clearance_min:
        return Verdict.PROBABLY_SAFE
    return Verdict.SAFE
