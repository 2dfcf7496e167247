# SPDX-License-Identifier: Apache-2.0
"""The servo bus: torque, goals and faults."""

from __future__ import annotations

import math
from typing import Any

import pytest

from deltacharger_driver.emulators.bench_arm import BenchArm
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.errors import DriverError, NoAnswer, PortGone, RangeError, ServoFault
from deltacharger_driver.servos.bus import ServoBus
from deltacharger_driver.servos.mx64 import CURRENT_UNIT, TICK
from deltacharger_driver.servos.snapshot import BusSettings

from .servo_rig import BOUND, OVERLOAD


def test_signs_follow_the_mounting(line: Any, arm: BenchArm) -> None:
    bus = ServoBus(BusSettings(line.path, zero_ticks=(2048, 2000, 2048), direction=(1, 1, -1)), line.handler)
    bus.open()
    bus.enable_torque(BOUND)
    arm.load[2] = -0.7
    while (snapshot := bus.read()).current[2] > -0.4:
        bus.clock.sleep(0.01)
    bus.close()
    assert snapshot.angle[0] == pytest.approx(-0.7, abs=TICK)
    assert snapshot.angle[1] == pytest.approx(-0.5 + 48 * TICK, abs=TICK)
    assert snapshot.angle[2] == pytest.approx(-arm.angles[2], abs=0.02)


@pytest.mark.parametrize(
    ("angles", "currents"),
    [
        ((math.nan, 0, 0), BOUND),
        ((0, 0, 0), (0.1, math.nan, 0.1)),
        ((0, 0, 0), (-0.1, 0.1, 0.1)),
        ((0, 0, 0), (99.0, 0.1, 0.1)),
    ],
)
def test_impossible_goals_are_refused_before_anything_is_sent(
    bus: ServoBus, arm: BenchArm, angles: tuple[float, ...], currents: tuple[float, ...]
) -> None:
    bus.enable_torque(BOUND)
    before = list(arm.commands)
    with pytest.raises(RangeError):
        bus.write_goals(angles, currents)
    bus.read()
    assert arm.commands == before


def test_a_bound_above_the_largest_is_refused_and_the_largest_itself_arrives(
    line: Any, emulator: ServoBusEmulator, arm: BenchArm
) -> None:
    emulator.servo(2).table.set("current_limit", 833)  # 2.8 A
    bus = ServoBus(BusSettings(line.path, current_max=2.8), line.handler)
    bus.open()
    bus.enable_torque(BOUND)
    with pytest.raises(RangeError):
        bus.write_goals((0.0, 0.0, 0.0), (2.8, 2.81, 2.8))
    with pytest.raises(RangeError):
        bus.enable_torque((2.8, 2.81, 2.8))
    bus.enable_torque(BOUND)
    bus.write_goals((-0.1, -0.1, -0.1), (2.8 * (1 + 1e-12),) * 3)
    bus.read()
    assert arm.commands[1][1] == pytest.approx(-0.1, abs=TICK)
    assert [command[2] for command in arm.commands] == pytest.approx([2.8] * 3, abs=CURRENT_UNIT)
    bus.close()


def test_a_hardware_error_is_reported_and_forbids_torque(
    bus: ServoBus, emulator: ServoBusEmulator, arm: BenchArm
) -> None:
    emulator.raise_hardware_error(3, OVERLOAD)
    assert bus.read().hardware_error == (0, 0, OVERLOAD)
    with pytest.raises(ServoFault, match=r"servo 3.*overload") as caught:
        bus.enable_torque(BOUND)
    assert caught.value.code == OVERLOAD
    assert arm.torque_enabled() == [False, False, False]


def test_a_missing_servo_forbids_torque(bus: ServoBus, emulator: ServoBusEmulator, arm: BenchArm) -> None:
    emulator.faults.missing = {1}
    with pytest.raises(NoAnswer, match="servo 1"):
        bus.enable_torque(BOUND)
    assert arm.torque_enabled() == [False, False, False]


def test_if_one_servo_rejects_torque_all_are_switched_off(
    bus: ServoBus, emulator: ServoBusEmulator, arm: BenchArm
) -> None:
    bus.read()
    emulator.faults.next_reply("drop", 3, 5)
    emulator.servo(3).write = lambda *request: 1
    with pytest.raises(DriverError):
        bus.enable_torque(BOUND)
    assert arm.torque_enabled()[:2] == [False, False]


def test_torque_off_reaches_the_servos_that_answer(bus: ServoBus, emulator: ServoBusEmulator, arm: BenchArm) -> None:
    bus.enable_torque(BOUND)
    emulator.faults.missing = {1}
    bus.disable_torque()
    assert arm.torque_enabled() == [True, False, False]


def test_goals_that_the_port_does_not_accept_are_an_error_and_sent_again(
    bus: ServoBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert bus.exchange((0.0, 0.0, 0.0), BOUND).complete
    monkeypatch.setattr(bus._link._handler, "writePort", lambda packet: 0)
    with pytest.raises(PortGone):
        bus.exchange((0.1, 0.1, 0.1), BOUND)
