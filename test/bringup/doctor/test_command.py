# SPDX-License-Identifier: Apache-2.0
"""`deltacharger doctor` on the command line: text, JSON, exit codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator

from ...emulated_ports import IDS
from ...waiting import wait_until
from .. import command


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    code, out, _ = command.run(capsys, "doctor", *words, "--json")
    value = json.loads(out)
    assert isinstance(value, dict)
    return code, value


def by_level(value: dict[str, Any], level: str) -> dict[str, str]:
    return {finding["part"]: finding["message"] for finding in value["findings"] if finding["level"] == level}


def test_nothing_is_wrong_with_the_simulated_scene(capsys: pytest.CaptureFixture[str]) -> None:
    def sound() -> dict[str, Any]:  # a busy computer loses replies and frames
        code, value = run(capsys, "--scene", "simulated")
        return value if code == 0 else {}

    value = wait_until(sound, "a report without a fault")
    assert by_level(value, "wrong") == {}
    assert (value["success"], value["scene"]) == (True, "simulated")
    assert set(by_level(value, "ok")) >= {"servo 1", "servo 2", "servo 3", "board", "tactile link", "power", "probe"}


def test_text_has_levels_and_remedies_and_progress_is_on_stderr(
    capsys: pytest.CaptureFixture[str], servo_port: str
) -> None:
    assert main(["doctor", "--set-baud", "1000000", "--servo-port", servo_port]) == 0
    captured = capsys.readouterr()
    assert "ok     servo 2" in captured.out
    assert captured.out.rstrip().endswith("0 wrong, 0 hints, 4 ok")
    assert "checking the servos" in captured.err
    assert main(["doctor", "--set-baud", "1000000", "--servo-port", "/dev/nothing"]) == 1
    assert "-> plug" in capsys.readouterr().out


def test_speed_and_ids_are_from_the_scene_and_ports_from_the_command_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, servos: ServoBusEmulator, servo_port: str, board_port: str
) -> None:
    for servo in IDS:
        servos.set_speed(servo, 4)
    scene = tmp_path / "robot.yaml"
    scene.write_text(
        f"ports: {{servo: /dev/nothing, board: {board_port}}}\nparameters: {{servo_node: {{baud_rate: 2000000}}}}\n"
    )
    _, value = run(capsys, "--scene", str(scene), "--servo-port", servo_port)
    assert set(by_level(value, "wrong")) <= {"servo line", "tactile link"}  # may be wrong on a busy computer
    assert value["servo_port"] == servo_port
    assert "2000000" in next(f["message"] for f in value["findings"] if f["part"] == "servo 1")


def test_set_baud_from_the_command_line(
    capsys: pytest.CaptureFixture[str], servos: ServoBusEmulator, servo_port: str
) -> None:
    servos.set_speed(2, 1)
    code, value = run(capsys, "--set-baud", "1000000", "--servo-port", servo_port, "--ids", "1", "2", "3")
    assert (code, value["counts"]["wrong"]) == (0, 0)
    assert servos.servo(2).table.get("baud") == 3
    code, value = run(capsys, "--set-baud", "1000000", "--servo-port", "/dev/nothing")
    assert (code, list(by_level(value, "wrong"))) == (1, ["servo port"])


def test_servos_connected_to_the_board(
    capsys: pytest.CaptureFixture[str], servos: ServoBusEmulator, one_cable: str
) -> None:
    servos.set_speed(2, 1)
    behind = ("--servo-port", "board", "--board-port", one_cable)
    code, value = run(capsys, *behind)
    assert (code, "servo 2" in by_level(value, "wrong")) == (1, True)
    remedy = next(f["remedy"] for f in value["findings"] if f["part"] == "servo 2")
    assert remedy == f"run: deltacharger doctor {' '.join(behind)} --set-baud 1000000 --ids 2"
    assert run(capsys, *behind, "--set-baud", "1000000")[0] == 0
    assert servos.servo(2).table.get("baud") == 3


def test_a_board_without_servos_is_named(capsys: pytest.CaptureFixture[str], board_port: str) -> None:
    code, value = run(capsys, "--servo-port", "board", "--board-port", board_port)
    assert (code, list(by_level(value, "wrong"))) == (1, ["servo port"])
    assert "no servos behind the board" in by_level(value, "wrong")["servo port"]
    assert run(capsys, "--servo-port", "board")[0] == 1


@pytest.mark.parametrize(
    "words",
    [
        ("--set-baud", "1000000"),
        ("--set-baud", "57600", "--servo-port", "board"),
        ("--set-baud", "12345", "--servo-port", "/dev/null"),
        ("--set-baud", "57600", "--servo-port", "/dev/null", "--ids", "300"),
        ("--set-baud", "57600", "--servo-port", "/dev/null", "--scene", "bench"),
        ("--ids", "1"),
        ("--scene", "nowhere"),
        ("--scene", "simulated", "--servo-port", "/dev/null"),
        ("--port", "/dev/null"),
    ],
)
def test_wrong_usage_ends_with_2_and_one_object(capsys: pytest.CaptureFixture[str], words: tuple[str, ...]) -> None:
    code, value = run(capsys, *words)
    assert (code, value["success"]) == (2, False)
    assert value["error"]
