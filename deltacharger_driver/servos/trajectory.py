# SPDX-License-Identifier: Apache-2.0
"""Joint trajectories: checks, and the goal at any instant. No ROS."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from deltacharger_core.host_clock import COMPARE_CLOCKS
from deltacharger_driver.errors import TrajectoryRefused

STALE_AFTER = 0.5  # s, age of a stamp beyond which a trajectory is refused
MOST_POINTS = 1000
"""Most points of a trajectory: 20 s of a line at the planner's spacing. Longer lines are sent in pieces."""
_QUOTED = 60  # characters of a sender's text that a message quotes


@dataclass(frozen=True)
class JointLimits:
    """Limits of a trajectory.

    Attributes:
        names: joint names, in the order of the servos.
        angle_min: smallest angle, rad.
        angle_max: largest angle, rad.
        torque_max: largest torque bound of a servo, N·m.
    """

    names: tuple[str, ...]
    angle_min: float
    angle_max: float
    torque_max: float


@dataclass(frozen=True)
class ServoWaypoint:
    """One point of a received trajectory, in the order of its joint names.

    Attributes:
        time: from the start, s.
        angles: rad.
        torques: bound of each servo from the start of the segment to this point, N·m; empty = unchanged.
    """

    time: float
    angles: Sequence[float]
    torques: Sequence[float] = ()


@dataclass(frozen=True)
class Trajectory:
    """Checked points in the order of the servos, times rising; without points: hold.

    Attributes:
        times: from the start, s.
        angles: rad, per point and servo.
        torques: bound, N·m, per point and servo; None = unchanged.
    """

    times: tuple[float, ...]
    angles: tuple[tuple[float, ...], ...]
    torques: tuple[tuple[float, ...] | None, ...]

    @property
    def is_hold(self) -> bool:
        """Whether it means: stay at the present goal."""
        return not self.times

    @property
    def duration(self) -> float:
        """Time of the last point, s."""
        return self.times[-1] if self.times else 0.0

    def goal_at(self, elapsed: float, start: tuple[float, ...]) -> tuple[float, ...]:
        """Return the goal angles `elapsed` s after the start: linear from `start` to the first point and on.

        Args:
            elapsed: s.
            start: goal angles when it began, rad.
        """
        elapsed = max(elapsed, 0.0)
        previous, since = start, 0.0
        for time, angles in zip(self.times, self.angles, strict=True):
            if elapsed < time:
                share = (elapsed - since) / (time - since)
                return tuple(a + share * (b - a) for a, b in zip(previous, angles, strict=True))
            previous, since = angles, time
        return previous

    def torque_at(self, elapsed: float) -> tuple[float, ...] | None:
        """Return the torque bound of each servo (N·m) at `elapsed` s; None if no point has set one yet.

        A point's bound holds from the time of the previous point, when the motion toward it begins.
        """
        bound: tuple[float, ...] | None = None
        since = 0.0
        for time, torques in zip(self.times, self.torques, strict=True):
            if elapsed < since:
                break
            if torques is not None:
                bound = torques
            since = time
        return bound

    def remaining(self, elapsed: float) -> Trajectory:
        """Return the rest after `elapsed` s as a trajectory that starts then; hold if nothing is left."""
        left = [index for index, time in enumerate(self.times) if time > elapsed]
        if not left:
            return HOLD
        first = left[0]
        return Trajectory(
            tuple(time - elapsed for time in self.times[first:]),
            self.angles[first:],
            (self.torque_at(elapsed), *self.torques[first + 1 :]),
        )


HOLD = Trajectory((), (), ())
"""Stay at the present goal."""


def check(names: Sequence[str], points: Sequence[ServoWaypoint], limits: JointLimits) -> Trajectory:
    """Return the trajectory of `points`, or refuse it entirely.

    Args:
        names: joint of each column, in any order.
        points: in the order of time; none = hold, which needs no names.
        limits: of angles and torque bounds.

    Raises:
        TrajectoryRefused: too many points; a joint unknown, repeated or missing; a number missing or not finite; an
            angle or torque bound outside its limits; or times that do not rise.
    """
    if len(points) > MOST_POINTS:
        raise TrajectoryRefused(f"it has {len(points)} points; send at most {MOST_POINTS} at once")
    if not points and not names:
        return HOLD
    order = _order(names, limits)
    times: list[float] = []
    angles: list[tuple[float, ...]] = []
    torques: list[tuple[float, ...] | None] = []
    for number, point in enumerate(points):
        where = f"point {number}"
        _check_time(where, point.time, times)
        times.append(point.time)
        angles.append(_row(f"{where}: angle", point.angles, order, limits, limits.angle_min, limits.angle_max, " rad"))
        bounded = len(point.torques) > 0
        torques.append(
            _row(f"{where}: effort", point.torques, order, limits, 0.0, limits.torque_max, " N·m") if bounded else None
        )
    return Trajectory(tuple(times), tuple(angles), tuple(torques))


def check_age(age: float) -> None:
    """Refuse a trajectory stamped `age` s ago; negative = in the future, NaN = invalid stamp.

    Raises:
        TrajectoryRefused: NaN, or more than `STALE_AFTER` in the past or future.
    """
    if age > STALE_AFTER:
        old = f"its stamp is {age:.2f} s old, more than {STALE_AFTER} s"
        raise TrajectoryRefused(f"{old}: stamp it with the time of sending, or not at all; {COMPARE_CLOCKS}")
    if math.isnan(age):
        raise TrajectoryRefused("its stamp is before 1970; use the ROS clock, or no stamp")
    if age < -STALE_AFTER:
        raise TrajectoryRefused(f"its stamp is {-age:.2f} s in the future; {COMPARE_CLOCKS}")


def _order(names: Sequence[str], limits: JointLimits) -> list[int]:
    """Return the column of each servo."""
    unknown = next((name for name in names if name not in limits.names), "")
    if unknown:
        raise TrajectoryRefused(f"unknown joint {unknown[:_QUOTED]!a}; known: {', '.join(limits.names)}")
    if sorted(names) != sorted(limits.names):
        given = ", ".join(names)[:_QUOTED]
        raise TrajectoryRefused(
            f"it names {len(names)} joints ({given}); name each of the {len(limits.names)} exactly once"
        )
    return [list(names).index(name) for name in limits.names]


def _check_time(where: str, time: float, before: list[float]) -> None:
    if not math.isfinite(time) or time < 0.0:
        raise TrajectoryRefused(f"{where}: time_from_start is {time:g} s; send a finite number ≥ 0")
    if before and time <= before[-1]:
        raise TrajectoryRefused(f"{where}: time_from_start {time:g} s does not rise above {before[-1]:g} s")


def _row(
    what: str,
    values: Sequence[float],
    order: list[int],
    limits: JointLimits,
    low: float,
    high: float,
    unit: str,
) -> tuple[float, ...]:
    if len(values) != len(order):
        raise TrajectoryRefused(f"{what}: {len(values)} numbers for {len(order)} joints")
    row = tuple(float(values[column]) for column in order)
    for name, value in zip(limits.names, row, strict=True):
        if not math.isfinite(value):
            raise TrajectoryRefused(f"{what} of {name} is {value}; send a finite number")
        if not low <= value <= high:
            raise TrajectoryRefused(f"{what} of {name} is {value:.4f}{unit}, outside {low:.4f}…{high:.4f}{unit}")
    return row
