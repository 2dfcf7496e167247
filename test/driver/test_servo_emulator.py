# SPDX-License-Identifier: Apache-2.0
"""The emulated servos against the e-manual, byte by byte in simulated time."""

from __future__ import annotations

from deltacharger_driver.servos.control_table import (
    ACCESS,
    CHECKSUM,
    INSTRUCTION,
    LENGTH,
    LIMIT,
    OK,
    RANGE,
    RESULT_FAIL,
)
from deltacharger_driver.servos.mx64 import REGISTERS, indirect_address, indirect_data
from deltacharger_driver.servos.packets import (
    ACTION,
    BROADCAST,
    PING,
    READ,
    REG_WRITE,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
)

from .servo_host import Host, parse, words


def test_ping_returns_the_model_and_broadcast_ping_finds_all(host: Host) -> None:
    assert host.ask(2, PING) == [(2, 0, bytes((0x37, 0x01, 45)))]
    assert [servo for servo, _, _ in host.ask(BROADCAST, PING)] == [1, 2, 3]
    assert host.ask(9, PING) == []


def test_every_kind_of_rejection_has_its_number(host: Host) -> None:
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


def test_registered_writes_wait_for_action(host: Host) -> None:
    assert host.write(1, "led", 1, REG_WRITE) == OK
    assert host.read(1, "led") == 0
    assert host.read(1, "registered") == 1
    assert host.ask(1, ACTION) == [(1, OK, b"")]
    assert host.read(1, "led") == 1
    assert host.ask(1, ACTION)[0][1] == RESULT_FAIL


def test_sync_read_answers_in_the_requested_order_and_stops_at_a_missing_servo(host: Host) -> None:
    request = words(132, 4)
    assert [reply[0] for reply in host.ask(BROADCAST, SYNC_READ, request + bytes((3, 1, 2)))] == [3, 1, 2]
    host.bus.faults.missing = {1}
    assert [reply[0] for reply in host.ask(BROADCAST, SYNC_READ, request + bytes((3, 1, 2)))] == [3]


def test_a_sync_write_reaches_the_named_servos(host: Host) -> None:
    assert host.ask(BROADCAST, SYNC_WRITE, words(65, 1) + bytes((1, 1, 3, 1))) == []
    assert [host.read(servo, "led") for servo in (1, 2, 3)] == [1, 0, 1]


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
    assert host.ask(1, WRITE, words(indirect_address(0), 8))[0][1] == RANGE  # EEPROM cannot be a target


def test_the_return_delay_and_the_wire_delay_the_reply() -> None:
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
