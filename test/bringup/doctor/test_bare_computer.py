# SPDX-License-Identifier: Apache-2.0
"""`deltacharger doctor` on a computer that lacks something; not in real time, because of its many processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from .test_command import by_level

LACKING = {
    "rclpy": ("rclpy", "raise ImportError(\"No module named 'rclpy'\", name='rclpy')"),
    "rclpy that crashes": ("rclpy", "import os; os._exit(11)"),
    "rclpy of Jazzy": ("sitecustomize", "import sys; sys.modules['rclpy.experimental'] = None"),
    "dynamixel_sdk": ("dynamixel_sdk", "raise ImportError('no SDK', name='dynamixel_sdk')"),
    "serial": ("serial", "raise ImportError('no serial', name='serial')"),
    "yaml": ("yaml", "raise ImportError('no yaml', name='yaml')"),
}
"""What a computer may lack: the module and its replacement."""


@pytest.fixture(scope="module")
def doctors(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, subprocess.Popen[str]]]:
    """Run all doctors in parallel processes, because each takes seconds, mostly waiting."""
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


def test_one_device_for_both_ports_is_wrong(doctors: dict[str, subprocess.Popen[str]]) -> None:
    code, value = ended(doctors["one device"])
    assert code == 1
    assert "are one device" in by_level(value, "wrong")["ports"]


@pytest.mark.parametrize(
    ("lacking", "part", "remedy"),
    [
        ("rclpy", "rclpy", "ros-rclpy"),
        ("rclpy that crashes", "rclpy", "one ROS installation"),
        ("rclpy of Jazzy", "ros version", "Jazzy"),
        ("dynamixel_sdk", "dynamixel-sdk", "dynamixel-sdk"),
        ("serial", "pyserial", "pyserial"),
        ("yaml", "PyYAML", "pyyaml"),
    ],
)
def test_it_works_without_the_libraries_that_it_checks(
    doctors: dict[str, subprocess.Popen[str]], lacking: str, part: str, remedy: str
) -> None:
    code, value = ended(doctors[lacking])
    assert code == 1
    wrong = [finding for finding in value["findings"] if finding["level"] == "wrong" and finding["part"] == part]
    assert len(wrong) == 1
    assert remedy in wrong[0]["remedy"]
    assert {"python", "ros domain"} <= set(by_level(value, "ok"))
