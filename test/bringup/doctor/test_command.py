# SPDX-License-Identifier: Apache-2.0
"""`deltacharger doctor` as people and programs call it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator

from ...emulated_ports import IDS
from ...waiting import wait_until
from .. import command

pytestmark = pytest.mark.realtime


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    code, out, _ = command.run(capsys, "doctor", *words, "--json")
    value = json.loads(out)
    assert isinstance(value, dict)
    return code, value


def by_level(value: dict[str, Any], level: str) -> dict[str, str]:
    return {finding["part"]: finding["message"] for finding in value["findings"] if finding["level"] == level}


def test_nothing_is_wrong_with_the_simulated_scene(capsys: pytest.CaptureFixture[str]) -> None:
    def sound() -> dict[str, Any]:  # a computer that others keep busy does lose replies and frames
        code, value = run(capsys, "--scene", "simulated")
        return value if code == 0 else {}

    value = wait_until(sound, "a report without a fault")
    assert by_level(value, "wrong") == {}
    assert (value["success"], value["scene"]) == (True, "simulated")
    assert set(by_level(value, "ok")) >= {"servo 1", "servo 2", "servo 3", "board", "tactile link", "power", "probe"}


def test_people_read_levels_and_remedies_and_progress_goes_to_stderr(
    capsys: pytest.CaptureFixture[str], servo_port: str
) -> None:
    assert main(["doctor", "--set-baud", "1000000", "--servo-port", servo_port]) == 0
    captured = capsys.readouterr()
    assert "ok     servo 2" in captured.out
    assert captured.out.rstrip().endswith("0 wrong, 0 worth a look, 4 as they should be")
    assert "looking for servos" in captured.err
    assert main(["doctor", "--set-baud", "1000000", "--servo-port", "/dev/nothing"]) == 1
    assert "-> plug" in capsys.readouterr().out


def test_a_scene_decides_speed_and_ids_and_the_command_line_the_ports(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, servos: ServoBusEmulator, servo_port: str, board_port: str
) -> None:
    for servo in IDS:
        servos.set_speed(servo, 4)
    scene = tmp_path / "robot.yaml"
    scene.write_text(
        f"ports: {{servo: /dev/nothing, board: {board_port}}}\nparameters: {{servo_node: {{baud_rate: 2000000}}}}\n"
    )
    _, value = run(capsys, "--scene", str(scene), "--servo-port", servo_port)
    assert set(by_level(value, "wrong")) <= {"servo line", "tactile link"}  # which a busy computer spoils
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


@pytest.mark.parametrize(
    "words",
    [
        ("--set-baud", "1000000"),
        ("--set-baud", "12345", "--servo-port", "/dev/null"),
        ("--set-baud", "57600", "--servo-port", "/dev/null", "--ids", "300"),
        ("--set-baud", "57600", "--servo-port", "/dev/null", "--scene", "bench"),
        ("--ids", "1"),
        ("--scene", "nowhere"),
        ("--scene", "simulated", "--servo-port", "/dev/null"),
        ("--port", "/dev/null"),
    ],
)
def test_wrong_usage_is_2_with_one_object(capsys: pytest.CaptureFixture[str], words: tuple[str, ...]) -> None:
    code, value = run(capsys, *words)
    assert (code, value["success"]) == (2, False)
    assert value["error"]


LACKING = {
    "rclpy": ("rclpy", "raise ImportError(\"No module named 'rclpy'\", name='rclpy')"),
    "rclpy that crashes": ("rclpy", "import os; os._exit(11)"),
    "dynamixel_sdk": ("dynamixel_sdk", "raise ImportError('no SDK', name='dynamixel_sdk')"),
    "serial": ("serial", "raise ImportError('no serial', name='serial')"),
    "yaml": ("yaml", "raise ImportError('no yaml', name='yaml')"),
}
"""What a computer may lack: the module, and what stands in its place."""


@pytest.fixture(scope="module")
def doctors(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, subprocess.Popen[str]]]:
    """Doctors in processes of their own, all at once: each takes seconds, mostly to wait."""
    running: dict[str, subprocess.Popen[str]] = {}

    def start(name: str, *words: str, path: str = "") -> None:
        command = (sys.executable, "-m", "deltacharger_bringup.cli", "doctor", *words, "--json")
        variables = {**os.environ, "PYTHONPATH": path} if path else None
        running[name] = subprocess.Popen(
            command, env=variables, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    try:
        for lacking, (module, body) in LACKING.items():
            folder = tmp_path_factory.mktemp("lacking")
            (folder / f"{module}.py").write_text(body)
            start(lacking, "--scene", "simulated", path=str(folder))
        nowhere = tmp_path_factory.mktemp("nowhere")
        scene = nowhere / "robot.yaml"
        scene.write_text(f"ports: {{servo: {nowhere}/ttyUSB0, board: {nowhere}/ttyACM0}}\n")
        start("nothing plugged in", "--scene", str(scene))
        start("one device", "--servo-port", "/dev/null", "--board-port", "/dev/null")
        yield running
    finally:
        for process in running.values():
            process.kill()
            process.communicate()


def ended(process: subprocess.Popen[str]) -> tuple[int, dict[str, Any]]:
    out, err = process.communicate()
    assert "Traceback" not in err
    value = json.loads(out)
    assert isinstance(value, dict)
    return process.returncode, value


def test_with_nothing_plugged_in_both_ports_are_wrong(doctors: dict[str, subprocess.Popen[str]]) -> None:
    code, value = ended(doctors["nothing plugged in"])
    assert code == 1
    assert set(by_level(value, "wrong")) == {"servo port", "board port"}
    assert all(finding["remedy"] for finding in value["findings"] if finding["level"] != "ok")
    assert value["success"] is False


def test_one_device_cannot_be_both(doctors: dict[str, subprocess.Popen[str]]) -> None:
    code, value = ended(doctors["one device"])
    assert code == 1
    assert "are one device" in by_level(value, "wrong")["ports"]


@pytest.mark.parametrize(
    ("lacking", "part", "remedy"),
    [
        ("rclpy", "rclpy", "ros-rclpy"),
        ("rclpy that crashes", "rclpy", "one ROS installation"),
        ("dynamixel_sdk", "dynamixel-sdk", "dynamixel-sdk"),
        ("serial", "pyserial", "pyserial"),
        ("yaml", "PyYAML", "pyyaml"),
    ],
)
def test_it_works_without_what_it_looks_for(
    doctors: dict[str, subprocess.Popen[str]], lacking: str, part: str, remedy: str
) -> None:
    code, value = ended(doctors[lacking])
    assert code == 1
    wrong = [finding for finding in value["findings"] if finding["level"] == "wrong" and finding["part"] == part]
    assert len(wrong) == 1
    assert remedy in wrong[0]["remedy"]
    assert {"python", "ros domain"} <= set(by_level(value, "ok"))
