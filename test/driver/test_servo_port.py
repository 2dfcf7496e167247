# SPDX-License-Identifier: Apache-2.0
"""Reading servos: a value is right or missing, whatever the wire fault; no trap of dynamixel-sdk is left.

docs/servos.md lists the traps.
"""

import contextlib
import math
import struct
import time
from collections.abc import Iterator
from typing import Any
from unittest.mock import Mock

import pytest

from deltacharger_core.servo_types import MX_64
from deltacharger_driver import errors, packets, ports
from deltacharger_driver.servos.bus import UNKNOWN_AFTER, ServoBus, ServoReport
from deltacharger_driver.servos.link import ServoLink
from deltacharger_driver.servos.registers import REGISTERS, decode_block, has_restarted
from deltacharger_sim.emulators.servo_bus import ServoBusEmulator

POSITION = REGISTERS["present_position"].address
SPARE = 650  # indirect data that nothing maps: plain memory
STUFFING = bytes.fromhex("fffffd01fffdfd00")


@pytest.fixture
def wired(terminal: ports.PseudoTerminal) -> Iterator[ServoLink]:
    """On a real pseudo-terminal."""
    link = ServoLink(terminal.path, 1_000_000)
    link.open()
    yield link
    link.close()


def test_failure_is_absence_not_zero_and_the_error_byte_is_kept(link: ServoLink, emulator: ServoBusEmulator) -> None:
    emulator.servo(3).raise_error(1)
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
        except errors.NoAnswer:
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


def test_waiting_costs_little_processor_time_and_ignores_the_wall_clock(
    wired: ServoLink, emulator: ServoBusEmulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulator.faults.missing = {1}
    monkeypatch.setattr(time, "time", lambda: 1.0)
    read = Mock(wraps=wired._handler.readPort)
    monkeypatch.setattr(wired._handler, "readPort", read)
    with pytest.raises(errors.NoAnswer):
        wired.ping(1)
    assert 0 < read.call_count < 5  # it does not poll


def test_a_pulled_cable_is_one_error_and_the_port_opens_again(wired: ServoLink, terminal: ports.PseudoTerminal) -> None:
    assert wired.ping(1) == 311
    terminal.stop()
    for _ in range(3):
        with pytest.raises(errors.PortGone):
            wired.ping(1)
        with pytest.raises(errors.PortGone):
            wired.send(packets.sync_write_packet(116, 4, [(1, bytes(4))]))
    terminal.start()
    wired.close()
    with contextlib.closing(ServoLink(terminal.path, 1_000_000)) as again:
        again.open()
        assert again.ping(1) == 311


GOOD_BLOCK = {"torque": 1, "error": 0, "current": -119, "velocity": 5, "ticks": 2048, "voltage": 120}
GOOD_BLOCK |= {"temperature": 30, "watchdog": 6, "level": 2, "registered": 0}
FAULTS = ["drop", "corrupt", "truncate", "duplicate", "garbage"]


def block(**changed: int) -> bytes:
    return struct.pack("<BBhiiHBBBB", *(GOOD_BLOCK | changed).values())


def cycle_until(bus: ServoBus, condition: Any) -> ServoReport:
    """Read until a snapshot fulfils the condition, and return it."""
    for _ in range(200):
        if condition(snapshot := bus.read()):
            return snapshot
        bus.clock.sleep(0.01)
    raise AssertionError(snapshot)


@pytest.mark.parametrize(
    ("changed", "name"),
    [({"watchdog": 254}, "bus_watchdog"), ({"level": 1}, "status_return_level"), ({"registered": 1}, "registered")],
)
def test_an_impossible_value_is_refused_by_name(changed: dict[str, int], name: str) -> None:
    with pytest.raises(errors.RangeError) as caught:
        decode_block(block(**changed), MX_64)
    assert caught.value.name == name
    assert not has_restarted(block(**changed))
    assert decode_block(block(watchdog=255), MX_64)


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
    missing = cycle_until(bus, lambda snapshot: snapshot.missing[1])
    assert math.isnan(missing.voltage[1])
    assert not math.isnan(missing.voltage[0] + missing.voltage[2])
    servo.measure = measure  # type: ignore[method-assign]
    cycle_until(bus, lambda snapshot: snapshot.complete)


def test_a_missing_servo_is_the_only_one_that_is_not_valid(bus: ServoBus, emulator: ServoBusEmulator) -> None:
    emulator.faults.missing = {1}
    snapshots = [bus.read() for _ in range(UNKNOWN_AFTER + 2)]
    assert [snapshot.valid for snapshot in snapshots[1:]] == [(False, True, True)] * (UNKNOWN_AFTER + 1)
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
            right = voltage == pytest.approx(12.0) and temperature == 30.0
            assert right or (not valid and math.isnan(voltage + temperature))
        try:
            assert bus._link.read(2, "input_voltage") == 120
            good += 1
        except (errors.NoAnswer, errors.CorruptReply):
            continue
    assert good > 25
    emulator.faults.rate.clear()
    cycle_until(bus, lambda snapshot: snapshot.complete)


def test_requests_with_corrupt_replies_are_repeated(link: ServoLink, emulator: ServoBusEmulator) -> None:
    emulator.faults.inject("corrupt", 2, 1)
    assert link.read(1, "input_voltage") == 120
    assert link.counters.corrupt + link.counters.timeouts == link.counters.retries == 2
