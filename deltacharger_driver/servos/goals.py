# SPDX-License-Identifier: Apache-2.0
"""Goals and current bounds of the servos in each cycle, from a trajectory. No ROS."""

from __future__ import annotations

import math
from collections.abc import Sequence

from deltacharger_driver.servos.trajectory import Trajectory


class ServoGoals:
    """Goal angle and current bound of each servo; used by one thread.

    Args:
        count: of servos.
        current_bound: of each servo if a trajectory sets none, A.
        torque_constant: N·m/A, converts a trajectory's torque bound into a current.

    Attributes:
        angles: rad; NaN before the first `begin_at`.
        bounds: A.
    """

    def __init__(self, count: int, current_bound: float, torque_constant: float) -> None:
        self.default = (current_bound,) * count
        self.angles: tuple[float, ...] = (math.nan,) * count
        self.bounds = self.default
        self._torque_constant = torque_constant
        self._running: tuple[Trajectory, tuple[float, ...], float] | None = None  # trajectory, start angles, start time

    @property
    def are_moving(self) -> bool:
        """Whether a trajectory is running."""
        return self._running is not None

    def begin_at(self, angles: tuple[float, ...]) -> None:
        """Hold `angles` (rad) with the default bounds."""
        self.angles, self.bounds, self._running = angles, self.default, None

    def hold(self, angles: Sequence[float]) -> None:
        """Hold `angles` (rad) without raising the bounds; a servo whose angle is NaN keeps its goal."""
        self._running = None
        self.angles = tuple(
            goal if math.isnan(angle) else angle for angle, goal in zip(angles, self.angles, strict=True)
        )
        self.bounds = tuple(map(min, self.bounds, self.default))

    def follow(self, trajectory: Trajectory, start: float, now: float) -> None:
        """Replace the running trajectory: move from the present goal to the first point that is not in the past.

        The last point holds.

        Args:
            trajectory: without points: hold the present goal.
            start: time zero of the trajectory, s; if later than `now`, `now` is used.
            now: s.
        """
        self.advance(now)  # if a piece of a line arrives in every cycle, it must not start from the last cycle's goal
        self._running = None
        # A raised bound must not outlive its trajectory: a release must not leave 2.8 A behind.
        if trajectory.is_hold:
            self.bounds = tuple(map(min, self.bounds, self.default))
        else:
            elapsed = max(now - start, 0.0)
            if elapsed < trajectory.times[0]:
                trajectory, elapsed = trajectory.remaining(elapsed), 0.0
            self._running = (trajectory, self.angles, now - elapsed)
            self.bounds = self.default

    def advance(self, now: float) -> None:
        """Update goal and bounds for `now` (s) from the running trajectory."""
        if self._running is None:
            return
        trajectory, start, since = self._running
        elapsed = now - since
        self.angles = trajectory.goal_at(elapsed, start)
        torque = trajectory.torque_at(elapsed)
        if torque is not None:
            self.bounds = tuple(value / self._torque_constant for value in torque)
        if elapsed >= trajectory.duration:
            self._running = None

    def resume_at(self, angles: Sequence[float], now: float) -> None:
        """Start the rest of the trajectory at `angles` (rad) now, so that no servo jumps to catch up."""
        running = self._running
        self.hold(angles)
        if running is not None:
            trajectory, _, since = running
            rest = trajectory.remaining(now - since)
            self._running = None if rest.is_hold else (rest, self.angles, now)
