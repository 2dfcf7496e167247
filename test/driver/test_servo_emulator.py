# SPDX-License-Identifier: Apache-2.0
"""The emulated servos against the e-manual, byte by byte in simulated time."""

from __future__ import annotations

import pytest

from deltacharger_core.machine import POSITION_D_GAIN, POSITION_P_GAIN, SERVO_STIFFNESS
from deltacharger_core.servo_types import MX_64
from deltacharger_driver.emulators import servo as table
from deltacharger_driver.emulators.servo import LIMIT, OK
from deltacharger_driver.packets import ACTION, BROADCAST, PING, READ, REG_WRITE, SYNC_READ, WRITE
from deltacharger_driver.servos.registers import REGISTERS, TICK, indirect_address, indirect_data

from .servo_host import Host, parse, words


def test_every_kind_of_rejection_has_its_number(host: Host) -> None:
    assert host.write(1, "present_position", 1) == table.ACCESS
    assert host.write(1, "torque_enable", 2) == table.RANGE
    assert host.write(1, "operating_mode", 2) == table.RANGE
    assert host.write(1, "goal_position", 5000) == LIMIT  # mode 3 has limits
    assert host.write(1, "current_limit", 100) == OK
    assert host.write(1, "goal_current", 101) == LIMIT
    ((_, error, _),) = host.ask(1, WRITE, words(116) + b"\1\2")
    assert error == table.LENGTH
    ((_, error, _),) = host.ask(1, 0x77)
    assert error == table.INSTRUCTION
    assert parse(host.bus.receive(Host.packet(1, PING)[:-1] + b"\0", host.now))[0][1] == table.CHECKSUM
    assert host.ask(1, READ, words(600, 200))[0][1] == table.ACCESS


def test_a_refused_write_changes_nothing(host: Host) -> None:
    before = host.read(1, "goal_velocity"), host.read(1, "goal_current")
    ((_, error, _),) = host.ask(1, WRITE, words(102) + words(50) + (9999).to_bytes(4, "little"))
    assert error in (table.RANGE, LIMIT)
    assert (host.read(1, "goal_velocity"), host.read(1, "goal_current")) == before


def test_registered_writes_wait_for_action(host: Host) -> None:
    assert host.write(1, "led", 1, REG_WRITE) == OK
    assert host.read(1, "led") == 0
    assert host.read(1, "registered") == 1
    assert host.ask(1, ACTION) == [(1, OK, b"")]
    assert host.read(1, "led") == 1
    assert host.ask(1, ACTION)[0][1] == table.RESULT_FAIL


def test_sync_read_answers_in_the_requested_order_and_stops_at_a_missing_servo(host: Host) -> None:
    request = words(132, 4)
    assert [reply[0] for reply in host.ask(BROADCAST, SYNC_READ, request + bytes((3, 1, 2)))] == [3, 1, 2]
    host.bus.faults.missing = {1}
    assert [reply[0] for reply in host.ask(BROADCAST, SYNC_READ, request + bytes((3, 1, 2)))] == [3]


def test_indirect_registers_read_and_write_what_they_point_to(host: Host) -> None:
    targets = [116, 117, 118, 119, 70, 146]
    assert host.ask(1, WRITE, words(indirect_address(0), *targets))[0][1] == OK
    host.write(1, "operating_mode", 5)
    ticks = (-300).to_bytes(4, "little", signed=True)
    assert host.ask(1, WRITE, words(indirect_data(0)) + ticks)[0][1] == OK
    assert host.read(1, "goal_position") == -300
    assert host.ask(1, READ, words(indirect_data(0), 6))[0][2] == ticks + bytes((0, 30))
    assert host.ask(1, WRITE, words(indirect_data(0)) + ticks[:2])[0][1] == table.LENGTH
    assert host.ask(1, WRITE, words(indirect_data(4)) + b"\0")[0][1] == table.ACCESS
    assert host.ask(1, WRITE, words(indirect_address(0), 8))[0][1] == table.RANGE  # EEPROM cannot be a target


def test_the_return_delay_and_the_wire_delay_the_reply() -> None:
    host = Host(paced=True)
    host.bus.servo(1).table.set("return_delay", 250)
    assert host.send(1, PING) == b""
    on_wire = (10 + 14) * 10e-6
    assert host.advance(500e-6 + on_wire - 20e-6) == b""
    assert host.advance(40e-6)


def test_servos_receive_only_at_their_own_speed() -> None:
    speed = [57600]
    host = Host(line_speed=lambda: speed[0])
    assert host.ask(1, PING) == []
    host.bus.set_speed(2, 1)
    assert [reply[0] for reply in host.ask(BROADCAST, PING)] == [2]
    speed[0] = 1_000_000
    assert [reply[0] for reply in host.ask(BROADCAST, PING)] == [1, 3]


def test_noise_and_truncated_packets_are_skipped(host: Host) -> None:
    good = Host.packet(1, PING)
    assert host.bus.receive(b"\x00\xff\xff" + b"\xff\xff\xfd" + b"junk" + good, host.now)
    for cut in range(1, len(good)):
        host.advance(0.1)  # an incomplete packet is discarded
        host.bus.receive(good[:cut], host.now)
        host.advance(0.1)
        assert parse(host.bus.receive(good, host.now)), cut
    host.advance(0.1)
    received = b""
    for byte in good:
        received += host.bus.receive(bytes((byte,)), host.now)
    assert parse(received) == [(1, 0, bytes((0x37, 1, 45)))]


def test_a_checksum_that_completes_a_header_is_no_header(host: Host) -> None:
    host.write(1, "operating_mode", 5)
    completed = 0
    for goal in range(-1024, 0):  # all end in FF FF
        assert host.write(1, "goal_position", goal) == OK
        data = words(REGISTERS["goal_position"].address) + REGISTERS["goal_position"].to_bytes(goal)
        completed += Host.packet(1, WRITE, data)[-4:-1] == b"\xff\xff\xfd"
    assert completed


def test_the_goal_is_held_within_the_goal_current(host: Host) -> None:
    host.write(2, "operating_mode", 5)
    assert host.arm.commands[1] is None or not host.arm.commands[1][0]
    host.write(2, "goal_current", 100)
    host.write(2, "torque_enable", 1)
    on, reference, limit, *gains = host.arm.commands[1]
    assert on
    assert reference == pytest.approx(-0.7, abs=TICK)
    assert limit == pytest.approx(100 * MX_64.current_unit)
    assert gains == pytest.approx([850 / POSITION_P_GAIN, 0.0])  # relative to servo_node's; by default nothing brakes
    host.write(2, "goal_position", 2048 + 100)
    host.write(2, "position_d_gain", 2 * POSITION_D_GAIN)
    assert host.arm.commands[1][1::3] == pytest.approx((100 * TICK, 2.0))


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
