# SPDX-License-Identifier: Apache-2.0
"""Each trap of the unmodified dynamixel-sdk on a real pseudo-terminal, and the same situation with the driver."""

from __future__ import annotations

import copy
import struct
import termios
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from dynamixel_sdk import (
    COMM_PORT_BUSY,
    COMM_SUCCESS,
    INST_FAST_SYNC_READ,
    INST_SYNC_WRITE,
    GroupSyncRead,
    PortHandler,
    Protocol2PacketHandler,
)

from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.errors import HandshakeError, NoAnswer, PortGone, WrongThread
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.servos.bus import ServoBus
from deltacharger_driver.servos.link import ServoLink
from deltacharger_driver.servos.mx64 import REGISTERS
from deltacharger_driver.servos.port import ServoPort
from deltacharger_driver.servos.protocol import ServoProtocol, crc16, instruction_packet, sync_write_packet
from deltacharger_driver.servos.snapshot import BusSettings

from ..waiting import wait_until

POSITION = REGISTERS["present_position"].address
SPARE = 650  # indirect data that nothing maps: plain memory
STUFFING = bytes.fromhex("fffffd01fffdfd00")
Bare = tuple[PortHandler, Protocol2PacketHandler]  # the SDK's own classes


@pytest.fixture
def bare(terminal: PseudoTerminal) -> Iterator[Bare]:
    port = PortHandler(terminal.path)
    port.openPort()
    yield port, Protocol2PacketHandler()
    port.closePort()


def busy_share(action: Callable[[], object]) -> float:
    wall, cpu = time.monotonic(), time.thread_time()
    action()
    return (time.thread_time() - cpu) / (time.monotonic() - wall)


def reads_while(port: PortHandler, action: Callable[[], object]) -> int:
    """Return how often `port` is read while `action` runs."""
    count, read = 0, port.readPort

    def counted(length: int) -> Any:
        nonlocal count
        count += 1
        return read(length)

    port.readPort = counted
    action()
    return count


def test_trap_1_failure_is_absence_not_zero(bare: Bare, link: ServoLink, emulator: ServoBusEmulator) -> None:
    emulator.faults.missing = {1}
    group = GroupSyncRead(*bare, POSITION, 4)
    group.addParam(1)
    group.txRxPacket()
    assert group.getData(1, POSITION, 4) == 0
    assert link.sync_read((1,), POSITION, 4) == {}


def test_trap_2_a_late_reply_never_answers_another_question(
    bare: Bare, link: ServoLink, emulator: ServoBusEmulator
) -> None:
    port, protocol = bare
    emulator.faults.delay = 0.05

    def misled() -> bool:
        protocol.read2ByteTxRx(port, 1, 144)
        value, result, _ = protocol.read1ByteTxRx(port, 1, 146)
        return result == COMM_SUCCESS and value == 120  # decivolts taken for °C

    wait_until(misled, "the SDK to be misled")
    time.sleep(0.1)
    for _ in range(5):
        link.sync_read((1,), POSITION, 4)
        try:
            assert link.read(1, "temperature") == 30
        except NoAnswer:
            continue
    emulator.faults.delay = 0.0
    assert link.read(1, "temperature") == 30
    assert link.counters.late > 0


def test_trap_3_sent_packets_are_stuffed(bare: Bare, link: ServoLink) -> None:
    port, protocol = bare
    ticks = -131_073  # FF FF FD FF on the wire
    link.write(2, "operating_mode", 5)
    assert protocol.write4ByteTxRx(port, 2, 116, ticks & 0xFFFFFFFF)[0] != COMM_SUCCESS
    link.write(2, "goal_position", ticks)
    assert link.read(2, "goal_position") == ticks


def test_trap_3_stuffing_is_removed_exactly(bare: Bare, link: ServoLink) -> None:
    port, protocol = bare
    link.write_bytes(1, SPARE, STUFFING)
    result = None
    while result != COMM_SUCCESS:
        data, result, _ = protocol.readTxRx(port, 1, SPARE, len(STUFFING))
    assert bytes(data) != STUFFING  # the SDK takes FF FD FD for stuffing once it has removed some
    assert link.read_bytes(1, SPARE, len(STUFFING)) == STUFFING


def test_trap_4_the_error_byte_is_kept(bare: Bare, link: ServoLink, emulator: ServoBusEmulator) -> None:
    group = GroupSyncRead(*bare, POSITION, 4)
    for servo in (1, 2, 3):
        group.addParam(servo)

    def all_values() -> dict[str, Any]:
        assert group.txRxPacket() == COMM_SUCCESS
        return {name: value for name, value in vars(group).items() if name not in ("port", "ph")}

    healthy = copy.deepcopy(all_values())
    emulator.raise_hardware_error(3, 1)
    assert all_values() == healthy  # the group does not show that a servo is in alarm
    replies = link.sync_read((1, 2, 3), POSITION, 4)
    assert [error for error, _ in replies.values()] == [0, 0, 0x80]


def test_trap_5_fast_sync_read_is_never_sent(
    terminal: PseudoTerminal, emulator: ServoBusEmulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent = []
    write = ServoPort.writePort

    def spy(port: ServoPort, packet: list[int]) -> int:
        sent.append(packet[7] if list(packet[:4]) == [0xFF, 0xFF, 0xFD, 0] else None)  # None: Protocol 1.0
        return write(port, packet)

    monkeypatch.setattr(ServoPort, "writePort", spy)
    bus = ServoBus(BusSettings(terminal.path))
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
    reads = {code for code in sent if code is not None and code & 0x80 and code != INST_SYNC_WRITE}
    assert reads == {0x82}
    assert INST_FAST_SYNC_READ not in sent


def test_trap_6_waiting_costs_no_processor_time(bare: Bare, link: ServoLink, emulator: ServoBusEmulator) -> None:
    emulator.faults.missing = {1}
    port, protocol = bare
    assert reads_while(port, lambda: protocol.ping(port, 1)) > 200
    assert reads_while(link._handler, lambda: link.sync_read((1,), POSITION, 4)) < 5

    def wait() -> None:
        for _ in range(5):
            assert link.sync_read((1,), POSITION, 4) == {}

    assert busy_share(wait) < 0.2


def test_trap_7_timeouts_ignore_the_wall_clock_and_the_adapter_decides(
    bare: Bare, link: ServoLink, emulator: ServoBusEmulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulator.faults.missing = {1}
    port, _ = bare
    monkeypatch.setattr(time, "time", lambda: 1.0)
    assert port.getCurrentTime() == port.getCurrentTime() == 1000.0  # with a stopped clock it would wait for ever
    begin = time.monotonic()
    with pytest.raises(NoAnswer):
        link.ping(1)
    assert time.monotonic() - begin < 2.0
    ours = ServoPort("unused")
    ours.tx_time_per_byte = port.tx_time_per_byte
    ours.setPacketTimeout(11)
    port.setPacketTimeout(11)
    assert ours.packet_timeout < port.packet_timeout


def test_trap_8_a_pulled_cable_is_one_error_and_the_port_opens_again(
    terminal: PseudoTerminal, bare: Bare, link: ServoLink
) -> None:
    port, protocol = bare
    assert link.ping(1) == 311
    terminal.stop()
    with pytest.raises(termios.error):
        protocol.ping(port, 1)
    assert protocol.ping(port, 1)[1] == COMM_PORT_BUSY
    for _ in range(3):
        with pytest.raises(PortGone):
            link.ping(1)
        with pytest.raises(PortGone):
            link.send(sync_write_packet(116, 4, [(1, bytes(4))]))
    terminal.start()
    link.close()
    again = ServoLink(terminal.path, 1_000_000)
    again.open()
    assert again.ping(1) == 311
    again.close()


def test_trap_8_the_cable_is_pulled_while_a_reply_is_awaited(
    terminal: PseudoTerminal, link: ServoLink, emulator: ServoBusEmulator
) -> None:
    emulator.faults.missing = {1}
    puller = threading.Timer(0.01, terminal.stop)
    puller.start()

    def read_on() -> None:
        while True:
            link.sync_read((1,), POSITION, 4)

    with pytest.raises(PortGone):
        read_on()
    puller.join()


def test_trap_9_the_sdk_fails_the_call_of_a_second_thread(bare: Bare, emulator: ServoBusEmulator) -> None:
    port, protocol = bare
    emulator.faults.missing = {1}
    waiting, tried = threading.Event(), threading.Event()
    read = port.readPort

    def hold(length: int) -> Any:
        waiting.set()
        tried.wait(5.0)
        return read(length)

    port.readPort = hold
    first = threading.Thread(target=protocol.ping, args=(port, 1))
    first.start()
    assert waiting.wait(5.0)
    assert protocol.ping(port, 2)[1] == COMM_PORT_BUSY  # servo 2 is present but was not asked
    tried.set()
    first.join()


def test_trap_9_one_thread_owns_the_port(link: ServoLink) -> None:
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
    assert "MainThread" in caught[0]


def test_checksum_and_stuffing_agree_with_the_sdk_where_it_is_right() -> None:
    sdk, ours = Protocol2PacketHandler(), ServoProtocol()
    packet = list(bytes.fromhex("fffffd0001070002840004001d15"))
    assert crc16(packet[:-2]) == sdk.updateCRC(0, packet, len(packet) - 2) == struct.unpack("<H", bytes(packet[-2:]))[0]
    assert ours.updateCRC(0, packet, 5) == sdk.updateCRC(0, packet, 5)
    for body in (b"\xff\xff\xfd", b"\xff\xff\xff\xfd\xfd", b"\xff\xff\xfd\xff\xff\xfd\x07", STUFFING, b"plain"):
        stuffed = instruction_packet(1, 0x55, body)
        assert b"\xff\xff\xfd\xfd" in stuffed or body == b"plain"
        assert bytes(ours.removeStuffing(list(stuffed))[8:-2]) == body
