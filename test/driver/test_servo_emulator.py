# SPDX-License-Identifier: Apache-2.0
"""The emulated servos against the e-manual, byte by byte in simulated time."""

from __future__ import annotations

import pytest

from deltacharger_core.machine import POSITION_P_GAIN, SERVO_STIFFNESS
from deltacharger_driver.emulators import servo as table
from deltacharger_driver.emulators.servo import LIMIT, OK
from deltacharger_driver.packets import PING, READ, WRITE
from deltacharger_driver.servos.registers import TICK

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
