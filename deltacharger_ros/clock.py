# SPDX-License-Identifier: Apache-2.0
"""What `use_sim_time` means here: stamps are of /clock, whatever is timed is timed by the monotonic clock."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time

NO_TIME_YET = (
    "use_sim_time is set and nothing was heard on /clock yet: start what publishes it, or set use_sim_time to false"
)
_RESTS = 0.1  # s of real time without a step from which /clock is named; a simulator steps 50 times a second and more
_BACK = 0.1  # s by which it goes back where it was set back
_REMEMBERED = 2.0  # s that a step back explains what went wrong


def before_now(clock: Clock, ago: float) -> Any:
    """Return the stamp of `ago` s before now; the beginning of time where that is later, as before the first /clock."""
    moment = clock.now().nanoseconds - Duration(seconds=ago).nanoseconds
    return Time(nanoseconds=max(moment, 0), clock_type=clock.clock_type).to_msg()


def steady_timer(node: Node, period: float, callback: Callable[[], None]) -> Any:
    """Return a timer of the node that runs by real time, also while /clock stands still; `period` in s."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


class ClockWatch:
    """Watches the clock of a node where it follows /clock; for one thread.

    Attributes:
        stepped: when it was last seen to go on, s, monotonic; inf where the node does not follow /clock.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock: Any = clock  # a ROS clock: every node's is
        self._told = -1  # ns
        self._back_at, self._back_by = -math.inf, 0.0
        self.stepped = math.inf

    @property
    def has_no_time(self) -> bool:
        """Whether it follows /clock and has not heard it yet."""
        return bool(self._clock.ros_time_is_active) and self._clock.now().nanoseconds == 0

    def look(self, now: float) -> None:
        """Look at it, `now` (s, monotonic)."""
        if not self._clock.ros_time_is_active:
            self._told, self.stepped = -1, math.inf
            return
        told = self._clock.now().nanoseconds
        if told == self._told:
            return
        if told < self._told - _BACK * 1e9:
            self._back_at, self._back_by = now, (self._told - told) * 1e-9
        self._told, self.stepped = told, now

    def problem(self, now: float) -> str:
        """Return what is wrong with it, '' where nothing is or the node does not follow /clock."""
        if math.isinf(self.stepped):
            return ""
        if not self._told:
            return NO_TIME_YET
        if now - self._back_at < _REMEMBERED:
            return f"/clock, which use_sim_time follows, went back by {self._back_by:.1f} s"
        rests = now - self.stepped
        if rests > _RESTS:
            return f"/clock, which use_sim_time follows, has stood still for {rests:.1f} s of real time"
        return ""
