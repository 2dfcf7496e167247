# SPDX-License-Identifier: Apache-2.0
"""Motion and measurements of the emulated servos: modes, offsets, limits, status, watchdog."""

from __future__ import annotations

import pytest

from deltacharger_core.machine import POSITION_P_GAIN, SERVO_STIFFNESS
from deltacharger_driver.servos.control_table import LIMIT, OK
from deltacharger_driver.servos.mx64 import CURRENT_UNIT, TICK

from .servo_host import Host


def test_measurements_in_register_units(host: Host) -> None:
    host.write(1, "operating_mode", 5)
    host.write(1, "torque_enable", 1)
    host.arm.load[0] = -0.6
    host.advance(2.0)
    assert host.read(1, "present_position") == 2048 + round(host.arm.angles[0] / TICK)
    assert host.read(1, "present_current") * CURRENT_UNIT == pytest.approx(0.41, abs=0.01)
    assert host.read(1, "input_voltage") == 120
    assert host.read(1, "temperature") == 30


def test_the_goal_is_held_within_the_goal_current(host: Host) -> None:
    host.write(2, "operating_mode", 5)
    assert host.arm.commands[1] is None or not host.arm.commands[1][0]
    host.write(2, "goal_current", 100)
    host.write(2, "torque_enable", 1)
    on, reference, limit, _ = host.arm.commands[1]
    assert on
    assert reference == pytest.approx(-0.7, abs=TICK)
    assert limit == pytest.approx(100 * CURRENT_UNIT)
    host.write(2, "goal_position", 2048 + 100)
    assert host.arm.commands[1][1] == pytest.approx(100 * TICK)


def test_the_position_p_gain_is_the_stiffness(host: Host) -> None:
    goal = host.read(1, "present_position")
    host.write(1, "operating_mode", 5)
    host.write(1, "goal_position", goal)
    host.write(1, "torque_enable", 1)
    host.arm.load[0] = -0.6

    def yielded(gain: int) -> float:
        host.write(1, "position_p_gain", gain)
        host.advance(3.0)
        return (goal - 2048) * TICK - host.arm.angles[0]

    usual = yielded(POSITION_P_GAIN)
    assert usual == pytest.approx(0.6 / SERVO_STIFFNESS, rel=1e-3)
    assert yielded(POSITION_P_GAIN // 2) == pytest.approx(2.0 * usual, rel=1e-3)
    assert yielded(2 * POSITION_P_GAIN) == pytest.approx(0.5 * usual, rel=1e-3)


def test_the_homing_offset_is_added_to_positions_and_subtracted_from_goals(host: Host) -> None:
    host.write(1, "operating_mode", 5)
    actual = host.read(1, "present_position")
    assert host.write(1, "homing_offset", 300) == OK
    assert host.read(1, "present_position") == actual + 300
    host.write(1, "torque_enable", 1)
    host.write(1, "goal_position", actual + 300 + 50)
    host.advance(2.0)
    assert host.read(1, "present_position") == pytest.approx(actual + 350, abs=1)
    assert host.arm.angles[0] == pytest.approx((actual + 50 - 2048) * TICK, abs=2 * TICK)


def test_mode_3_ignores_a_homing_offset_beyond_a_quarter_turn(host: Host) -> None:
    actual = host.read(1, "present_position")
    for offset, heeded in ((1024, True), (1025, False), (-1024, True), (-1025, False)):
        assert host.write(1, "homing_offset", offset) == OK
        assert host.read(1, "present_position") == actual + offset * heeded
    host.write(1, "operating_mode", 5)
    assert host.read(1, "present_position") == actual - 1025


def test_mode_3_keeps_goals_within_its_limits_and_the_other_modes_do_not(host: Host) -> None:
    assert host.write(1, "min_position", 1000) == OK
    assert host.write(1, "max_position", 3000) == OK
    for goal, error in ((999, LIMIT), (1000, OK), (3000, OK), (3001, LIMIT), (-1, LIMIT)):
        assert host.write(1, "goal_position", goal) == error
    for mode in (4, 5):
        assert host.write(1, "operating_mode", mode) == OK
        assert host.write(1, "goal_position", -5000) == OK


def test_moving_and_moving_status_follow_a_move(host: Host) -> None:
    host.write(1, "operating_mode", 5)
    assert (host.read(1, "moving"), host.read(1, "moving_status")) == (0, 0)
    host.write(1, "torque_enable", 1)
    host.advance(0.5)  # from between two counts to the nearest
    assert (host.read(1, "moving"), host.read(1, "moving_status")) == (0, 0b0001)  # in position
    host.write(1, "goal_position", host.read(1, "present_position") + 1000)
    host.advance(0.02)
    assert (host.read(1, "moving"), host.read(1, "moving_status")) == (1, 0b1000)  # far from the goal
    host.advance(10.0)
    assert (host.read(1, "moving"), host.read(1, "moving_status")) == (0, 0b0001)


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
