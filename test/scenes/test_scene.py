# SPDX-License-Identifier: Apache-2.0
"""Invalid scenes are refused with the exact problem."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest

from deltacharger_bringup.cli.scene import describe
from deltacharger_core.parameters import declared
from deltacharger_kinematics.geometry_file import load_geometry
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.scene import SceneError, Simulation, load_scene, packaged_scenes, parse_scene
from deltacharger_sim.parameters import WorldParameters


def write(folder: Path, text: str) -> Path:
    path = folder / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "key", "why"),
    [
        ("simulaton: {}", "simulaton", "did you mean 'simulation'"),
        ("simulation: {world: {servo: {stifness: 15}}}", "simulation.world.servo.stifness", "did you mean 'stiffness'"),
        ("simulation: {world: {servo: {stiffness: 150}}}", "simulation.world.servo.stiffness", "2 to 40 N·m/rad"),
        ("simulation: {world: {target: {x: left}}}", "simulation.world.target.x", "'left' is not a number"),
        ("simulation: {seed: 1.5}", "simulation.seed", "not a whole number"),
        ("simulation: 3", "simulation", "not a mapping of keys to values"),
        ("simulation: {geometry_file: nowhere.yaml}", "simulation.geometry_file", "'nowhere.yaml' cannot be read"),
        ("simulation: {faults: [{kind: servo_missin}]}", "simulation.faults[0].kind", "servo_missing"),
        ("simulation: {faults: [{kind: board_drop, amount: 2}]}", "simulation.faults[0].amount", "share of 0 to 1"),
        ("goal: {z: 80}\nsimulation: {}", "goal.z", "-0.1 to 0.5 m"),
        ("nodes: [servo_nod]", "nodes[0]", "did you mean 'servo_node'"),
        ("nodes: [docking_node, docking_node]", "nodes[1]", "twice"),
        ("nodes: [servo_node, mock_servo_node]\nsimulation: {}", "nodes[1]", "keep one"),
        ("nodes: [recording_player_node, mock_tactile_node]", "nodes[0]", "keep one"),
        ("nodes: [docking_node]\nparameters: {servo_node: {rate: 50.0}}", "parameters.servo_node", "no such node"),
        (
            "nodes: [docking_node]\nparameters: {docking_node: {a: {b: 1}}}",
            "parameters.docking_node.a",
            "give a number",
        ),
        ("nodes: [servo_node]", "ports.servo", "/dev/ttyUSB0"),
        ("nodes: [[servo_node]]", "nodes", "is not text"),
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


def test_a_missing_scene_is_reported_with_similar_names(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="did you mean 'simulated'"):
        load_scene("simulate")
    with pytest.raises(SceneError, match="no such file"):
        load_scene(tmp_path / "none.yaml")


@pytest.mark.parametrize("name", sorted(packaged_scenes()))
def test_a_packaged_scene_is_valid_described_and_closed_to_the_network(name: str) -> None:
    scene = load_scene(name)
    assert (scene.name, scene.network) == (name, "localhost")
    assert len(scene.description) > 20
    assert scene.docks is (name not in ("tactile_lab", "replay"))
    assert scene.touches_hardware is (name in ("bench", "oakd", "rgbd", "tactile_lab"))


def test_the_default_scenes_target_is_offset_from_its_goal() -> None:
    scene = load_scene("simulated")
    assert scene.simulation is not None
    assert scene.goal is not None
    target = scene.simulation.world.target
    assert 0.001 < abs(target.x - scene.goal.x) < 0.01
    assert 0.001 < abs(target.y - scene.goal.y) < 0.01
    assert 0.01 < abs(target.roll - scene.goal.roll) < 0.12


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
    players = {name for name, spec in NODES.items() if spec.plays}
    scene = parse_scene({"nodes": sorted(NODES.keys() - doubles - players)}, "x")
    assert scene.start_order()[-2:] == ["docking_node", "mission_node"]


def test_a_node_gets_its_port_from_the_simulated_charger_else_from_the_scene() -> None:
    bench = load_scene("bench")
    assert bench.node_parameters("servo_node", {}) == {"port": bench.ports.servo}
    assert bench.node_parameters("tactile_node", {"board": "board-port"}) == {"port": "board-port"}
    assert bench.node_parameters("docking_node", {"board": "board-port"}) == {}


def test_explain_shows_every_key_of_the_world_with_its_unit_and_range() -> None:
    shown = {entry["key"]: entry for entry in describe(load_scene("simulated"))}
    for each in declared(WorldParameters, "simulation.world"):
        bounds = (None, None) if each.kind is bool else (each.low, each.high)
        found = shown[each.name]
        assert (found["minimum"], found["maximum"], found["unit"]) == (*bounds, each.unit)
    assert {f"simulation.{item.name}" for item in fields(Simulation)} - {"simulation.world"} <= shown.keys()
