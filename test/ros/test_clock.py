# SPDX-License-Identifier: Apache-2.0
"""Stamps show the computer's clock or /clock, whatever it does."""

import time

import pytest
from builtin_interfaces.msg import Time as Stamp
from rclpy.clock import Clock, ClockType, ROSClock
from rclpy.time import Time

from deltacharger_core.real_time import HostClock
from deltacharger_core.ros.clock import Stamps
from deltacharger_core.ros.messages import seconds

pytestmark = pytest.mark.ros


@pytest.mark.parametrize("step", [-5, 5])
def test_stamps_follow_a_step_of_the_computers_clock_at_once(step: int) -> None:
    shown = [1.79e9]  # s, the computer's clock
    stamps = Stamps(Clock(clock_type=ClockType.SYSTEM_TIME), HostClock(lambda: round(1e9 * shown[0]), lambda: 10**11))
    assert stamps.at(99.99) == Stamp(sec=1_789_999_999, nanosec=990_000_000)
    shown[0] += step
    assert stamps.at(99.99) == Stamp(sec=1_789_999_999 + step, nanosec=990_000_000)


def test_a_clock_that_follows_a_simulator_is_read_for_every_stamp() -> None:
    rate, clock = 0.5, ROSClock()
    stamps = Stamps(clock)
    clock._set_ros_time_is_active(True)
    begun = time.monotonic()
    for passed in (0.0, 0.01, 0.02, 5.0, 4.0):
        clock.set_ros_time_override(Time(nanoseconds=int(1e9 * (100.0 + rate * passed))))
        stamp = stamps.at(now := time.monotonic())
        spent = time.monotonic() - now
        assert seconds(stamp) == pytest.approx(100.0 + rate * passed, abs=spent + 1e-3)
    clock.set_ros_time_override(Time(nanoseconds=0))
    assert stamps.at(begun) == Stamp(), "before the first /clock there is no time"
