# SPDX-License-Identifier: Apache-2.0
"""Findings of the doctor for ports, a board and servos, healthy and with each fault that it can name."""

import errno
import grp
import math
import os
from collections.abc import Callable, Iterable, Sequence

import pytest
import serial

from deltacharger_bringup.doctor import board as examiner
from deltacharger_bringup.doctor.environment import examine_port
from deltacharger_bringup.doctor.findings import Finding
from deltacharger_bringup.doctor.servos import examine_servos
from deltacharger_driver import port_identity, ports
from deltacharger_driver.board import link, protocol
from deltacharger_driver.servos.registers import WATCHDOG_TRIPPED
from deltacharger_sim.emulators.board import BoardEmulator
from deltacharger_sim.emulators.servo_bus import ServoBusEmulator

from ...emulated_ports import IDS, use_protocol_1, written
from ...plants import BenchArm, BenchPlant

LIKELY = (1_000_000, 57600)
"""Speeds to search if the others do not matter: each takes 0.2 s or more."""


def servo_findings(port: str, speeds: Sequence[int] = LIKELY) -> list[Finding]:
    return list(examine_servos(port, 1_000_000, IDS, 3.0, speeds))


def board_findings(port: str, watched: float = 0.15, **options: bool) -> list[Finding]:
    return list(examiner.examine_board(port, watched, **options))


def named(findings: Iterable[Finding], *expected: tuple[str, str, str]) -> None:
    """Check that the findings have these levels and parts once, with a noun in message or remedy; all help."""
    findings = list(findings)
    for level, part, noun in expected:
        (found,) = [each for each in findings if (each.level, each.part) == (level, part)]
        assert noun in f"{found.message} {found.remedy}", found
    assert all(each.remedy for each in findings if each.level == "wrong"), findings


def parts(findings: Iterable[Finding], level: str) -> set[str]:
    return {finding.part for finding in findings if finding.level == level}


def test_a_healthy_board_is_ok_and_unchanged(board: BoardEmulator, board_port: str) -> None:
    found = board_findings(board_port)
    assert not parts(found, "wrong")
    pads = {"left pad", "right pad", "tare"}
    assert {f.part for f in found} == {"board", "tactile link", *pads, "stage", "power", "probe"}
    named(found, ("ok", "tactile link", "0 of"), ("ok", "tare", "not done"))
    assert not board.contactor_commanded


def test_dead_taxels_and_a_latched_fault_are_named(board: BoardEmulator, board_port: str) -> None:
    board.set_dead(0, 3, 7)
    for column in range(4):
        board.set_dead(1, 0, column)
    with link.BoardLink(board_port):  # wait for the boot, which clears the fault
        board.trip(protocol.BoardFault.OVER_CURRENT)
    found = board_findings(board_port)
    named(found, ("hint", "left pad", "row 3 column 7"), ("wrong", "right pad", "4 of 100"))
    named(found, ("wrong", "power", "over current"))


def test_a_weld_is_cleared_on_request_unless_something_is_live(board: BoardEmulator, board_port: str) -> None:
    plant = board._power._plant
    with link.BoardLink(board_port):
        board.trip(protocol.BoardFault.CONTACTOR_WELDED)
    named(board_findings(board_port), ("wrong", "power", "--clear-weld"))
    named(board_findings(board_port, clear_weld=True), ("wrong", "weld", "24.0 V"), ("wrong", "power", "welded"))
    plant.resistance = math.inf
    found = board_findings(board_port, clear_weld=True)
    named(found, ("ok", "weld", "none"))
    assert not parts(found, "wrong")


@pytest.mark.parametrize(
    ("plant", "wired", "level", "part", "noun"),
    [
        ({"target": -24.0, "resistance": 0.1}, False, "wrong", "probe", "reversed polarity"),
        ({"target": 24.0, "resistance": 0.1}, False, "hint", "probe", "24.0 V between the electrodes: a target"),
        ({"battery": 22.6}, False, "wrong", "power", "22.6 V"),
        ({"battery": math.nan}, False, "hint", "power", "not measured"),
        ({"battery": math.nan}, True, "hint", "power", "live"),
        ({"battery": 26.0}, True, "wrong", "power", "power stage"),
    ],
)
def test_target_and_battery_are_judged_as_docking_judges_them(
    plant: dict[str, float], wired: bool, level: str, part: str, noun: str
) -> None:
    bench = BenchPlant()
    for name, value in plant.items():
        setattr(bench, name, value)
    with ports.PseudoTerminal(BoardEmulator(bench)) as terminal:
        found = board_findings(terminal.path, wired=wired)
    named(found, (level, part, noun))
    assert ("probe" in {finding.part for finding in found}) is not wired


@pytest.mark.parametrize(
    ("examine", "fixture", "noun"),
    [
        (board_findings, "servo_port", "servos are here"),
        (board_findings, "silent_port", "HELLO"),
        (servo_findings, "board_port", "board is here"),
        (servo_findings, "silent_port", "no servo"),
    ],
)
def test_a_port_of_something_else_is_wrong(
    request: pytest.FixtureRequest, examine: Callable[[str], Iterable[Finding]], fixture: str, noun: str
) -> None:
    (found,) = examine(request.getfixturevalue(fixture))
    assert (found.level, noun in found.message) == ("wrong", True)


def test_healthy_servos_are_ok_and_nothing_is_written(
    servos: ServoBusEmulator, servo_port: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ports, "USB_LATENCY", 0.016)  # s, the usual adapter's; this computer's threads are as slow
    before = written(servos)
    found = servo_findings(servo_port)
    assert {finding.level for finding in found} == {"ok"}
    assert parts(found, "ok") == {"servo 1", "servo 2", "servo 3", "servo line"}
    assert written(servos) == before


def test_a_servo_with_factory_speed_is_named(servos: ServoBusEmulator, servo_port: str) -> None:
    servos.servo(2).table.set("baud", 1)
    found = servo_findings(servo_port)
    named(found, ("wrong", "servo 2", "57600"))


@pytest.mark.rest
def test_missing_old_and_unknown_servos_are_distinguished(servos: ServoBusEmulator, servo_port: str) -> None:
    use_protocol_1(servos, 1)
    servos.servo(3).table.set("id", 9)
    found = servo_findings(servo_port, port_identity.SERVO_SPEEDS)
    named(found, ("wrong", "servo 1", "firmware"), ("wrong", "servo 3", "does not answer"), ("hint", "servos", "id 9"))
    assert "servo 2" not in parts(found, "wrong")


def test_faults_of_servos_are_reported(servos: ServoBusEmulator, servo_port: str) -> None:
    servos.servo(1).raise_error(1 << 5)
    servos.servo(2).table.set("torque_enable", 1)
    servos.servo(1).table.set("bus_watchdog", WATCHDOG_TRIPPED)
    servos.servo(3).table.set("current_limit", 298)
    found = servo_findings(servo_port)
    named(found, ("wrong", "servo 1", "overload"), ("hint", "servo 1", "watchdog"), ("hint", "servo 2", "torque is on"))
    named(found, ("wrong", "servo 3", "298"), ("wrong", "servo 3", "1941"))


@pytest.mark.rest
def test_a_bad_line_is_wrong(servos: ServoBusEmulator, servo_port: str) -> None:
    servos.faults.rate["drop"] = 0.15
    named(servo_findings(servo_port), ("wrong", "servo line", "plugs"))


@pytest.mark.rest
def test_two_servos_with_one_id_are_named() -> None:
    twins = ServoBusEmulator(BenchArm(), ids=(1, 2, 2))
    with ports.PseudoTerminal(twins) as terminal:
        named(servo_findings(terminal.path), ("wrong", "servo 2", "two servos"))


def test_a_busy_port_names_its_user(board_port: str) -> None:
    user = f"process {os.getpid()}"
    with open(board_port, "rb"):
        assert any(user in name for name in ports.holders(board_port))
    with serial.Serial(board_port, exclusive=True):
        named(examine_port("board port", board_port), ("wrong", "board port", user))
        assert len(ports.holders(board_port)) == 1, "the emulator's end of the terminal does not count"


def test_a_free_port_is_ok_and_a_forbidden_one_names_the_group(
    monkeypatch: pytest.MonkeyPatch, silent_port: str
) -> None:
    def refuse(*arguments: object, **options: object) -> None:
        raise serial.SerialException(errno.EACCES, "Permission denied")

    assert [finding.level for finding in examine_port("servo port", silent_port)] == ["ok"]
    serial.Serial(silent_port, exclusive=True).close()
    monkeypatch.setattr(serial, "Serial", refuse)
    group = grp.getgrgid(os.stat(silent_port).st_gid).gr_name
    named(examine_port("servo port", silent_port), ("wrong", "servo port", f"usermod -aG {group}"))
