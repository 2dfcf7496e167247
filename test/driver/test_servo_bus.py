# SPDX-License-Identifier: Apache-2.0
"""The servo bus: every servo is configured or reported with all its faults; torque, goals and faults."""

import math
from typing import Any

import pytest

from deltacharger_core.servo_types import MX_64
from deltacharger_driver.errors import DriverError, HandshakeError, NoAnswer, RangeError, ServoFault
from deltacharger_driver.servos.bus import ServoBus, motion_registers
from deltacharger_driver.servos.registers import GAINS, REGISTERS, TICK, WATCHDOG, BusSettings
from deltacharger_sim.emulators.servo import OK, ControlTable
from deltacharger_sim.emulators.servo_bus import ServoBusEmulator

from ..plants import BenchArm
from .servo_rig import BOUND, OVERLOAD, START


def test_signs_follow_the_mounting(line: Any, arm: BenchArm) -> None:
    bus = ServoBus(BusSettings(line.path, zero_ticks=(2048, 2000, 2048), direction=(1, 1, -1)), line.handler)
    bus.open()
    bus.enable_torque(BOUND)
    arm.load[2] = -0.7
    while (snapshot := bus.read()).current[2] > -0.4:
        bus.clock.sleep(0.01)
    angle = arm.angles[2]
    bus.close()
    assert snapshot.angle[0] == pytest.approx(-0.7, abs=TICK)
    assert snapshot.angle[1] == pytest.approx(-0.5 + 48 * TICK, abs=TICK)
    assert snapshot.angle[2] == pytest.approx(-angle, abs=0.02)


@pytest.mark.parametrize(
    ("angles", "currents"),
    [((math.nan, 0, 0), BOUND), ((0, 0, 0), (0.1, math.nan, 0.1)), ((0, 0, 0), (-0.1, 0.1, 0.1))],
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
    assert [command[2] for command in arm.commands] == pytest.approx([2.8] * 3, abs=MX_64.current_unit)
    bus.close()


def test_a_missing_servo_and_a_hardware_error_forbid_torque(
    bus: ServoBus, emulator: ServoBusEmulator, arm: BenchArm
) -> None:
    emulator.faults.missing = {1}
    with pytest.raises(NoAnswer, match="servo 1"):
        bus.enable_torque(BOUND)
    emulator.faults.missing = set()
    emulator.servo(3).raise_error(OVERLOAD)
    assert bus.read().hardware_error == (0, 0, OVERLOAD)
    with pytest.raises(ServoFault, match=r"servo 3.*overload"):
        bus.enable_torque(BOUND)
    assert arm.torque_enabled() == [False, False, False]


def test_if_one_servo_rejects_torque_all_are_switched_off(
    bus: ServoBus, emulator: ServoBusEmulator, arm: BenchArm
) -> None:
    bus.read()
    emulator.faults.inject("drop", 5, 3)
    emulator.servo(3).write = lambda *request: 1
    with pytest.raises(DriverError):
        bus.enable_torque(BOUND)
    assert arm.torque_enabled()[:2] == [False, False]


def test_torque_off_reaches_the_servos_that_answer(bus: ServoBus, emulator: ServoBusEmulator, arm: BenchArm) -> None:
    bus.enable_torque(BOUND)
    emulator.faults.missing = {1}
    bus.disable_torque()
    assert arm.torque_enabled() == [True, False, False]


def test_id_speed_and_offset_are_never_written_and_eeprom_only_once(
    closed: ServoBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = []
    write = ControlTable.write

    def spy(table: ControlTable, address: int, data: bytes) -> Any:
        written.extend(range(address, address + len(data)))
        return write(table, address, data)

    monkeypatch.setattr(ControlTable, "write", spy)
    closed.open()
    closed.read()
    assert not {7, 8, 12, 13, 20, 21, 22, 23} & set(written)
    closed.close()
    written.clear()
    closed.open()
    assert not [address for address in written if address < 64]


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("model", 1020, "1020"),
        ("homing_offset", 12, "zero_ticks"),
        ("min_voltage", 125, "95 to 110"),
        ("current_limit", 297, "current_max"),
        ("shutdown", 0, "overheating and overload.*36"),
    ],
)
def test_an_unexpected_servo_is_named_and_not_changed(
    closed: ServoBus, emulator: ServoBusEmulator, name: str, value: int, reason: str
) -> None:
    emulator.servo(2).table.set(name, value)
    with pytest.raises(HandshakeError, match=f"servo 2.*({reason})") as caught:
        closed.open()
    assert len(caught.value.faults) == 1
    assert emulator.servo(2).table.get(name) == value
    assert not closed.is_open


def test_every_fault_of_every_servo_is_reported_and_good_servos_are_configured(
    closed: ServoBus, emulator: ServoBusEmulator
) -> None:
    emulator.servo(1).table.set("homing_offset", 12)
    emulator.servo(1).table.set("shutdown", 0)
    emulator.servo(1).table.set("torque_enable", 1)
    emulator.servo(3).table.set("current_limit", 297)
    with pytest.raises(HandshakeError) as caught:
        closed.open()
    assert [fault[:7] for fault in caught.value.faults] == ["servo 1", "servo 1", "servo 3"]
    assert emulator.servo(1).table.get("torque_enable") == 0
    assert emulator.servo(2).table.get("bus_watchdog") in (WATCHDOG, 255)  # armed; it trips after the port is closed
    assert emulator.servo(3).table.get("operating_mode") == 3


def refuse(emulator: ServoBusEmulator, addresses: set[int], answer: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make servo 2 answer `answer` to writes of some registers without executing them."""
    write, stubborn = ControlTable.write, emulator.servo(2).table

    def refusing(table: ControlTable, address: int, data: bytes) -> Any:
        return (answer, {}) if table is stubborn and address in addresses else write(table, address, data)

    monkeypatch.setattr(ControlTable, "write", refusing)


@pytest.mark.parametrize("name", ["operating_mode", "position_d_gain"])
def test_what_other_software_left_in_a_register_that_acts_on_motion_is_overwritten_or_named(
    line: Any, emulator: ServoBusEmulator, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    emulator.servo(2).table.set(name, 4)
    bus = ServoBus(BusSettings(line.path, gains=(500, 3)), line.handler)
    bus.open()
    assert (
        emulator.servo(2).table.get(name) == (motion_registers(MX_64) | dict(zip(GAINS, (500, 3), strict=True)))[name]
    )
    bus.close()
    emulator.servo(2).table.set(name, 4)
    refuse(emulator, {REGISTERS[name].address}, OK, monkeypatch)
    with pytest.raises(HandshakeError, match=f"servo 2: {name.replace('_', ' ')} reads 4"):
        bus.open()


def test_two_servos_with_one_id_are_suggested_as_a_cause(closed: ServoBus, emulator: ServoBusEmulator) -> None:
    emulator.faults.rate_of[2] = {"corrupt": 1.0}
    with pytest.raises(HandshakeError, match="two servos with this id"):
        closed.open()


def test_servos_set_to_send_no_replies_are_set_to_reply(closed: ServoBus, emulator: ServoBusEmulator) -> None:
    for servo, level in ((1, 0), (3, 1)):
        emulator.servo(servo).table.set("status_return_level", level)
    closed.open()
    assert [emulator.servo(servo).table.get("status_return_level") for servo in (1, 2, 3)] == [2, 2, 2]


@pytest.mark.parametrize("settings", [{"ids": (1, 1, 2)}, {"direction": (1, 0, 1)}])
def test_impossible_settings_are_refused(settings: dict[str, Any]) -> None:
    with pytest.raises(DriverError):
        BusSettings("/dev/null", **settings)


@pytest.mark.parametrize(("turns", "sign"), [(-2, 1), (1, -1)])
def test_whole_turns_that_a_servo_forgot_at_power_up_are_taken_out(
    line: Any, arm: BenchArm, turns: int, sign: int
) -> None:
    zeros = (2048 + turns * 4096, 2048, 2048)
    bus = ServoBus(BusSettings(line.path, zero_ticks=zeros, direction=(sign, 1, 1)), line.handler)
    bus.open()
    angle = sign * START[0]
    assert bus.read().angle[0] == pytest.approx(angle, abs=TICK)
    bus.enable_torque(BOUND)
    bus.exchange((angle + 0.05, *START[1:]), BOUND)
    assert arm.commands[0] is not None
    assert arm.commands[0][1] == pytest.approx(START[0] + sign * 0.05, abs=TICK)
    bus.close()


def test_an_arm_outside_its_range_gets_no_torque_until_it_is_within(closed: ServoBus, arm: BenchArm) -> None:
    arm._angle[1] = 1.5
    closed.open()
    with pytest.raises(ServoFault, match=r"servo 2.*stands at 86°"):
        closed.enable_torque(BOUND)
    assert arm.torque_enabled() == [False] * 3
    arm._angle[1] = 0.5
    assert closed.enable_torque(BOUND).angle[1] == pytest.approx(0.5, abs=TICK)


def test_a_servo_that_starts_with_the_computer_is_found_and_one_that_does_not_is_named(
    closed: ServoBus, emulator: ServoBusEmulator, clock: Any
) -> None:
    answers, up = emulator.servo(2).answers, clock() + 0.6
    emulator.servo(2).answers = lambda now: now >= up and answers(now)  # type: ignore[method-assign]
    closed.open()
    assert closed.read().complete
    closed.close()
    for missing, words in (({2}, "servo 2 does not answer"), ({1, 2, 3}, "no servo answers.*swapped")):
        emulator.faults.missing = missing
        with pytest.raises(HandshakeError, match=f"{words}.*deltacharger doctor") as caught:
            closed.open()
        assert len(caught.value.faults) == 1
        assert not closed.is_open
