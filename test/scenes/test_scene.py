# SPDX-License-Identifier: Apache-2.0
"""Invalid scenes, arguments and parameters are refused with the exact problem; nodes agree with the simulated world."""

import json
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.cli.main import COMMANDS, build_parser, main
from deltacharger_bringup.cli.output import WRONG_INPUT
from deltacharger_bringup.scenes.composition import Composition
from deltacharger_bringup.scenes.node_table import NODES
from deltacharger_bringup.scenes.scene import (
    RECORDER,
    SIMULATED_TARGET,
    Overrides,
    SceneError,
    load_scene,
    override,
    packaged_scenes,
    parse_scene,
    problems,
)
from deltacharger_kinematics.geometry import load_geometry


def write(folder: Path, text: str) -> Path:
    path = folder / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "key", "why"),
    [
        ("simulaton: {}", "simulaton", "did you mean 'simulation'"),
        ("simulation: {world: {servo: {stiffness: 150}}}", "simulation.world.servo.stiffness", "2 to 40 N·m/rad"),
        ("simulation: {faults: [{kind: servo_missin}]}", "simulation.faults[0].kind", "servo_missing"),
        ("nodes: [servo_nod]", "nodes[0]", "did you mean 'servo_node'"),
        ("nodes: [servo_node, mock_servo_node]\nsimulation: {}", "nodes[1]", "keep one"),
        ("nodes: [docking_node]\nparameters: {servo_node: {rate: 50.0}}", "parameters.servo_node", "no such node"),
        (
            "nodes: [docking_node]\nparameters: {docking_node: {a: {b: {c: 1}}}}",
            "parameters.docking_node.a.b",
            "give a number",
        ),
        ("nodes: [servo_node]", "ports.servo", "/dev/ttyUSB0"),
        ("simulation: {}\nports: {servo: /dev/ttyUSB0}", "ports", "excludes 'simulation'"),
        (
            "simulation: {}\nparameters: {servo_node: {port: /dev/ttyUSB0}}",
            "parameters.servo_node.port",
            "must not open a port of real hardware",
        ),
        ("", "", "is empty"),
        ("a: [", "", "not valid YAML: line"),
    ],
)
def test_an_invalid_scene_names_its_file_its_key_and_the_remedy(tmp_path: Path, text: str, key: str, why: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert caught.value.file == str(path)
    assert caught.value.key == key
    assert why in caught.value.problem


@pytest.mark.parametrize("name", sorted(packaged_scenes()))
def test_a_packaged_scene_is_valid_and_closed_to_the_network(name: str) -> None:
    scene = load_scene(name)
    assert (scene.name, scene.network) == (name, "localhost")
    assert scene.touches_hardware is (name in ("bench", "oakd", "rgbd", "tactile_lab"))
    assert not list(problems(scene))


def test_ports_agree_with_the_udev_rules() -> None:
    rules = (Path(__file__).parents[2] / "config" / "udev" / "99-deltacharger.rules").read_text(encoding="utf-8")
    for name in ("oakd", "rgbd", "tactile_lab"):
        for port in filter(None, astuple(load_scene(name).ports)):
            assert f'SYMLINK+="{Path(port).name}"' in rules


def test_the_level_target_is_at_the_pose_that_recording_assumes() -> None:
    scene = load_scene("level")
    assert scene.simulation is not None
    assert scene.goal is not None
    target = scene.simulation.world.target
    options = build_parser(COMMANDS).parse_args(["tactile", "record", "--set", "reference", "--out", "F.npz"])
    assert (1e3 * target.x, 1e3 * target.y, 1e3 * target.z) == (options.x_mm, options.y_mm, options.z_mm)
    assert target.roll == 0.0
    assert all(getattr(scene.goal, axis) == getattr(target, axis) for axis in ("x", "y", "z", "roll"))


def test_a_command_that_a_scene_cannot_serve_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dock", "--scene", "tactile_lab"]) == WRONG_INPUT
    assert "starts no docking_node" in capsys.readouterr().err


def test_the_geometry_of_the_simulated_arm_is_checked_with_the_scene(tmp_path: Path) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text("arm: 0.101\nlimbs: [{angle_offset: 0.02}, {}, {}]\n")
    scene = load_scene(write(tmp_path, f"simulation: {{geometry_file: {file}}}"))
    assert scene.simulation is not None
    assert scene.simulation.geometry() == load_geometry(file)
    assert scene.simulation.build_world().geometry == load_geometry(file)
    file.write_text("arms: 0.101\n")
    with pytest.raises(SceneError, match=r"arm\.yaml: arms: unknown key; did you mean 'arm'"):
        load_scene(write(tmp_path, f"simulation: {{geometry_file: {file}}}"))


def test_commanding_nodes_start_last_and_close_first() -> None:
    doubles = {spec.stands_in_for for spec in NODES.values()}
    scene = parse_scene({"nodes": sorted(NODES.keys() - doubles)}, "x")
    assert scene.start_order()[-2:] == ["docking_node", "mission_node"]


HARDWARE = "ports: {servo: /dev/no_servo, board: /dev/no_board}\nparameters: {servo_node: {port: /dev/own, rate: 50.0}}"


def test_given_ports_override_the_scenes_and_the_nodes(tmp_path: Path) -> None:
    servo, board = tmp_path / "servo", tmp_path / "board"
    servo.touch()
    board.touch()
    hardware = load_scene(write(tmp_path, HARDWARE))
    scene = override(hardware, Overrides(servo_port=str(servo), board_port=str(board)))
    assert scene.node_parameters("servo_node", {}) == {"port": str(servo), "rate": 50.0}
    assert scene.node_parameters("tactile_node", {}) == {"port": str(board)}


def test_one_argument_sets_the_prefix_of_every_node() -> None:
    for name in ("camera", "mocks", "mission"):
        scene = override(load_scene(name), Overrides(frame_prefix="left/", joint_prefix="left_"))
        parameters = {node: scene.node_parameters(node, {}) for node in scene.nodes}
        without = {node for node, values in parameters.items() if values.get("frame_prefix") != "left/"}
        assert without <= {"docking_recorder_node", "mock_navigator_node"}
        assert all("joint_prefix" in parameters[node] for node in scene.nodes if node.endswith("servo_node"))


@pytest.mark.parametrize(
    ("scene", "camera", "here", "gone"),
    [
        ("bench", "topics", {"electrode_detector_node"}, {"camera_node"}),
        ("camera", "none", set(), {"simulated_camera_node", "electrode_detector_node"}),
        ("mocks", "oak", {"camera_node", "electrode_detector_node"}, {"mock_detector_node"}),
    ],
)
def test_the_camera_is_chosen_with_its_detector(scene: str, camera: str, here: set[str], gone: set[str]) -> None:
    before = load_scene(scene)
    after = override(before, Overrides(camera=camera))
    assert here <= set(after.nodes)
    assert not gone & set(after.nodes)
    assert not gone & set(after.parameters)
    assert set(before.nodes) - gone <= set(after.nodes)
    assert after.start_order()[-1] == "docking_node"


def test_records_go_to_the_given_folder_or_nowhere(tmp_path: Path) -> None:
    bench = load_scene("bench")
    assert override(bench, Overrides()) == bench
    recorded = override(bench, Overrides(record=str(tmp_path)))
    assert recorded.parameters[RECORDER]["folder"] == str(tmp_path)
    usual = override(bench, Overrides(record="true"))
    assert "folder" not in usual.parameters.get(RECORDER, {})
    assert override(recorded, Overrides(record="True")) == recorded
    assert override(recorded, Overrides(record="false")) == bench


REFUSED = [
    ("simulated", {"servo_port": "/dev/null"}, "has its own ports"),
    ("mocks", {"frame_prefix": "left side/"}, "frame_prefix"),
    ("bench", {"servo_port": "/dev/no_such_servo"}, "there is no such port"),
    ("bench", {"model": "nowhere.npz"}, "there is no such file"),
    ("bench", {"record": "/proc/records"}, "cannot be written"),
]


@pytest.mark.parametrize(("scene", "arguments", "expected"), REFUSED, ids=lambda value: str(value)[:40])
def test_an_unsuitable_argument_is_refused_by_its_name(scene: str, arguments: dict[str, str], expected: str) -> None:
    with pytest.raises(SceneError, match=expected) as caught:
        override(load_scene(scene), Overrides(**arguments))
    assert caught.value.key == next(iter(arguments))


@pytest.mark.parametrize(
    ("parameter", "value", "problem"), [("rate", 900.0, "outside 20 to 200 Hz"), ("joint_min", 1.3, "is not below")]
)
def test_invalid_parameters_are_found_without_the_node(parameter: str, value: Any, problem: str) -> None:
    given = {"nodes": ["servo_node"], "simulation": {}, "parameters": {"servo_node": {parameter: value}}}
    ((key, message),) = problems(parse_scene(given, "mine"))
    assert key == f"parameters.servo_node.{parameter}"
    assert problem in message


LEAD = {"empty_voltage": 10.5, "full_voltage": 14.4, "current": 5, "end_current": 0.5}


def test_a_profile_is_read_and_an_unknown_key_in_it_refused() -> None:
    for more, refused in (({}, []), ({"gap": 1.0}, ["parameters.docking_node.lead.gap"])):
        given = {"docking_node": {"target_profiles": ["lead"], "lead": {**LEAD, **more}}}
        scene = parse_scene({"nodes": ["docking_node"], "parameters": given}, "mine")
        assert [key for key, _ in problems(scene)] == refused
        assert scene.parameters["docking_node"]["lead.current"] == 5


@pytest.mark.ros
def test_check_and_nodes_accept_whole_numbers_for_floats(context: Any, namespace: str) -> None:
    given = {"mock_detector_node": {"x": 1}, "kinematics_node": {"gravity": [0, -9.81, 0], "torque_constant": 1}}
    scene = parse_scene({"nodes": [*given], "parameters": given}, "mine")
    assert not list(problems(scene))
    with Composition(scene, context, namespace) as composition:
        assert composition.node("mock_detector_node").get_parameter("x").value == 1.0
        assert list(composition.node("kinematics_node").get_parameter("gravity").value) == [0.0, -9.81, 0.0]


def test_nodes_follow_the_world_unless_the_scene_sets_other_values() -> None:
    world = {"servo": {"stiffness": 6.0, "torque_constant": 1.2}, "gravity_y": -9.0, "gravity_z": 3.0}
    content = {"simulation": {"world": world}, "parameters": {"docking_node": {"gravity": [0.0, 0.0, 9.0]}}}
    scene = parse_scene(content, "mine")
    assert scene.node_parameters("docking_node", {}) == {
        "servo_stiffness": 6.0,
        "power": "board",
        "torque_constant": 1.2,
        "gravity": [0.0, 0.0, 9.0],
        **SIMULATED_TARGET,
    }
    assert scene.node_parameters("servo_node", {}) == {"torque_constant": 1.2}
    stiffer = parse_scene({"simulation": {}, "parameters": {"servo_node": {"position_p_gain": 868}}}, "mine")
    assert stiffer.node_parameters("docking_node", {})["servo_stiffness"] == pytest.approx(30.0)
    wired = parse_scene({"simulation": {"world": {"circuit": {"wired": True}}}}, "mine")
    assert wired.node_parameters("docking_node", {})["power"] == "none"
    mocks = load_scene("mocks")
    assert SIMULATED_TARGET.items() <= mocks.node_parameters("docking_node", {}).items()
    own = replace(mocks, parameters={"docking_node": {"target_profiles": ["lead"]}})
    assert own.node_parameters("docking_node", {}) == {"target_profiles": ["lead"]}
    assert scene.node_parameters("kinematics_node", {}) == {"gravity": [0.0, -9.0, 3.0], "torque_constant": 1.2}


def test_check_reports_a_node_with_a_different_servos_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = {"servo_node": "a.yaml", "kinematics_node": "a.yaml", "docking_node": "b.yaml"}
    given = json.dumps({node: {"servos_file": file} for node, file in files.items()})
    path = write(tmp_path, f"{{simulation: {{}}, nodes: {json.dumps([*files])}, parameters: {given}}}")
    assert main(["scene", str(path), "--json"]) == 0
    (report,) = json.loads(capsys.readouterr().out)["scenes"]
    (found,) = [each for each in report["warnings"] if "servos_file" in each]
    assert "docking_node.servos_file: is" in found
