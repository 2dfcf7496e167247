# SPDX-License-Identifier: Apache-2.0
"""Findings of the doctor for healthy servos and for each fault that it can name."""

from __future__ import annotations

import pytest

from deltacharger_driver.emulators.bench_arm import BenchArm
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.port_identity import SERVO_SPEEDS
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.servos.mx64 import WATCHDOG_TRIPPED

from ...emulated_ports import written
from .found import one, only, servo_findings


def test_healthy_servos_are_ok_and_nothing_is_written(servos: ServoBusEmulator, servo_port: str) -> None:
    before = written(servos)
    found = servo_findings(servo_port)
    assert {finding.level for finding in found} == {"ok"}
    assert {finding.part for finding in found} == {"servo 1", "servo 2", "servo 3", "servo line"}
    assert written(servos) == before


def test_a_servo_with_factory_speed_is_named_with_the_command_to_fix_it(
    servos: ServoBusEmulator, servo_port: str
) -> None:
    servos.set_speed(2, 1)
    finding = one(servo_findings(servo_port), "wrong", "servo 2")
    assert "57600" in finding.message
    assert f"doctor --servo-port {servo_port} --set-baud 1000000 --ids 2" in finding.remedy


def test_missing_old_and_unknown_servos_are_distinguished(servos: ServoBusEmulator, servo_port: str) -> None:
    servos.use_protocol_1(1)
    servos.servo(3).table.set("id", 9)
    found = servo_findings(servo_port, SERVO_SPEEDS)
    assert "firmware" in one(found, "wrong", "servo 1").remedy
    assert "does not answer at any speed" in one(found, "wrong", "servo 3").message
    assert "id 9" in one(found, "hint", "servos").message
    assert only([f for f in found if f.part == "servo 2"], "wrong") == []


def test_two_servos_with_one_id_are_named() -> None:
    twins = ServoBusEmulator(BenchArm(), ids=(1, 2, 2))
    with PseudoTerminal(twins) as terminal:
        found = servo_findings(terminal.path)
    assert "two servos have this id" in one(found, "wrong", "servo 2").message


def test_faults_of_servos_are_reported(servos: ServoBusEmulator, servo_port: str) -> None:
    servos.raise_hardware_error(1, 1 << 5)
    servos.servo(2).table.set("torque_enable", 1)
    servos.servo(1).table.set("bus_watchdog", WATCHDOG_TRIPPED)
    servos.servo(3).table.set("current_limit", 298)
    found = servo_findings(servo_port)
    assert "overload" in one(found, "wrong", "servo 1").message
    assert "watchdog has tripped" in one(found, "hint", "servo 1").message
    assert "torque is on" in one(found, "hint", "servo 2").message
    finding = one(found, "wrong", "servo 3")
    assert "current limit is 298" in finding.message
    assert "1941" in finding.remedy


def test_a_bad_line_is_wrong(servos: ServoBusEmulator, servo_port: str) -> None:
    servos.faults.rate["drop"] = 0.15
    finding = one(servo_findings(servo_port), "wrong", "servo line")
    assert "silent" in finding.message
    assert "plugs" in finding.remedy


@pytest.mark.parametrize(
    ("fixture", "words"), [("board_port", "the board is here"), ("silent_port", "no servo answers")]
)
def test_a_port_without_servos_is_wrong(request: pytest.FixtureRequest, fixture: str, words: str) -> None:
    found = servo_findings(request.getfixturevalue(fixture))
    assert [finding.level for finding in found] == ["wrong"]
    assert words in found[0].message
