# SPDX-License-Identifier: Apache-2.0
"""`deltacharger doctor` on the command line: text, JSON, exit codes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from deltacharger_driver.emulators.servo_bus import ServoBusEmulator

from ...emulated_ports import IDS
from ..command import Capture, answer, run


def by_level(value: dict[str, Any], level: str) -> dict[str, str]:
    return {finding["part"]: finding["message"] for finding in value["findings"] if finding["level"] == level}


@pytest.mark.rest
def test_the_simulated_scene_is_examined(capsys: Capture) -> None:
    _, value = answer(capsys, "doctor", "--scene", "simulated")
    assert value["scene"] == "simulated"
    assert set(by_level(value, "wrong")) <= {"servo line", "tactile link"}, "a busy computer loses replies and frames"
    assert set(by_level(value, "ok")) >= {"servo 1", "servo 2", "servo 3", "board", "power", "probe"}


def test_text_has_levels_and_remedies_and_progress_is_on_stderr(capsys: Capture, servo_port: str) -> None:
    code, out, err = run(capsys, "doctor", "--set-baud", "1000000", "--servo-port", servo_port)
    assert (code, "servo 2" in out, "servos" in err) == (0, True, True)
    assert out.rstrip().endswith("0 wrong, 0 hints, 4 ok")
    code, out, _ = run(capsys, "doctor", "--set-baud", "1000000", "--servo-port", "/dev/nothing")
    assert (code, "-> " in out) == (1, True)


@pytest.mark.rest
def test_speed_and_ids_are_from_the_scene_and_ports_from_the_command_line(
    capsys: Capture, tmp_path: Path, servos: ServoBusEmulator, servo_port: str, board_port: str
) -> None:
    for servo in IDS:
        servos.set_speed(servo, 4)
    scene = tmp_path / "robot.yaml"
    scene.write_text(
        f"ports: {{servo: /dev/nothing, board: {board_port}}}\nparameters: {{servo_node: {{baud_rate: 2000000}}}}\n"
    )
    _, value = answer(capsys, "doctor", "--scene", scene, "--servo-port", servo_port)
    assert set(by_level(value, "wrong")) <= {"servo line", "tactile link"}  # may be wrong on a busy computer
    assert value["servo_port"] == servo_port
    assert "2000000" in next(f["message"] for f in value["findings"] if f["part"] == "servo 1")


def test_set_baud_from_the_command_line(capsys: Capture, servos: ServoBusEmulator, servo_port: str) -> None:
    servos.set_speed(2, 1)
    words = ("doctor", "--set-baud", "1000000", "--ids", "1", "2", "3", "--servo-port")
    code, value = answer(capsys, *words, servo_port)
    assert (code, value["counts"]["wrong"], servos.servo(2).table.get("baud")) == (0, 0, 3)
    code, value = answer(capsys, *words, "/dev/nothing")
    assert (code, list(by_level(value, "wrong"))) == (1, ["servo port"])


@pytest.mark.rest
def test_servos_connected_to_the_board(capsys: Capture, servos: ServoBusEmulator, one_cable: str) -> None:
    servos.set_speed(2, 1)
    behind = ("--servo-port", "board", "--board-port", one_cable)
    code, value = answer(capsys, "doctor", *behind)
    assert (code, "servo 2" in by_level(value, "wrong")) == (1, True)
    remedy = next(f["remedy"] for f in value["findings"] if f["part"] == "servo 2")
    assert f"deltacharger doctor {' '.join(behind)} --set-baud 1000000 --ids 2" in remedy
    assert run(capsys, "doctor", *behind, "--set-baud", "1000000")[0] == 0
    assert servos.servo(2).table.get("baud") == 3


@pytest.mark.rest
def test_a_board_without_servos_is_named(capsys: Capture, board_port: str) -> None:
    code, value = answer(capsys, "doctor", "--servo-port", "board", "--board-port", board_port)
    assert (code, list(by_level(value, "wrong"))) == (1, ["servo port"])
    assert run(capsys, "doctor", "--servo-port", "board")[0] == 1
