# SPDX-License-Identifier: Apache-2.0
"""Reading servos, singly and by cycle: a value is right or missing, whatever the wire fault."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest

from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.errors import CorruptReply, DriverError, NoAnswer, RangeError
from deltacharger_driver.servos.bus import UNKNOWN_AFTER, ServoBus
from deltacharger_driver.servos.link import ServoLink
from deltacharger_driver.servos.packets import status
from deltacharger_driver.servos.snapshot import READ_LENGTH, BusSnapshot, decode_block, has_restarted

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
    assert decode_block(block()) == (True, 0, -119, 5, 2048, 120, 30, 6)
    assert len(block()) == READ_LENGTH == 18


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        ({"current": -32768}, "present_current"),
        ({"voltage": 39}, "input_voltage"),
        ({"watchdog": 254}, "bus_watchdog"),
        ({"level": 1}, "status_return_level"),
        ({"registered": 1}, "registered"),
    ],
)
def test_an_impossible_value_is_refused_by_name(changed: dict[str, int], name: str) -> None:
    with pytest.raises(RangeError) as caught:
        decode_block(block(**changed))
    assert caught.value.name == name
    assert not has_restarted(block(**changed))
    assert decode_block(block(watchdog=255))


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


def test_a_lost_reply_is_nan_and_the_next_cycle_is_complete(bus: ServoBus, emulator: ServoBusEmulator) -> None:
    emulator.faults.next_reply("drop", 2)
    snapshot = bus.read()
    assert snapshot.valid == (True, False, True)
    assert all(map(math.isnan, (snapshot.angle[1], snapshot.current[1], snapshot.voltage[1])))
    assert snapshot.missed == (0, 1, 0)
    assert bus.read().complete


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


def test_requests_with_corrupt_replies_are_repeated(link: ServoLink, emulator: ServoBusEmulator) -> None:
    emulator.faults.next_reply("corrupt", 1, 2)
    assert link.read(1, "input_voltage") == 120
    assert link.counters.corrupt + link.counters.timeouts == link.counters.retries == 2


def test_garbled_replies_are_distinguished_from_silence(link: ServoLink, emulator: ServoBusEmulator) -> None:
    emulator.faults.rate["corrupt"] = 1.0
    with pytest.raises((CorruptReply, NoAnswer)):
        link.read(1, "input_voltage")
    emulator.faults.rate.clear()
    emulator.faults.missing = {1}
    with pytest.raises(NoAnswer, match="servo 1"):
        link.read(1, "input_voltage")


def test_a_speed_that_servos_lack_is_refused(line: Any) -> None:
    with pytest.raises(DriverError, match="12345"):
        ServoLink(line.path, 12345, handler=line.handler).open()
