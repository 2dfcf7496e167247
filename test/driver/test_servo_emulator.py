"""The emulated servos, spoken to in bytes with a clock of our own: what the e-manual promises, they do."""

from __future__ import annotations

import itertools
import math
import random
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from deltacharger_driver.bench_arm import BenchArm
from deltacharger_driver.control_table import ACCESS, CHECKSUM, INSTRUCTION, LENGTH, LIMIT, OK, RANGE, RESULT_FAIL
from deltacharger_driver.errors import DriverError, HandshakeError
from deltacharger_driver.mx64 import (
    CURRENT_UNIT,
    REGISTERS,
    TICK,
    TORQUE_CONSTANT,
    VELOCITY_UNIT,
    indirect_address,
    indirect_data,
)
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.servo_bus import ServoBus
from deltacharger_driver.servo_controller import ServoController
from deltacharger_driver.servo_emulator import ServoBusEmulator
from deltacharger_driver.servo_faults import collide
from deltacharger_driver.servo_firmware import ServoFirmware
from deltacharger_driver.servo_packets import (
    ACTION,
    BROADCAST,
    BULK_READ,
    BULK_WRITE,
    FACTORY_RESET,
    HEADER,
    PING,
    READ,
    REBOOT,
    REG_WRITE,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
)
from deltacharger_driver.servo_protocol import crc16
from deltacharger_driver.servo_snapshot import BusSettings

OVERLOAD = 1 << 5


class Host:
    """Speaks to an emulator in packets, at instants of its own."""

    def __init__(self, **kwargs: Any) -> None:
        self.now = 100.0
        self.arm = BenchArm(clock=lambda: self.now)
        self.bus = ServoBusEmulator(self.arm, **kwargs)
        for servo in (1, 2, 3):
            self.bus.servo(servo).table.set("return_delay", 0)

    def advance(self, seconds: float) -> bytes:
        """Let time pass as a pseudo-terminal does, and return what came."""
        end, received = self.now + seconds, b""
        while (wait := self.bus.next_event(self.now)) <= end - self.now:
            self.now += max(wait, 1e-6)
            received += self.bus.poll(self.now)
        self.now = end
        return received + self.bus.poll(end)

    def send(self, servo: int, code: int, parameters: bytes = b"") -> bytes:
        return self.bus.receive(self.packet(servo, code, parameters), self.now)

    @staticmethod
    def packet(servo: int, code: int, parameters: bytes = b"") -> bytes:
        head = HEADER + bytes((servo,)) + (len(parameters) + 3).to_bytes(2, "little") + bytes((code,)) + parameters
        return head + crc16(head).to_bytes(2, "little")

    def ask(self, servo: int, code: int, parameters: bytes = b"") -> list[tuple[int, int, bytes]]:
        """Return (id, error, parameters) of each reply."""
        return parse(self.send(servo, code, parameters) or self.advance(0.002))

    def read(self, servo: int, name: str) -> int:
        register = REGISTERS[name]
        ((_, error, data),) = self.ask(servo, READ, words(register.address, register.size))
        assert error & 0x7F == OK
        return register.from_bytes(data)

    def write(self, servo: int, name: str, value: int, code: int = WRITE) -> int:
        register = REGISTERS[name]
        ((_, error, _),) = self.ask(servo, code, words(register.address) + register.to_bytes(value))
        return error & 0x7F


def words(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)


def parse(data: bytes) -> list[tuple[int, int, bytes]]:
    replies = []
    while data:
        assert data.startswith(HEADER)
        size = int.from_bytes(data[5:7], "little") + 7
        packet, data = data[:size], data[size:]
        assert crc16(packet[:-2]) == int.from_bytes(packet[-2:], "little")
        replies.append((packet[4], packet[8], packet[9:-2]))
    return replies


@pytest.fixture
def host() -> Host:
    return Host()


def test_ping_tells_the_model_and_broadcast_ping_finds_all(host: Host) -> None:
    assert host.ask(2, PING) == [(2, 0, bytes((0x37, 0x01, 45)))]
    assert [servo for servo, _, _ in host.ask(BROADCAST, PING)] == [1, 2, 3]
    assert host.ask(9, PING) == []


def test_they_come_as_from_the_factory_but_for_id_and_speed(host: Host) -> None:
    for name, register in REGISTERS.items():
        if name in ("id", "baud", "goal_position", "return_delay") or name.startswith(("present", "input", "temper")):
            continue
        assert host.read(3, name) == register.default, name
    assert host.read(3, "id") == 3
    assert ServoBusEmulator(BenchArm()).servo(1).table.get("return_delay") == 250


def test_eeprom_is_locked_while_torque_is_on(host: Host) -> None:
    assert host.write(1, "operating_mode", 5) == OK
    assert host.write(1, "torque_enable", 1) == OK
    assert host.write(1, "operating_mode", 3) == ACCESS
    assert host.write(1, "homing_offset", 7) == ACCESS
    assert host.write(1, "torque_enable", 0) == OK
    assert host.write(1, "operating_mode", 3) == OK


def test_every_kind_of_refusal_has_its_number(host: Host) -> None:
    assert host.write(1, "present_position", 1) == ACCESS
    assert host.write(1, "torque_enable", 2) == RANGE
    assert host.write(1, "operating_mode", 2) == RANGE
    assert host.write(1, "goal_position", 5000) == LIMIT  # mode 3 has limits
    assert host.write(1, "current_limit", 100) == OK
    assert host.write(1, "goal_current", 101) == LIMIT
    ((_, error, _),) = host.ask(1, WRITE, words(116) + b"\1\2")
    assert error == LENGTH
    ((_, error, _),) = host.ask(1, 0x77)
    assert error == INSTRUCTION
    assert parse(host.bus.receive(Host.packet(1, PING)[:-1] + b"\0", host.now))[0][1] == CHECKSUM
    assert host.ask(1, READ, words(600, 200))[0][1] == ACCESS


def test_a_refused_write_changes_nothing(host: Host) -> None:
    before = host.read(1, "goal_velocity"), host.read(1, "goal_current")
    ((_, error, _),) = host.ask(1, WRITE, words(102) + words(50) + (9999).to_bytes(4, "little"))
    assert error in (RANGE, LIMIT)
    assert (host.read(1, "goal_velocity"), host.read(1, "goal_current")) == before


def test_measurements_in_register_units(host: Host) -> None:
    host.write(1, "operating_mode", 5)
    host.write(1, "torque_enable", 1)
    host.arm.load[0] = -0.6
    host.advance(2.0)
    assert host.read(1, "present_position") == 2048 + round(host.arm.angles[0] / TICK)
    assert host.read(1, "present_current") * CURRENT_UNIT == pytest.approx(0.41, abs=0.01)
    assert host.read(1, "input_voltage") == 120
    assert host.read(1, "temperature") == 30


def test_torque_is_held_where_the_goal_is_and_the_goal_current_bounds_it(host: Host) -> None:
    host.write(2, "operating_mode", 5)
    assert host.arm.commands[1] is None or not host.arm.commands[1][0]
    host.write(2, "goal_current", 100)
    host.write(2, "torque_enable", 1)
    on, reference, limit = host.arm.commands[1]
    assert on
    assert reference == pytest.approx(-0.7, abs=TICK)
    assert limit == pytest.approx(100 * CURRENT_UNIT)
    host.write(2, "goal_position", 2048 + 100)
    assert host.arm.commands[1][1] == pytest.approx(100 * TICK)


def test_modes_without_a_position_loop_give_no_torque(host: Host) -> None:
    host.write(1, "operating_mode", 0)
    host.write(1, "torque_enable", 1)
    assert not host.arm.torque_enabled()[0]


def test_nothing_is_commanded_twice(host: Host) -> None:
    calls = []
    host.arm.command_servo = lambda *command: calls.append(command)
    host.write(1, "operating_mode", 5)
    host.write(1, "torque_enable", 1)
    for _ in range(5):
        host.write(1, "goal_position", 2100)
        host.read(1, "present_position")
    references = [call[2] for call in calls if call[1]]
    assert references.count(52 * TICK) == 1


def test_profile_velocity_and_acceleration_shape_the_reference(host: Host) -> None:
    host.write(1, "operating_mode", 5)
    host.write(1, "profile_velocity", 50)
    host.write(1, "profile_acceleration", 20)
    host.write(1, "torque_enable", 1)
    start = host.arm.commands[0][1]
    host.write(1, "goal_position", host.read(1, "present_position") + 1000)
    references = [start]
    while len(references) < 3000 and (not references[1:] or host.read(1, "moving_status") & 2):
        host.advance(0.005)
        references.append(host.arm.commands[0][1])
    speeds = [(b - a) / 0.005 for a, b in itertools.pairwise(references)]
    assert references[-1] == pytest.approx(start + 1000 * TICK, abs=TICK)
    assert max(speeds) == pytest.approx(50 * VELOCITY_UNIT, rel=0.05)
    assert min(speeds) > -1e-9
    assert max(references) <= references[-1] + 1e-3
    changes = [abs(b - a) / 0.005 for a, b in itertools.pairwise(speeds[1:-2])]
    assert max(changes) < 20 * 0.3745 * 1.6


def test_registered_writes_wait_for_action(host: Host) -> None:
    assert host.write(1, "led", 1, REG_WRITE) == OK
    assert host.read(1, "led") == 0
    assert host.read(1, "registered") == 1
    assert host.ask(1, ACTION) == [(1, OK, b"")]
    assert host.read(1, "led") == 1
    assert host.ask(1, ACTION)[0][1] == RESULT_FAIL


def test_sync_read_answers_in_the_order_asked_and_stops_at_a_missing_servo(host: Host) -> None:
    request = words(132, 4)
    assert [reply[0] for reply in host.ask(BROADCAST, SYNC_READ, request + bytes((3, 1, 2)))] == [3, 1, 2]
    host.bus.faults.missing = {1}
    assert [reply[0] for reply in host.ask(BROADCAST, SYNC_READ, request + bytes((3, 1, 2)))] == [3]


def test_sync_and_bulk_writes(host: Host) -> None:
    assert host.ask(BROADCAST, SYNC_WRITE, words(65, 1) + bytes((1, 1, 3, 1))) == []
    assert [host.read(servo, "led") for servo in (1, 2, 3)] == [1, 0, 1]
    assert host.ask(BROADCAST, BULK_WRITE, bytes((2,)) + words(65, 1) + b"\1" + bytes((1,)) + words(102, 2, 77)) == []
    assert host.read(2, "led") == 1
    assert host.read(1, "goal_current") == 77
    replies = host.ask(BROADCAST, BULK_READ, bytes((1,)) + words(102, 2) + bytes((2,)) + words(65, 1))
    assert replies == [(1, OK, words(77)), (2, OK, b"\1")]


def test_indirect_registers_read_and_write_what_they_point_to(host: Host) -> None:
    targets = [116, 117, 118, 119, 70, 146]
    assert host.ask(1, WRITE, words(indirect_address(0), *targets))[0][1] == OK
    host.write(1, "operating_mode", 5)
    ticks = (-300).to_bytes(4, "little", signed=True)
    assert host.ask(1, WRITE, words(indirect_data(0)) + ticks)[0][1] == OK
    assert host.read(1, "goal_position") == -300
    assert host.ask(1, READ, words(indirect_data(0), 6))[0][2] == ticks + bytes((0, 30))
    assert host.ask(1, WRITE, words(indirect_data(0)) + ticks[:2])[0][1] == LENGTH
    assert host.ask(1, WRITE, words(indirect_data(4)) + b"\0")[0][1] == ACCESS
    assert host.ask(1, WRITE, words(indirect_address(0), 8))[0][1] == RANGE  # EEPROM is out of reach


def test_a_latched_error_takes_the_torque_and_only_a_reboot_clears_it(host: Host) -> None:
    host.write(1, "operating_mode", 5)
    host.write(1, "torque_enable", 1)
    host.bus.raise_hardware_error(1, OVERLOAD)
    assert not host.arm.torque_enabled()[0]
    assert host.read(1, "hardware_error") == OVERLOAD
    assert host.ask(1, PING)[0][1] == 0x80
    assert host.write(1, "torque_enable", 1) == RESULT_FAIL
    assert host.ask(1, REBOOT)[0][0] == 1
    assert host.ask(1, PING) == []
    host.advance(0.5)
    assert host.ask(1, PING)[0][1] == 0
    assert host.read(1, "hardware_error") == 0
    assert host.read(1, "operating_mode") == 5
    assert host.write(1, "torque_enable", 1) == OK


def test_heat_shuts_down_and_low_voltage_only_reports(host: Host) -> None:
    for servo in (1, 2):
        host.write(servo, "operating_mode", 5)
        host.write(servo, "torque_enable", 1)
    host.arm.temperature[0] = 81.0
    host.arm.voltage[1] = 9.0
    assert host.read(1, "hardware_error") == 1 << 2
    assert host.read(2, "hardware_error") == 1
    assert host.arm.torque_enabled()[:2] == [False, True]
    host.ask(1, REBOOT)
    host.advance(0.5)
    assert host.read(1, "hardware_error") == 1 << 2  # still hot


def test_a_reboot_loses_ram_and_indirect_addresses(host: Host) -> None:
    host.ask(1, WRITE, words(indirect_address(0), 144, 145))
    host.write(1, "bus_watchdog", 6)
    host.ask(1, REBOOT)
    host.advance(0.5)
    assert host.ask(1, READ, words(indirect_data(0), 2))[0][2] == b"\0\0"
    assert host.read(1, "bus_watchdog") == 0


def test_the_watchdog_stops_the_servo_and_locks_its_goals(host: Host) -> None:
    host.write(1, "operating_mode", 5)
    host.write(1, "goal_current", 100)
    host.write(1, "bus_watchdog", 6)
    host.write(1, "torque_enable", 1)
    host.write(1, "goal_position", 2048)
    host.advance(0.115)
    host.read(1, "present_position")  # any instruction will do
    host.advance(0.115)
    assert host.arm.commands[0][1] == 0.0
    host.advance(0.01)
    on, reference, _ = host.arm.commands[0]
    assert on
    assert reference == pytest.approx(host.arm.angles[0], abs=0.05)
    assert reference < -0.1
    assert host.read(1, "bus_watchdog") == 255
    assert host.write(1, "goal_position", 2048) == RANGE
    assert host.write(1, "goal_current", 10) == RANGE
    assert host.write(1, "bus_watchdog", 6) == RANGE
    assert host.write(1, "bus_watchdog", 0) == OK
    assert host.arm.commands[0][1] == reference
    assert host.write(1, "goal_position", 2048) == OK


def test_the_return_delay_and_the_wire_take_their_time() -> None:
    host = Host(paced=True)
    host.bus.servo(1).table.set("return_delay", 250)
    assert host.send(1, PING) == b""
    on_wire = (10 + 14) * 10e-6
    assert host.advance(500e-6 + on_wire - 20e-6) == b""
    assert host.advance(40e-6)


def test_status_return_level(host: Host) -> None:
    host.write(1, "status_return_level", 1)
    assert host.ask(1, WRITE, words(65) + b"\1") == []
    assert host.read(1, "led") == 1
    host.ask(1, WRITE, words(68) + b"\0")
    assert host.ask(1, READ, words(65, 1)) == []
    assert host.ask(1, PING)


def test_they_hear_only_their_own_speed() -> None:
    speed = [57600]
    host = Host(line_speed=lambda: speed[0])
    assert host.ask(1, PING) == []
    host.bus.set_speed(2, 1)
    assert [reply[0] for reply in host.ask(BROADCAST, PING)] == [2]
    speed[0] = 1_000_000
    assert [reply[0] for reply in host.ask(BROADCAST, PING)] == [1, 3]


def test_factory_reset_forgets_id_and_speed_unless_told(host: Host) -> None:
    host.write(2, "operating_mode", 5)
    host.ask(2, FACTORY_RESET, b"\2")
    host.advance(0.5)
    assert host.read(2, "operating_mode") == 3
    assert host.read(2, "baud") == 3
    host.ask(3, FACTORY_RESET, b"\1")
    host.advance(0.5)
    assert host.bus.servo(3).speed == 57600


def test_noise_and_cut_packets_are_survived(host: Host) -> None:
    good = Host.packet(1, PING)
    assert host.bus.receive(b"\x00\xff\xff" + b"\xff\xff\xfd" + b"junk" + good, host.now)
    for cut in range(1, len(good)):
        host.advance(0.1)  # half a packet is given up
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


def test_unknown_faults_and_servos_are_named(host: Host) -> None:
    with pytest.raises(DriverError, match="explode"):
        host.bus.faults.next_reply("explode", 1)
    with pytest.raises(DriverError, match="7"):
        host.bus.servo(7)


def test_a_late_reply_comes_when_it_is_due(host: Host) -> None:
    host.bus.faults.delay = 0.05
    assert host.send(1, PING) == b""
    assert host.bus.next_event(host.now) == pytest.approx(0.05)
    assert host.advance(0.049) == b""
    assert parse(host.advance(0.002))
    assert host.bus.next_event(host.now) == math.inf


def test_the_homing_offset_is_added_to_what_is_told_and_taken_off_what_is_ordered(host: Host) -> None:
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


@pytest.mark.parametrize(
    ("velocity", "acceleration", "distance", "shape"),
    [(0, 0, 200, 0b00), (50, 0, 200, 0b01), (200, 1, 200, 0b10), (20, 20, 1000, 0b11)],
)
def test_moving_and_moving_status_follow_a_move(
    host: Host, velocity: int, acceleration: int, distance: int, shape: int
) -> None:
    host.write(1, "operating_mode", 5)
    assert (host.read(1, "moving"), host.read(1, "moving_status")) == (0, 0)
    host.write(1, "profile_velocity", velocity)
    host.write(1, "profile_acceleration", acceleration)
    host.write(1, "torque_enable", 1)
    host.advance(0.5)  # from between two counts to the nearest
    assert host.read(1, "moving_status") & 0b1011 == 0b0001  # in position
    host.write(1, "goal_position", host.read(1, "present_position") + distance)
    host.advance(0.02)
    assert host.read(1, "moving_status") >> 4 == shape
    assert host.read(1, "moving_status") & 0b0011 == (0b0010 if velocity else 0b0000)
    assert host.read(1, "moving") == 1
    host.advance(10.0)
    assert (host.read(1, "moving"), host.read(1, "moving_status") & 0b1011) == (0, 0b0001)


def test_a_servo_that_cannot_follow_says_so(host: Host) -> None:
    host.write(1, "operating_mode", 5)
    host.write(1, "goal_current", 10)
    host.write(1, "torque_enable", 1)
    host.arm.load[0] = 3.0
    host.advance(2.0)
    assert host.read(1, "moving_status") & 0b1001 == 0b1000


def test_the_supply_sags_under_load_and_the_error_that_this_latches_stays(host: Host) -> None:
    host.arm.supply_resistance = 0.5
    for servo in (1, 2):
        host.write(servo, "operating_mode", 5)
        host.write(servo, "torque_enable", 1)
    host.arm.load[0] = host.arm.load[1] = 2.0 * TORQUE_CONSTANT
    host.advance(3.0)
    assert host.read(1, "input_voltage") == pytest.approx(100, abs=1)
    assert host.read(1, "hardware_error") == 0
    host.arm.load[1] = 4.0 * TORQUE_CONSTANT
    host.advance(3.0)
    assert host.read(1, "input_voltage") < 95
    host.arm.load[0] = host.arm.load[1] = 0.0
    host.advance(3.0)
    assert host.read(1, "input_voltage") == 120
    assert host.read(1, "hardware_error") == 1


def test_two_servos_with_one_id_act_as_one_and_answer_over_each_other(host: Host) -> None:
    host.bus.alter(2, lambda servo: servo.table.set("id", 1))
    assert host.ask(3, PING) == []
    clean = 0
    for _ in range(50):
        data = host.send(1, READ, words(REGISTERS["present_position"].address, 4))
        try:
            clean += bool(parse(data))
        except (AssertionError, IndexError):
            assert data
    assert clean == 0
    assert [reply[0] for reply in parse(host.send(BROADCAST, SYNC_READ, words(132, 4) + bytes((2,))))] == [2]
    host.send(BROADCAST, SYNC_WRITE, words(65, 1) + bytes((1, 1)))
    host.bus.alter(2, lambda servo: servo.table.set("id", 3))
    assert [host.read(servo, "led") for servo in (1, 2, 3)] == [1, 0, 1]


@pytest.mark.parametrize("seed", range(20))
def test_a_collision_on_the_line_is_what_zeros_over_ones_make_of_it(seed: int) -> None:
    source = random.Random(seed)
    first, second = source.randbytes(14), source.randbytes(9)
    assert collide(first, b"", source) == first
    assert collide(first, b"\xff", source)  # a start bit, at least, goes into it
    both = collide(first, second, source)
    assert both != first
    assert 0 < len(both) <= len(first) + 1


def test_deaf_servos_stop_by_their_watchdog_and_hear_again(host: Host) -> None:
    host.write(1, "operating_mode", 5)
    host.write(1, "bus_watchdog", 6)
    host.write(1, "torque_enable", 1)
    host.bus.faults.deaf = True
    assert host.ask(1, PING) == []
    host.advance(0.2)
    host.bus.faults.deaf = False
    assert host.read(1, "bus_watchdog") == 255


def test_a_watchdog_trips_at_once_where_it_is_armed(host: Host) -> None:
    host.bus.alter(0, lambda servo: servo.trip_watchdog(host.now))
    assert host.read(1, "bus_watchdog") == 0
    host.write(1, "bus_watchdog", 6)
    host.bus.alter(0, lambda servo: servo.trip_watchdog(host.now))
    assert host.read(1, "bus_watchdog") == 255


def test_damage_befalls_the_servos_that_it_is_ordered_for(host: Host) -> None:
    host.bus.faults.rate_of = {2: {"drop": 1.0}}
    assert [bool(host.ask(servo, PING)) for servo in (1, 2, 3)] == [True, False, True]


def test_a_supply_that_sags_below_its_limit_is_told_and_latched(host: Host) -> None:
    def limit(servo: ServoFirmware) -> None:
        servo.supply_limit = 9.0

    host.bus.alter(1, limit)
    assert host.read(2, "input_voltage") == 90
    assert [host.read(servo, "hardware_error") for servo in (1, 2)] == [0, 1]


def test_a_supply_too_weak_for_the_load_makes_the_driver_stop_all(tmp_path: Path) -> None:
    arm = BenchArm()
    arm.supply_resistance = 1.0
    events: list[tuple[object, ...]] = []
    with PseudoTerminal(ServoBusEmulator(arm), tmp_path / "servo") as terminal:
        controller = ServoController(
            BusSettings(terminal.path), 2.8, TORQUE_CONSTANT, lambda *event: events.append(event)
        )

        def cycle_until(condition: Callable[[], object]) -> None:
            end = time.monotonic() + 20.0
            while not condition():
                assert time.monotonic() < end, events
                controller.cycle()
                time.sleep(0.005)

        controller.open()
        try:
            request = controller.request("torque_on")
            cycle_until(lambda: request.wait(0.0))
            assert request.success, request.message
            cycle_until(lambda: all(arm.torque_enabled()))
            arm.load[:] = [1.2 * TORQUE_CONSTANT] * 3  # 3.6 A in all: 12 V sag to 8.4 V
            cycle_until(lambda: not any(arm.torque_enabled()))
            assert any("voltage" in str(event) for event in events), events
        finally:
            controller.close()


def test_the_driver_names_an_id_that_two_servos_have_and_one_that_none_has(tmp_path: Path) -> None:
    emulator = ServoBusEmulator(BenchArm())
    emulator.alter(2, lambda servo: servo.table.set("id", 2))
    with PseudoTerminal(emulator, tmp_path / "servo") as terminal, pytest.raises(HandshakeError) as caught:
        ServoBus(BusSettings(terminal.path)).open(scan=False)
    faults = " / ".join(caught.value.faults)
    assert "servo 2 answers unintelligibly; two servos with this id" in faults
    assert "servo 3" in faults
