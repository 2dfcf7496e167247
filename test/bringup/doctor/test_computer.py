# SPDX-License-Identifier: Apache-2.0
"""Findings of the doctor for this computer: settings, ROS, camera, and what it may lack."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.doctor.camera import examine_camera
from deltacharger_bringup.doctor.environment import RosProbe, examine_settings
from deltacharger_bringup.doctor.findings import Finding, checked, ok

from ...chargers import new_namespace
from .test_command import by_level
from .test_devices import named, parts


@pytest.mark.parametrize(
    ("problem", "noun"),
    [(ZeroDivisionError("nothing to divide"), "divide"), (ModuleNotFoundError(name="a_module"), "a_module")],
)
def test_a_failed_check_is_a_finding_and_keeps_earlier_findings(problem: Exception, noun: str) -> None:
    def broken() -> Iterator[Finding]:
        yield ok("first", "fine")
        raise problem

    first, second = checked("second", broken)
    assert (first.level, second.level, noun in f"{second.message} {second.remedy}") == ("ok", "wrong", True)


@pytest.mark.parametrize(
    ("name", "value", "part"),
    [
        ("ROS_DOMAIN_ID", "500", "ros domain"),
        ("ROS_DOMAIN_ID", "home", "ros domain"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF", "ros discovery"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "HERE", "ros discovery"),
        ("AMENT_PREFIX_PATH", "/usr", "ros prefix"),
        ("AMENT_PREFIX_PATH", "", "ros prefix"),
    ],
)
def test_settings_that_disable_ros_are_wrong(monkeypatch: pytest.MonkeyPatch, name: str, value: str, part: str) -> None:
    assert not parts(examine_settings(), "wrong")
    monkeypatch.setenv(name, value)
    named(examine_settings(), ("wrong", part, ""))


def test_a_missing_camera_is_reported_but_never_wrong(tmp_path: Path) -> None:
    absent = list(examine_camera(None, tmp_path))
    assert not parts(absent, "wrong")
    assert any("no OAK" in finding.message for finding in absent)
    (tmp_path / "2-1").mkdir()
    (tmp_path / "2-1" / "idVendor").write_text("03e7\n")
    present = " ".join(finding.message for finding in examine_camera(2, tmp_path) if finding.level == "ok")
    assert ("an OAK" in present, "2 publishers" in present) == (True, True)


@pytest.mark.ros
@pytest.mark.rest
def test_a_running_charger_is_named(context: Any) -> None:
    from deltacharger.msg import DockingState
    from rclpy.node import Node

    node = Node("docking_node", context=context, namespace=new_namespace())
    node.create_publisher(DockingState, "docking_state", 1)
    probe = RosProbe()
    try:
        found = list(probe.examine())
    finally:
        probe.close()
        namespace = node.get_namespace()
        node.destroy_node()
    assert not parts(found, "wrong")
    named(found, ("hint", "charger", namespace))
    assert {finding.part for finding in found} >= {"rclpy", "interfaces", "numpy and ROS", "ros middleware"}


# What is wrong with a computer: a module and its replacement, a variable, or options; the finding and a noun of it.
WRONG: dict[str, tuple[dict[str, str], dict[str, str], tuple[str, ...], str, str]] = {
    "rclpy": ({"rclpy": "raise ImportError(\"No module named 'rclpy'\", name='rclpy')"}, {}, (), "rclpy", "ros-rclpy"),
    "a crash": ({"rclpy": "import os; os._exit(11)"}, {}, (), "rclpy", "one ROS installation"),
    "Jazzy": (
        {"sitecustomize": "import sys; sys.modules['rclpy.experimental'] = None"},
        *({}, (), "ros version", "Jazzy"),
    ),
    "SDK": (
        {"dynamixel_sdk": "raise ImportError('no SDK', name='dynamixel_sdk')"},
        *({}, (), "dynamixel-sdk", "dynamixel-sdk"),
    ),
    "serial": ({"serial": "raise ImportError('no serial', name='serial')"}, {}, (), "pyserial", "pyserial"),
    "yaml": ({"yaml": "raise ImportError('no yaml', name='yaml')"}, {}, (), "PyYAML", "pyyaml"),
    "middleware": ({}, {"RMW_IMPLEMENTATION": "rmw_of_nobody"}, (), "ros middleware", "RMW_IMPLEMENTATION"),
    "prefix": ({}, {"AMENT_PREFIX_PATH": "/usr"}, (), "ros prefix", "setup.bash"),
    "domain": ({}, {"ROS_DOMAIN_ID": "500"}, (), "ros domain", "232"),
    "no devices": ({}, {}, ("--servo-port", "/dev/none", "--board-port", "/dev/no"), "servo port", "plug"),
    "one device": ({}, {}, ("--servo-port", "/dev/null", "--board-port", "/dev/null"), "ports", "one device"),
}


@pytest.fixture(scope="module")
def doctors(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, subprocess.Popen[str]]]:
    """Run all doctors in parallel processes, because each takes seconds, mostly waiting."""
    running: dict[str, subprocess.Popen[str]] = {}
    try:
        for name, (modules, variables, words, _, _) in WRONG.items():
            folder = tmp_path_factory.mktemp("lacking")
            for module, body in modules.items():
                (folder / f"{module}.py").write_text(body)
            command = (sys.executable, "-m", "deltacharger_bringup.cli", "doctor", "--json")
            running[name] = subprocess.Popen(
                (*command, *(words or ("--scene", "simulated"))),
                env={**os.environ, **variables, **({"PYTHONPATH": str(folder)} if modules else {})},
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        yield running
    finally:
        for process in running.values():
            process.kill()
            process.communicate()


@pytest.mark.rest
@pytest.mark.parametrize("name", WRONG)
def test_on_a_computer_that_lacks_something_it_works_and_says_so(
    doctors: dict[str, subprocess.Popen[str]], name: str
) -> None:
    *_, part, noun = WRONG[name]
    out, err = doctors[name].communicate()
    value = json.loads(out)
    assert "Traceback" not in err
    assert (doctors[name].returncode, value["success"]) == (1, False)
    (found,) = [each for each in value["findings"] if (each["level"], each["part"]) == ("wrong", part)]
    assert noun in f"{found['message']} {found['remedy']}"
    assert all(each["remedy"] for each in value["findings"] if each["level"] != "ok")
    assert {"python", "ros domain"} - {part} <= set(by_level(value, "ok"))
