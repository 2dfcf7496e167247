# SPDX-License-Identifier: Apache-2.0
"""Findings of the doctor for a healthy board and for each fault that it can name."""

from __future__ import annotations

import math

import pytest

from deltacharger_bringup.doctor.board import examine_board
from deltacharger_bringup.doctor.findings import Finding
from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.board.protocol import BoardFault
from deltacharger_driver.emulators.bench_plant import BenchPlant
from deltacharger_driver.emulators.board import BoardEmulator
from deltacharger_driver.pseudo_terminal import PseudoTerminal

from ...waiting import wait_until
from .found import one, only


def board_findings(port: str, watched: float = 0.5) -> list[Finding]:
    return list(examine_board(port, 1_000_000, watched))


def test_a_healthy_board_is_ok_and_unchanged(board: BoardEmulator, board_port: str) -> None:
    found = board_findings(board_port)
    assert not only(found, "wrong")
    assert "0 of" in one(found, "ok", "tactile link").message
    assert {f.part for f in found} == {"board", "tactile link", "left pad", "right pad", "tare", "power", "probe"}
    assert not board.contactor_commanded
    assert "not done" in one(found, "ok", "tare").message


def test_dead_taxels_are_named_and_too_many_are_wrong(board: BoardEmulator, board_port: str) -> None:
    board.set_dead(0, 3, 7)
    for column in range(4):
        board.set_dead(1, 0, column)
    found = board_findings(board_port)
    assert "row 3 column 7" in one(found, "hint", "left pad").message
    assert "4 of 100" in one(found, "wrong", "right pad").message


def test_lost_frames_are_counted(board: BoardEmulator, board_port: str) -> None:
    board.faults.probability["drop"] = 0.1  # one greeting in a hundred is lost too

    def lost() -> list[Finding]:
        return [each for each in only(board_findings(board_port, 1.0), "wrong") if each.part == "tactile link"]

    (finding,) = wait_until(lost, "lost frames")
    assert " 0 of" not in finding.message
    assert "cables" in finding.remedy


def test_a_slow_board_gives_a_hint(board: BoardEmulator, board_port: str) -> None:
    board.faults.delay = 0.04
    assert "heartbeats" in one(board_findings(board_port), "hint", "board").message


def test_a_latched_fault_is_wrong(board: BoardEmulator, board_port: str) -> None:
    with BoardLink(board_port):  # wait for the boot, which clears the fault
        board.trip(BoardFault.OVER_CURRENT)
    found = board_findings(board_port)
    assert "over current" in one(found, "wrong", "power").message


@pytest.mark.parametrize(
    ("resistance", "level", "words"), [(0.2, "wrong", "short circuit"), (25.0, "hint", "a target is connected")]
)
def test_the_probe_result_is_judged(resistance: float, level: str, words: str) -> None:
    plant = BenchPlant()
    plant.resistance = resistance
    with PseudoTerminal(BoardEmulator(plant)) as terminal:
        assert words in one(board_findings(terminal.path), level, "probe").message


@pytest.mark.parametrize(
    ("volts", "level", "words"),
    [
        (22.6, "wrong", "22.6 V, outside 22.7 to 29.8 V"),
        (22.7, "ok", "battery 22.7 V"),
        (29.8, "ok", "battery 29.8 V"),
        (29.9, "wrong", "29.9 V, outside"),
        (math.nan, "hint", "not measured"),
    ],
)
def test_the_battery_is_judged_as_docking_judges_it(volts: float, level: str, words: str) -> None:
    plant = BenchPlant()
    plant.battery = volts
    with PseudoTerminal(BoardEmulator(plant)) as terminal:
        assert words in one(board_findings(terminal.path), level, "power").message


@pytest.mark.parametrize(
    ("volts", "level", "words"), [(math.nan, "hint", "live"), (26.0, "wrong", "has a power stage")]
)
def test_with_electrodes_wired_to_the_battery_there_is_no_probe(volts: float, level: str, words: str) -> None:
    plant = BenchPlant()
    plant.battery = volts
    with PseudoTerminal(BoardEmulator(plant)) as terminal:
        found = list(examine_board(terminal.path, 1_000_000, 0.5, wired=True))
    assert words in one(found, level, "power").message
    assert "probe" not in {finding.part for finding in found}


@pytest.mark.parametrize(
    ("fixture", "words"), [("servo_port", "the servos are here"), ("silent_port", "no answer to HELLO")]
)
def test_a_port_without_the_board_is_wrong(request: pytest.FixtureRequest, fixture: str, words: str) -> None:
    found = board_findings(request.getfixturevalue(fixture))
    assert [finding.level for finding in found] == ["wrong"]
    assert words in found[0].message
