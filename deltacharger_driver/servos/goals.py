# SPDX-License-Identifier: Apache-2.0
"""Where the servos shall be from cycle to cycle, and how hard they may push: a trajectory and its end. No ROS."""

from __future__ import annotations

import math
from collections.abc import Sequence

from deltacharger_driver.servos.trajectory import Trajectory


class ServoGoals:
    """Goal angle and current bound of each servo; used by one thread.

    Args:
        count: of servos.
        current_bound: of each servo where a trajectory sets none, A.
        torque_constant: N·m/A, turns a trajectory's torque bound into a current.

    Attributes:
        angles: rad; NaN before the first `begin_at`.
        bounds: A.
    """

    def __init__(self, count: int, current_bound: float, torque_constant: float) -> None:
        self.default = (current_bound,) * count
        self.angles: tuple[float, ...] = (math.nan,) * count
        self.bounds = self.default
        self._torque_constant = torque_constant
        self._running: tuple[Trajectory, tuple[float, ...], float] | None = None  # what, from where, since when

    @property
    def are_moving(self) -> bool:
        """Whether a trajectory is under way."""
        return self._running is not None

    def begin_at(self, angles: tuple[float, ...]) -> None:
        """Hold `angles` (rad) with the default bounds."""
        self.angles, self.bounds, self._running = angles, self.default, None

    def hold(self, angles: Sequence[float]) -> None:
        """Hold `angles` (rad), pressing no harder than before; a servo whose angle is NaN keeps its goal."""
        self._running = None
        self.angles = tuple(
            goal if math.isnan(angle) else angle for angle, goal in zip(angles, self.angles, strict=True)
        )
        self.bounds = tuple(map(min, self.bounds, self.default))

    def follow(self, trajectory: Trajectory, start: float, now: float) -> None:
        """Let `trajectory` replace what runs: from the present goal to its first point, or where it is already by then.

        Its last point holds.

        Args:
            trajectory: without points it means: hold the present goal.
            start: from when its times count, s; a later instant than `now` counts as `now`.
            now: s.
        """
        self.advance(now)  # pieces of a line that come in every cycle must not each begin where the last cycle was
        self._running = None
        # Bounds of the past never outlive their trajectory upwards: a release must not leave 2.8 A behind.
        if trajectory.is_hold:
            self.bounds = tuple(map(min, self.bounds, self.default))
        else:
            elapsed = max(now - start, 0.0)
            if elapsed < trajectory.times[0]:
                trajectory, elapsed = trajectory.remaining(elapsed), 0.0
            self._running = (trajectory, self.angles, now - elapsed)
            self.bounds = self.default

    def advance(self, now: float) -> None:
        """Take goal and bounds of the instant `now` (s) from what runs."""
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
        """Let the rest of what runs start at `angles` (rad) now, so that nothing jumps to catch up."""
        running = self._running
        self.hold(angles)
        if running is not None:
            trajectory, _, since = running
            rest = trajectory.remaining(now - since)
            self._running = None if rest.is_hold else (rest, self.angles, now)
