# SPDX-License-Identifier: Apache-2.0
"""The emulated servo's bus watchdog as the e-manual describes register 98."""

from __future__ import annotations

import pytest

from deltacharger_driver.servos.control_table import OK
from deltacharger_driver.servos.mx64 import TICK

from .servo_host import Host


def test_the_watchdog_is_active_only_while_torque_is_on(host: Host) -> None:
    host.write(1, "bus_watchdog", 6)
    host.advance(1.0)
    assert host.read(1, "bus_watchdog") == 6
    host.advance(1.0)
    assert host.write(1, "torque_enable", 1) == OK  # earlier silence does not count
    host.advance(0.115)
    assert host.read(1, "bus_watchdog") == 6
    host.advance(0.125)
    assert host.read(1, "bus_watchdog") == 255


def test_a_servo_without_torque_needs_no_tick_after_a_silence(host: Host) -> None:
    host.write(1, "bus_watchdog", 6)
    host.advance(1.0)
    assert host.bus.next_event(host.now) > 1.0


@pytest.mark.parametrize("offset", [0, 500])
def test_a_trip_sets_the_goal_to_the_present_angle(host: Host, offset: int) -> None:
    host.write(1, "homing_offset", offset)
    host.write(1, "operating_mode", 5)
    host.write(1, "goal_current", 100)
    host.write(1, "bus_watchdog", 6)
    host.write(1, "torque_enable", 1)
    host.write(1, "goal_position", 2048 + offset)
    host.advance(0.119)
    assert host.arm.commands[0][1] == pytest.approx(0.0, abs=TICK)
    host.advance(0.002)
    (_, reference, *_), angle = host.arm.commands[0], host.arm.angles[0]
    assert reference < -0.1
    host.advance(1.0)
    assert host.arm.commands[0][1] == reference
    assert reference == pytest.approx(angle, abs=TICK)
