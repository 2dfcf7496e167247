# SPDX-License-Identifier: Apache-2.0
"""`deltacharger doctor --set-baud`: registers and servos that it writes."""

from __future__ import annotations

from deltacharger_bringup.doctor.set_baud import set_baud
from deltacharger_driver.emulators.bench_arm import BenchArm
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.pseudo_terminal import PseudoTerminal

from ...emulated_ports import IDS, written
from .found import LIKELY, only, servo_findings


def test_set_baud_writes_the_speed_and_torque_off_and_nothing_else(servos: ServoBusEmulator, servo_port: str) -> None:
    for servo in (1, 3):
        servos.set_speed(servo, 1)
    servos.servo(1).table.set("torque_enable", 1)
    before = written(servos)
    found = list(set_baud(servo_port, 1_000_000, None, LIKELY))
    assert [finding.level for finding in found] == ["ok", "ok", "ok"]
    assert "from 57600 to 1000000" in found[0].message
    assert "already" in found[1].message
    changed = {key for key, value in written(servos).items() if before[key] != value}
    assert changed == {(1, "baud"), (3, "baud"), (1, "torque_enable")}
    assert {finding.part for finding in only(servo_findings(servo_port), "wrong")} <= {
        "servo line"
    }  # on a busy computer


def test_set_baud_writes_only_the_given_ids(servos: ServoBusEmulator, servo_port: str) -> None:
    for servo in IDS:
        servos.set_speed(servo, 2)
    found = list(set_baud(servo_port, 57600, [2, 2, 7], (57600, 115200)))
    assert [(finding.part, finding.level) for finding in found] == [("servo 2", "ok"), ("servo 7", "wrong")]
    assert [servos.servo(servo).table.get("baud") for servo in IDS] == [2, 1, 2]


def test_set_baud_refuses_duplicate_ids_and_protocol_1(servos: ServoBusEmulator, servo_port: str) -> None:
    servos.use_protocol_1(3)
    before = written(servos)
    assert "nothing was written" in next(iter(set_baud(servo_port, 57600, [3], LIKELY))).message
    assert written(servos) == before
    twins = ServoBusEmulator(BenchArm(), ids=(1, 2, 2))
    with PseudoTerminal(twins) as terminal:
        found = list(set_baud(terminal.path, 57600, [2], LIKELY))
    assert "two servos have this id" in found[0].message


def test_set_baud_on_the_board_writes_nothing(board_port: str) -> None:
    found = list(set_baud(board_port, 57600, None))
    assert [finding.level for finding in found] == ["wrong"]
    assert "the board is here" in found[0].message
