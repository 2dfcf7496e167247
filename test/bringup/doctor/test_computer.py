# SPDX-License-Identifier: Apache-2.0
"""`deltacharger doctor`: findings for this computer, what it may lack, and the command line."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.doctor import environment, findings
from deltacharger_sim.emulators.servo_bus import ServoBusEmulator

from ...emulated_ports import IDS
from ..command import Capture, answer, run
from .test_devices import named, parts


@pytest.mark.parametrize(
    ("problem", "noun"),
    [(ZeroDivisionError("nothing to divide"), "divide"), (ModuleNotFoundError(name="a_module"), "a_module")],
)
def test_a_failed_check_is_a_finding_and_keeps_earlier_findings(problem: Exception, noun: str) -> None:
    def broken() -> Iterator[findings.Finding]:
        yield findings.ok("first", "fine")
        raise problem

    first, second = findings.checked("second", broken)
    assert (first.level, second.level, noun in f"{second.message} {second.remedy}") == ("ok", "wrong", True)


@pytest.mark.parametrize(
    ("name", "value", "part"),
    [
        ("ROS_DOMAIN_ID", "500", "ros domain"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF", "ros discovery"),
    ],
)
def test_settings_that_disable_ros_are_wrong(monkeypatch: pytest.MonkeyPatch, name: str, value: str, part: str) -> None:
    assert not parts(environment.examine_settings(), "wrong")
    monkeypatch.setenv(name, value)
    named(environment.examine_settings(), ("wrong", part, ""))


def test_a_missing_camera_is_reported_but_never_wrong(tmp_path: Path) -> None:
    absent = list(environment.examine_camera(None, tmp_path))
    assert not parts(absent, "wrong")
    assert any("no OAK" in finding.message for finding in absent)
    (tmp_path / "2-1").mkdir()
    (tmp_path / "2-1" / "idVendor").write_text("03e7\n")
    present = " ".join(finding.message for finding in environment.examine_camera(2, tmp_path) if finding.level == "ok")
    assert ("an OAK" in present, "2 publishers" in present) == (True, True)


@pytest.mark.parametrize("silent", ["", "a charger's answers do not arrive: run both as one user"])
def test_a_charger_that_does_not_answer_is_wrong(silent: str) -> None:
    found = environment.running(["/left"], silent)
    assert (found.level, "/left" in found.message) == (("wrong", False) if silent else ("hint", True))
    assert found.remedy == "run both as one user" or not silent


# What is wrong with a computer: a module and its replacement, or a variable; the finding and a noun of it.
WRONG: dict[str, tuple[dict[str, str], dict[str, str], str, str]] = {
    "rclpy": ({"rclpy": "raise ImportError(\"No module named 'rclpy'\", name='rclpy')"}, {}, "rclpy", "ros-rclpy"),
    "a crash": ({"rclpy": "import os; os._exit(11)"}, {}, "rclpy", "one ROS installation"),
    "Jazzy": ({"sitecustomize": "import sys; sys.modules['rclpy.experimental'] = None"}, {}, "ros version", "Jazzy"),
    "serial": ({"serial": "raise ImportError('no serial', name='serial')"}, {}, "serial", "pyserial"),
    "middleware": ({}, {"RMW_IMPLEMENTATION": "rmw_of_nobody"}, "ros middleware", "RMW_IMPLEMENTATION"),
    "one device": ({}, {}, "ports", "one device"),
}


@pytest.mark.rest
@pytest.mark.parametrize("name", WRONG)
def test_on_a_computer_that_lacks_something_it_works_and_says_so(tmp_path: Path, name: str) -> None:
    modules, variables, part, noun = WRONG[name]
    for module, body in modules.items():
        (tmp_path / f"{module}.py").write_text(body)
    path = {"PYTHONPATH": str(tmp_path)} if modules else {}
    line = f"{sys.executable} -m deltacharger_bringup.cli doctor --json --servo-port /dev/null --board-port /dev/null"
    ended = subprocess.run(
        line.split(), env={**os.environ, **variables, **path}, capture_output=True, text=True, check=False
    )
    value = json.loads(ended.stdout)
    assert "Traceback" not in ended.stderr
    assert (ended.returncode, value["success"]) == (1, False)
    (found,) = [each for each in value["findings"] if (each["level"], each["part"]) == ("wrong", part)]
    assert noun in f"{found['message']} {found['remedy']}"
    assert all(each["remedy"] for each in value["findings"] if each["level"] != "ok")
    assert {"python", "ros domain"} - {part} <= set(by_level(value, "ok"))


def by_level(value: dict[str, Any], level: str) -> dict[str, str]:
    return {finding["part"]: finding["message"] for finding in value["findings"] if finding["level"] == level}


@pytest.mark.rest
def test_the_simulated_scene_is_examined(capsys: Capture) -> None:
    _, value = answer(capsys, "doctor", "--scene", "simulated")
    assert value["scene"] == "simulated"
    assert set(by_level(value, "wrong")) <= {"servo line", "tactile link"}, "a busy computer loses replies and frames"
    assert set(by_level(value, "ok")) >= {"servo 1", "servo 2", "servo 3", "board", "power", "probe"}


@pytest.mark.rest
def test_speed_and_ids_are_from_the_scene_and_ports_from_the_command_line(
    capsys: Capture, tmp_path: Path, servos: ServoBusEmulator, servo_port: str, board_port: str
) -> None:
    for servo in IDS:
        servos.servo(servo).table.set("baud", 4)
    scene = tmp_path / "robot.yaml"
    scene.write_text(
        f"ports: {{servo: /dev/nothing, board: {board_port}}}\nparameters: {{servo_node: {{baud_rate: 2000000}}}}\n"
    )
    _, value = answer(capsys, "doctor", "--scene", scene, "--servo-port", servo_port)
    assert set(by_level(value, "wrong")) <= {"servo line", "tactile link"}  # may be wrong on a busy computer
    assert value["servo_port"] == servo_port
    assert "2000000" in next(f["message"] for f in value["findings"] if f["part"] == "servo 1")


@pytest.mark.rest
def test_servos_connected_to_the_board(capsys: Capture, servos: ServoBusEmulator, one_cable: str) -> None:
    servos.servo(2).table.set("baud", 1)
    behind = ("--servo-port", "board", "--board-port", one_cable)
    code, value = answer(capsys, "doctor", *behind)
    assert (code, "servo 2" in by_level(value, "wrong")) == (1, True)
    assert run(capsys, "doctor", *behind[:2])[0] == 1
