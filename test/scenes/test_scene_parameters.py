# SPDX-License-Identifier: Apache-2.0
"""A scene's parameters are checked without its nodes; the nodes' assumptions agree with the simulated world."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_core.parameters import declared
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.parameter_check import problems, tables
from deltacharger_scenes.scene import load_scene, packaged_scenes, parse_scene

HEAVY = """
import sys
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.parameter_check import tables
assert all(tables(name) for name in NODES)
sys.exit(sorted({"rclpy", "cv2", "depthai", "mujoco", "serial", "matplotlib", "scipy"} & set(sys.modules)) or None)
"""


def problems_of(parameters: dict[str, Any]) -> list[tuple[str, str]]:
    return list(problems(parse_scene({"nodes": [*parameters], "simulation": {}, "parameters": parameters}, "mine")))


def test_packaged_scenes_set_only_parameters_that_their_nodes_accept() -> None:
    for name in packaged_scenes():
        assert not list(problems(load_scene(name))), name


@pytest.mark.parametrize(
    ("node", "parameter", "value", "problem"),
    [
        ("servo_node", "rte", 100.0, "did you mean 'rate'"),
        ("servo_node", "rate", 900.0, "outside 20 to 200 Hz"),
        ("servo_node", "rate", True, "not a number"),
        ("servo_node", "ids", [1, 2], "has 2 numbers; give 3"),
        ("servo_node", "current_bound", 3.5, "is not below"),
        ("docking_node", "approach", "fast", "not one of guarded, paper"),
        ("misalignment_node", "frames", 12.5, "not a whole number"),
    ],
)
def test_invalid_parameters_are_found_without_the_node(node: str, parameter: str, value: Any, problem: str) -> None:
    ((key, message),) = problems_of({node: {parameter: value}})
    assert key == f"parameters.{node}.{parameter}"
    assert problem in message


def test_check_and_nodes_accept_whole_numbers_for_floats(context: Any, namespace: str) -> None:
    given = {"mock_servo_node": {"rate": 50}, "kinematics_node": {"gravity": [0, -9.81, 0], "arm": 0.1}}
    scene = parse_scene({"nodes": [*given], "parameters": given}, "mine")
    assert not list(problems(scene))
    with Composition(scene, context, namespace) as composition:
        assert composition.node("mock_servo_node").get_parameter("rate").value == 50.0
        assert list(composition.node("kinematics_node").get_parameter("gravity").value) == [0.0, -9.81, 0.0]


def test_each_parameter_is_declared_once_without_loading_heavy_modules() -> None:
    for node in NODES:
        names = [each.name for table in tables(node) for each in declared(table)]
        assert names, node
        assert len(names) == len(set(names)), node
    ran = subprocess.run([sys.executable, "-c", HEAVY], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr


def test_nodes_follow_the_world_unless_the_scene_sets_other_values() -> None:
    world = {"servo": {"stiffness": 6.0, "torque_constant": 1.2}, "gravity_y": -9.0, "gravity_z": 3.0}
    content = {"simulation": {"world": world}, "parameters": {"docking_node": {"gravity_z": 0.0}}}
    scene = parse_scene(content, "mine")
    assert scene.node_parameters("docking_node", {}) == {
        "servo_stiffness": 6.0,
        "power": "board",
        "torque_constant": 1.2,
        "gravity_x": 0.0,
        "gravity_y": -9.0,
        "gravity_z": 0.0,
    }
    assert scene.node_parameters("servo_node", {}) == {"torque_constant": 1.2}
    wired = parse_scene({"simulation": {"world": {"circuit": {"wired": True}}}}, "mine")
    assert wired.node_parameters("docking_node", {})["power"] == "none"
    assert scene.node_parameters("kinematics_node", {}) == {"gravity": [0.0, -9.0, 3.0], "torque_constant": 1.2}


def test_nodes_follow_a_position_gain_and_take_measured_servos_from_their_file() -> None:
    content = {
        "simulation": {"world": {"servo": {"stiffness": 6.0, "torque_constant": 1.2}}},
        "parameters": {"servo_node": {"position_p_gain": 868}, "kinematics_node": {"servos_file": "servos.yaml"}},
    }
    scene = parse_scene(content, "mine")
    assert scene.node_parameters("docking_node", {})["servo_stiffness"] == pytest.approx(12.0)
    assert "torque_constant" not in scene.node_parameters("kinematics_node", {})
    assert scene.node_parameters("kinematics_node", {})["gravity"] == [0.0, -9.81, 0.0]


def test_check_reports_contradictions_and_wrong_parameters(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("{simulation: {}, parameters: {docking_node: {servo_stiffness: 6.0}}}", encoding="utf-8")
    assert main(["scene", "check", str(path), "--json"]) == 0
    (report,) = json.loads(capsys.readouterr().out)["scenes"]
    (warning,) = report["warnings"]
    assert "docking_node.servo_stiffness: is 6.0, but simulation.world.servo.stiffness is 15.0" in warning
    path.write_text("{simulation: {}, parameters: {docking_node: {servo_stifness: 6.0}}}", encoding="utf-8")
    assert main(["scene", "check", str(path), "--json"]) == 2
    (report,) = json.loads(capsys.readouterr().out)["scenes"]
    assert (report["ok"], report["key"]) == (False, "parameters.docking_node.servo_stifness")


@pytest.mark.parametrize(
    ("files", "warned"),
    [
        ({}, []),
        (dict.fromkeys(("servo_node", "kinematics_node", "docking_node"), "a.yaml"), []),
        ({"docking_node": "a.yaml"}, ["servo_node", "kinematics_node"]),
        ({"servo_node": "a.yaml", "kinematics_node": "a.yaml", "docking_node": "b.yaml"}, ["docking_node"]),
    ],
)
@pytest.mark.parametrize("base", ["ports: {servo: /dev/ttyUSB0}, ", "simulation: {}, "])
def test_check_reports_nodes_with_a_different_servos_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], base: str, files: dict[str, str], warned: list[str]
) -> None:
    given = json.dumps({node: {"servos_file": file} for node, file in files.items()})
    path = tmp_path / "mine.yaml"
    path.write_text(f"{{{base}nodes: [servo_node, kinematics_node, docking_node], parameters: {given}}}")
    assert main(["scene", "check", str(path), "--json"]) == 0
    (report,) = json.loads(capsys.readouterr().out)["scenes"]
    found = [each for each in report["warnings"] if "servos_file" in each]
    assert len(found) == len(warned)
    assert all(f"{name}.servos_file: is" in line for name, line in zip(warned, found, strict=True))
