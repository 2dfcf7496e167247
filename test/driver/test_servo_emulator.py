# SPDX-License-Identifier: Apache-2.0
"""Faults of emulated servos that match real ones, and what the driver makes of every one of the table."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from deltacharger_core.machine import POSITION_P_GAIN, SERVO_STIFFNESS
from deltacharger_driver.emulators import servo as table
from deltacharger_driver.emulators.servo import LIMIT, OK
from deltacharger_driver.packets import BROADCAST, PING, READ, SYNC_READ, SYNC_WRITE, WRITE
from deltacharger_driver.servos.bus import ServoPhase, ServoReport
from deltacharger_driver.servos.controller import bus_entry
from deltacharger_driver.servos.registers import REGISTERS, TICK
from deltacharger_sim.charger.faults import Fault, Faults, Hardware

from ..sim.fault_table import LEASE, SERVO_ROWS, Row
from .servo_host import Host, parse, words
from .servo_rig import Rig


def test_replies_of_two_servos_with_one_id_collide(host: Host) -> None:
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


@pytest.mark.parametrize("row", SERVO_ROWS, ids=lambda row: row.name)
def test_every_fault_stops_a_moving_arm_by_its_rules_or_is_borne(rig: Rig, row: Row) -> None:
    """In virtual time: the contactor is asked to open in time and before torque goes, and nothing returns by itself."""
    rig.emulator.line_speed = rig.line.speed
    cable: Any = SimpleNamespace(unplug=rig.line.stop, replug=rig.line.start)
    faults = Faults((), Hardware(rig.emulator, cable, cable, cable, cable), rig.clock)
    told: list[str] = []

    def until(condition: Callable[[ServoReport], object]) -> None:
        def watch(report: ServoReport) -> object:
            _, message, found = bus_entry(report, rig.controller)
            told.append(f"{message} {report.faults}")
            values.update(found)
            return condition(report)

        rig.until(watch)

    values: dict[str, Any] = {}
    rig.torque_on()
    rig.send((6.0, (0.3, 0.5, 1.2)))
    until(lambda report: rig.references()[0] > -0.6)
    began, count = rig.clock(), int(values.get(row.counted, 0))
    faults.begin(Fault(kind=row.kind, servo=row.servo, amount=row.amount))
    if not row.torque_off:
        before = rig.references()[0]
        until(lambda report: rig.clock() > began + 2.0)
        assert rig.report.phase is ServoPhase.ON
        assert rig.references()[0] > before + 0.1, "the motion goes on"
        assert not rig.requests
        assert not row.counted or int(values[row.counted]) > count
        return
    until(lambda report: rig.requests)
    noticed = row.opens - LEASE if row.opens > LEASE else row.opens
    assert rig.requests[0] - began <= noticed + 0.05
    for servo in row.unknown:
        until(lambda report, servo=servo: math.isnan(report.angle[servo - 1]))  # type: ignore[misc]
    until(lambda report: report.phase in (ServoPhase.OFF, ServoPhase.DISCONNECTED))
    for servo, on in enumerate(rig.torque_when_opened or [], 1):  # unknown if nothing answers any more
        assert on or servo in row.at_once
    assert not any(on for servo, on in enumerate(rig.arm.torque_enabled(), 1) if servo not in row.deaf)
    warning = [word.replace("/servo", rig.line.path) for word in row.warning]
    assert any(all(word in each for word in warning) for each in told), told[-3:]
    faults.clear()
    until(lambda report: all(report.valid) and not any(rig.arm.torque_enabled()))
    for _ in range(50):
        assert rig.cycle().phase is ServoPhase.OFF
        assert not any(rig.arm.torque_enabled()), "torque does not return by itself"
    if row.recovery:
        assert not rig.ask("torque_on").success
        assert rig.ask("reboot").success
    rig.torque_on()


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
