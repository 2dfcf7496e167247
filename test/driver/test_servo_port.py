# SPDX-License-Identifier: Apache-2.0
"""Reading servos: a value is right or missing, whatever the wire fault; no trap of dynamixel-sdk is left.

docs/servos.md lists the traps.
"""

from __future__ import annotations

import contextlib
import math
import struct
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any
from unittest.mock import Mock

import pytest
from dynamixel_sdk import PortHandler, Protocol2PacketHandler

from deltacharger_core.servo_types import MX_64
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator, status
from deltacharger_driver.errors import CorruptReply, DriverError, NoAnswer, PortGone, RangeError, WrongThread
from deltacharger_driver.packets import crc16, instruction_packet, sync_write_packet
from deltacharger_driver.ports import PseudoTerminal
from deltacharger_driver.servos.bus import UNKNOWN_AFTER, BusSnapshot, ServoBus
from deltacharger_driver.servos.link import ServoLink, ServoPort, ServoProtocol
from deltacharger_driver.servos.registers import READ_LENGTH, REGISTERS, BusSettings, decode_block, has_restarted

POSITION = REGISTERS["present_position"].address
SPARE = 650  # indirect data that nothing maps: plain memory
STUFFING = bytes.fromhex("fffffd01fffdfd00")
READS = {0x82}  # sync read; 0x8A would be fast sync read


@pytest.fixture
def wired(terminal: PseudoTerminal) -> Iterator[ServoLink]:
    """On a real pseudo-terminal."""
    link = ServoLink(terminal.path, 1_000_000)
    link.open()
    yield link
    link.close()


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
            assert link.read(1, "secondary_id") == 255  # as long: only waiting tells it from the other
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
    bus.open()
    bus.enable_torque((0.5, 0.5, 0.5))
    for missing in (set(), {2}, set()):
        emulator.faults.missing = missing
        bus.exchange((0.0, 0.0, 0.0), (0.5, 0.5, 0.5))
    bus.disable_torque()
    bus.reboot(0)
    bus.close()
    assert {code for code in sent if code & 0x80 and code != 0x83} == READS  # 0x83: sync write


def test_waiting_costs_little_processor_time_and_ignores_the_wall_clock(
    wired: ServoLink, emulator: ServoBusEmulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulator.faults.missing = {1}
    monkeypatch.setattr(time, "time", lambda: 1.0)
    read = Mock(wraps=wired._handler.readPort)
    monkeypatch.setattr(wired._handler, "readPort", read)
    with pytest.raises(NoAnswer):
        wired.ping(1)
    assert 0 < read.call_count < 5  # it does not poll
    ours, theirs = ServoPort("unused"), PortHandler("unused")
    for port in (ours, theirs):
        port.tx_time_per_byte = 0.01
        port.setPacketTimeout(11)
    assert ours.packet_timeout < theirs.packet_timeout  # the adapter's latency, not 16 ms, decides


def test_a_pulled_cable_is_one_error_and_the_port_opens_again(wired: ServoLink, terminal: PseudoTerminal) -> None:
    assert wired.ping(1) == 311
    terminal.stop()
    for _ in range(3):
        with pytest.raises(PortGone):
            wired.ping(1)
        with pytest.raises(PortGone):
            wired.send(sync_write_packet(116, 4, [(1, bytes(4))]))
    terminal.start()
    wired.close()
    with contextlib.closing(ServoLink(terminal.path, 1_000_000)) as again:
        again.open()
        assert again.ping(1) == 311


def test_one_thread_owns_the_port(link: ServoLink) -> None:
    with ThreadPoolExecutor(1, "intruder") as pool, pytest.raises(WrongThread, match="intruder"):
        pool.submit(link.ping, 1).result()


def test_checksum_and_stuffing_agree_with_the_sdk_where_it_is_right() -> None:
    sdk, ours = Protocol2PacketHandler(), ServoProtocol()
    packet = list(bytes.fromhex("fffffd0001070002840004001d15"))
    assert crc16(packet[:-2]) == sdk.updateCRC(0, packet, len(packet) - 2) == struct.unpack("<H", bytes(packet[-2:]))[0]
    assert ours.updateCRC(0, packet, 5) == sdk.updateCRC(0, packet, 5)
    for body in (b"\xff\xff\xfd", b"\xff\xff\xff\xfd\xfd", b"\xff\xff\xfd\xff\xff\xfd\x07", STUFFING, b"plain"):
        stuffed = instruction_packet(1, 0x55, body)
        assert b"\xff\xff\xfd\xfd" in stuffed or body == b"plain"
        assert bytes(ours.removeStuffing(list(stuffed))[8:-2]) == body


GOOD_BLOCK = {"torque": 1, "error": 0, "current": -119, "velocity": 5, "ticks": 2048, "voltage": 120}
GOOD_BLOCK |= {"temperature": 30, "watchdog": 6, "level": 2, "registered": 0}
FAULTS = ["drop", "corrupt", "truncate", "duplicate", "garbage"]


def block(**changed: int) -> bytes:
    return struct.pack("<BBhiiHBBBB", *(GOOD_BLOCK | changed).values())


def cycle_until(bus: ServoBus, condition: Any) -> BusSnapshot:
    """Read until a snapshot fulfils the condition, and return it."""
    for _ in range(200):
        if condition(snapshot := bus.read()):
            return snapshot
        bus.clock.sleep(0.01)
    raise AssertionError(snapshot)


def test_the_block_is_decoded_by_its_layout() -> None:
    assert decode_block(block(), MX_64) == (True, 0, -119, 5, 2048, 120, 30, 6)
    assert len(block()) == READ_LENGTH == 18


@pytest.mark.parametrize(
    ("changed", "name"),
    [({"watchdog": 254}, "bus_watchdog"), ({"level": 1}, "status_return_level"), ({"registered": 1}, "registered")],
)
def test_an_impossible_value_is_refused_by_name(changed: dict[str, int], name: str) -> None:
    with pytest.raises(RangeError) as caught:
        decode_block(block(**changed), MX_64)
    assert caught.value.name == name
    assert not has_restarted(block(**changed))
    assert decode_block(block(watchdog=255), MX_64)


def test_a_restart_is_detected_by_the_lost_configuration_not_by_the_supply() -> None:
    assert has_restarted(bytes(READ_LENGTH))
    assert not has_restarted(block(voltage=0))


def test_a_burst_error_across_the_last_byte_and_the_checksum_is_detected(
    bus: ServoBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    def struck(*fields: Any) -> bytes:
        reply = status(*fields)
        return reply[:-3] + bytes((reply[-3] ^ 0x03, reply[-2] ^ 0x0A, reply[-1]))

    monkeypatch.setattr("deltacharger_driver.emulators.servo_bus.status", struck)
    assert bus._link.read(1, "temperature") == 30 ^ 0x03  # the checksum does not detect it
    assert bus.read().valid == (False, False, False)
    assert bus.counters.implausible == 3
    assert bus.counters.corrupt == 0


@pytest.mark.parametrize(("register", "value"), [("temperature", 200), ("input_voltage", 0), ("present_current", 3000)])
def test_a_reply_with_an_impossible_value_is_counted_and_discarded(
    bus: ServoBus, emulator: ServoBusEmulator, register: str, value: int
) -> None:
    servo = emulator.servo(2)
    measure = servo.measure

    def mistaken(now: float) -> float:
        angle = measure(now)
        servo.table.set(register, value)
        return angle

    servo.measure = mistaken  # type: ignore[method-assign]
    snapshot = bus.read()
    assert snapshot.valid == (True, False, True)
    assert snapshot.rebooted == (False, False, False)
    assert bus.counters.implausible == 1
    for values in (snapshot.angle, snapshot.velocity, snapshot.current, snapshot.voltage, snapshot.temperature):
        assert math.isnan(values[1])
        assert not math.isnan(values[0] + values[2])
    cycle_until(bus, lambda snapshot: snapshot.missing[1])
    servo.measure = measure  # type: ignore[method-assign]
    cycle_until(bus, lambda snapshot: snapshot.complete)


@pytest.mark.parametrize("missing", [1, 2, 3])
def test_a_missing_servo_is_the_only_one_that_is_not_valid(
    bus: ServoBus, emulator: ServoBusEmulator, missing: int
) -> None:
    emulator.faults.missing = {missing}
    snapshots = [bus.read() for _ in range(UNKNOWN_AFTER + 2)]
    expected = tuple(servo != missing for servo in (1, 2, 3))
    assert [snapshot.valid for snapshot in snapshots[1:]] == [expected] * (UNKNOWN_AFTER + 1)
    assert snapshots[-1].missed[missing - 1] == UNKNOWN_AFTER + 2
    emulator.faults.missing = set()
    cycle_until(bus, lambda snapshot: snapshot.complete)


def test_waiting_for_a_missing_servo_does_not_slow_the_others(
    bus: ServoBus, emulator: ServoBusEmulator, clock: Any
) -> None:
    emulator.faults.missing = {2}
    cycle_until(bus, lambda snapshot: snapshot.missing[1])
    begin = clock()
    for _ in range(50):
        bus.read()
    assert clock() - begin < 0.1  # the full wait in each cycle would take a second


@pytest.mark.parametrize("fault", FAULTS)
def test_under_any_noise_a_value_is_right_or_missing(bus: ServoBus, emulator: ServoBusEmulator, fault: str) -> None:
    emulator.faults.rate[fault] = 0.3
    good = 0
    for _ in range(40):
        snapshot = bus.read()
        for valid, voltage, temperature in zip(snapshot.valid, snapshot.voltage, snapshot.temperature, strict=True):
            assert not valid or (voltage == pytest.approx(12.0) and temperature == 30.0)
            assert valid or math.isnan(voltage)
        try:
            assert bus._link.read(2, "input_voltage") == 120
            good += 1
        except (NoAnswer, CorruptReply):
            continue
    assert good > 25
    emulator.faults.rate.clear()
    cycle_until(bus, lambda snapshot: snapshot.complete)


@pytest.mark.parametrize("sdk", ["installed", "before 3.8"])
def test_requests_with_corrupt_replies_are_repeated(
    link: ServoLink, emulator: ServoBusEmulator, monkeypatch: pytest.MonkeyPatch, sdk: str
) -> None:
    if sdk != "installed":  # its receiver has no `fast_option`
        receive = Protocol2PacketHandler.rxPacket
        options = [False] * (receive.__code__.co_argcount - 2)
        monkeypatch.setattr(Protocol2PacketHandler, "rxPacket", lambda self, port: receive(self, port, *options))
    emulator.faults.next_reply("corrupt", 1, 2)
    assert link.read(1, "input_voltage") == 120
    assert link.counters.corrupt + link.counters.timeouts == link.counters.retries == 2


def test_a_speed_that_servos_lack_is_refused(line: Any) -> None:
    with pytest.raises(DriverError, match="12345"):
        ServoLink(line.path, 12345, handler=line.handler).open()
