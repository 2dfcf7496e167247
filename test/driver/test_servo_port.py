# SPDX-License-Identifier: Apache-2.0
"""The traps of dynamixel-sdk (docs/servos.md): none of them is left in the driver."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from dynamixel_sdk import PortHandler, Protocol2PacketHandler

from deltacharger_driver.emulators.bench_arm import BenchArm
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.errors import HandshakeError, NoAnswer, PortGone, WrongThread
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.servos.bus import ServoBus
from deltacharger_driver.servos.link import ServoLink
from deltacharger_driver.servos.mx64 import REGISTERS
from deltacharger_driver.servos.port import ServoPort
from deltacharger_driver.servos.protocol import ServoProtocol, crc16, instruction_packet, sync_write_packet
from deltacharger_driver.servos.snapshot import BusSettings

POSITION = REGISTERS["present_position"].address
SPARE = 650  # indirect data that nothing maps: plain memory
STUFFING = bytes.fromhex("fffffd01fffdfd00")
READS = {0x82}  # sync read; 0x8A would be fast sync read


class Cable:
    """Servos on a real pseudo-terminal, with the driver's link on it."""

    def __init__(self) -> None:
        self.emulator = ServoBusEmulator(BenchArm())
        self.terminal = PseudoTerminal(self.emulator).start()
        self.link = ServoLink(self.terminal.path, 1_000_000)
        self.link.open()


@pytest.fixture
def cable() -> Iterator[Cable]:
    cable = Cable()
    yield cable
    cable.link.close()
    cable.terminal.stop()


def test_failure_is_absence_not_zero_and_the_error_byte_is_kept(link: ServoLink, emulator: ServoBusEmulator) -> None:
    emulator.raise_hardware_error(3, 1)
    assert [error for error, _ in link.sync_read((1, 2, 3), POSITION, 4).values()] == [0, 0, 0x80]
    emulator.faults.missing = {1}
    assert link.sync_read((1,), POSITION, 4) == {}


def test_a_late_reply_never_answers_another_question(link: ServoLink, emulator: ServoBusEmulator) -> None:
    emulator.faults.delay = 0.15
    for _ in range(5):
        link.sync_read((1,), POSITION, 4)
        try:
            assert link.read(1, "temperature") == 30
        except NoAnswer:
            continue
    emulator.faults.delay = 0.0
    assert link.read(1, "temperature") == 30
    assert link.counters.late > 0


def test_packets_are_stuffed_and_unstuffed_exactly(link: ServoLink) -> None:
    ticks = -131_073  # FF FF FD FF on the wire
    link.write(2, "operating_mode", 5)
    link.write(2, "goal_position", ticks)
    assert link.read(2, "goal_position") == ticks
    link.write_bytes(1, SPARE, STUFFING)
    assert link.read_bytes(1, SPARE, len(STUFFING)) == STUFFING


def test_fast_sync_read_is_never_sent(line: Any, emulator: ServoBusEmulator, monkeypatch: pytest.MonkeyPatch) -> None:
    sent = set[int]()
    write = line.handler.writePort

    def spy(port: ServoPort, packet: list[int]) -> int:
        sent.update([packet[7]] if list(packet[:4]) == [0xFF, 0xFF, 0xFD, 0] else [])
        return int(write(port, packet))

    monkeypatch.setattr(line.handler, "writePort", spy)
    bus = ServoBus(BusSettings(line.path), line.handler)
    emulator.faults.missing = {3}
    with pytest.raises(HandshakeError):
        bus.open()
    emulator.faults.missing = set()
    bus.open()
    bus.enable_torque((0.5, 0.5, 0.5))
    for missing in (set(), {2}, set()):
        emulator.faults.missing = missing
        for _ in range(3):
            bus.write_goals((0.0, 0.0, 0.0), (0.5, 0.5, 0.5))
            bus.read()
    bus.disable_torque()
    bus.reboot(0)
    bus.close()
    assert {code for code in sent if code & 0x80 and code != 0x83} == READS  # 0x83: sync write


def test_waiting_costs_little_processor_time_and_ignores_the_wall_clock(
    cable: Cable, monkeypatch: pytest.MonkeyPatch
) -> None:
    cable.emulator.faults.missing = {1}
    monkeypatch.setattr(time, "time", lambda: 1.0)
    count, read = 0, cable.link._handler.readPort

    def counted(length: int) -> Any:
        nonlocal count
        count += 1
        return read(length)

    cable.link._handler.readPort = counted
    with pytest.raises(NoAnswer):
        cable.link.ping(1)
    assert count < 5  # it does not poll
    ours, theirs = ServoPort("unused"), PortHandler("unused")
    for port in (ours, theirs):
        port.tx_time_per_byte = 0.01
        port.setPacketTimeout(11)
    assert ours.packet_timeout < theirs.packet_timeout  # the adapter's latency, not 16 ms, decides


def test_a_pulled_cable_is_one_error_and_the_port_opens_again(cable: Cable) -> None:
    assert cable.link.ping(1) == 311
    cable.terminal.stop()
    for _ in range(3):
        with pytest.raises(PortGone):
            cable.link.ping(1)
        with pytest.raises(PortGone):
            cable.link.send(sync_write_packet(116, 4, [(1, bytes(4))]))
    cable.terminal.start()
    cable.link.close()
    again = ServoLink(cable.terminal.path, 1_000_000)
    again.open()
    assert again.ping(1) == 311
    again.close()


def test_one_thread_owns_the_port(link: ServoLink) -> None:
    caught = []

    def use() -> None:
        try:
            link.ping(1)
        except WrongThread as error:
            caught.append(str(error))

    thread = threading.Thread(target=use, name="intruder")
    thread.start()
    thread.join()
    assert "intruder" in caught[0]


def test_checksum_and_stuffing_agree_with_the_sdk_where_it_is_right() -> None:
    sdk, ours = Protocol2PacketHandler(), ServoProtocol()
    packet = list(bytes.fromhex("fffffd0001070002840004001d15"))
    assert crc16(packet[:-2]) == sdk.updateCRC(0, packet, len(packet) - 2) == struct.unpack("<H", bytes(packet[-2:]))[0]
    assert ours.updateCRC(0, packet, 5) == sdk.updateCRC(0, packet, 5)
    for body in (b"\xff\xff\xfd", b"\xff\xff\xff\xfd\xfd", b"\xff\xff\xfd\xff\xff\xfd\x07", STUFFING, b"plain"):
        stuffed = instruction_packet(1, 0x55, body)
        assert b"\xff\xff\xfd\xfd" in stuffed or body == b"plain"
        assert bytes(ours.removeStuffing(list(stuffed))[8:-2]) == body
