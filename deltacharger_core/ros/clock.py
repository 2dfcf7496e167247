# SPDX-License-Identifier: Apache-2.0
"""A node's clock: stamps show the computer's clock or, with `use_sim_time`, /clock; all timing is monotonic."""

import math
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time as Stamp
from rclpy.clock import Clock, ROSClock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time

from deltacharger_core.real_time import HOST, HostClock
from deltacharger_core.ros.messages import seconds

NO_TIME_YET = "use_sim_time is set, but no message arrived on /clock: start its publisher, or set use_sim_time to false"
ANOTHER_CLOCK = 1e6
"""s; a stamp this old, or this far ahead, is from another clock."""
_RESTS = 0.1  # s of real time without a step until /clock is reported; a simulator steps at least 50 times a second
_BACK = 0.1  # s, smallest step back that is reported
_REMEMBERED = 2.0  # s that a step back is reported


def before_now(clock: Clock, ago: float) -> Any:
    """Return the stamp of `ago` s before now, but not before time 0 (before the first /clock, now is 0)."""
    moment = clock.now().nanoseconds - Duration(seconds=ago).nanoseconds
    return Time(nanoseconds=max(moment, 0), clock_type=clock.clock_type).to_msg()


def age(clock: Clock, stamp: float, host: HostClock = HOST) -> float:
    """Return the age (s) of a stamp (s) of a node's clock; negative = in the future. Nobody changes it by a step."""
    if follows(clock):
        return 1e-9 * float(clock.now().nanoseconds) - stamp
    return host.age(stamp)


def stamp_age(clock: Clock, stamp: Any) -> float:
    """Return the age (s) of a message's stamp, as `age`; NaN for a stamp before 1970."""
    return age(clock, seconds(stamp)) if stamp.sec >= 0 else math.nan


def follows(clock: Any) -> bool:
    """Return whether a clock follows /clock."""
    return isinstance(clock, ROSClock) and bool(clock.ros_time_is_active)


def steady_timer(node: Node, period: float, callback: Callable[[], None]) -> Any:
    """Return a timer of the node that runs in real time even while /clock stands still; `period` in s."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


class Stamps:
    """Converts times from the monotonic clock to a node's clock.

    Args:
        clock: clock of the node.
        host: clock of the computer.
    """

    def __init__(self, clock: Clock, host: HostClock = HOST) -> None:
        self._clock, self._host = clock, host

    def at(self, instant: float) -> Stamp:
        """Return the stamp of `instant` (s, monotonic)."""
        # An interruption between the clocks makes the stamp older, not younger.
        lead = (
            int(self._clock.now().nanoseconds - 1e9 * self._host.now()) if follows(self._clock) else self._host.lead()
        )
        sec, nanosec = divmod(max(int(instant * 1e9) + lead, 0), 1_000_000_000)
        return Stamp(sec=sec, nanosec=nanosec)


class ClockWatch:
    """Watches the clock of a node; for one thread.

    Attributes:
        stepped: time of its last detected step, s, monotonic; inf if the node does not follow /clock.
    """

    def __init__(self, clock: Clock, host: HostClock = HOST) -> None:
        self._host = host
        self._clock: Any = clock  # a ROS clock: every node's is
        self._seen = -1  # ns
        self._back_at, self._back_by = -math.inf, 0.0
        self.stepped = math.inf

    @property
    def has_no_time(self) -> bool:
        """Whether it follows /clock and has not received it yet."""
        return bool(self._clock.ros_time_is_active) and self._clock.now().nanoseconds == 0

    def look(self, now: float) -> None:
        """Check the clock; `now`: s, monotonic."""
        if not self._clock.ros_time_is_active:
            self._seen, self.stepped = -1, math.inf
            return
        time_now = self._clock.now().nanoseconds
        if time_now == self._seen:
            return
        if time_now < self._seen - _BACK * 1e9:
            self._back_at, self._back_by = now, (self._seen - time_now) * 1e-9
        self._seen, self.stepped = time_now, now

    def problem(self, now: float) -> str:
        """Return the error of /clock, or of the computer's clock if the node does not follow /clock; '' = none."""
        if math.isinf(self.stepped):
            return self._host.problem()
        if not self._seen:
            return NO_TIME_YET
        if now - self._back_at < _REMEMBERED:
            return f"/clock, which use_sim_time follows, went back by {self._back_by:.1f} s"
        rests = now - self.stepped
        if rests > _RESTS:
            return f"/clock, which use_sim_time follows, has stood still for {rests:.1f} s of real time"
        return ""
