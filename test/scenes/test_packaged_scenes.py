# SPDX-License-Identifier: Apache-2.0
"""Every packaged scene starts existing nodes, explains itself, and names missing devices."""

from __future__ import annotations

import configparser
import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.cli.main import build_parser, main
from deltacharger_bringup.cli.output import WRONG_INPUT
from deltacharger_ros.node_support import StartupError
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.scene import load_scene, packaged_scenes, parse_scene

from ..chargers import Process

pytestmark = pytest.mark.ros

SCENES = sorted(packaged_scenes())
HARDWARE = [name for name in SCENES if load_scene(name).touches_hardware]
ROOT = Path(__file__).parents[2]
KINDS = {
    **dict.fromkeys(("simulated", "camera", "level", "mission"), "simulated"),
    **dict.fromkeys(("bench", "oakd", "rgbd", "tactile_lab"), "hardware"),
    "replay": "recording",
    "mocks": "mocks",
}


def executables() -> dict[str, str]:
    """Return the entry point of every installed executable."""
    parser = configparser.ConfigParser()
    parser.read(ROOT / "setup.cfg")
    lines = parser["options.entry_points"]["console_scripts"].strip().splitlines()
    return dict(line.split(" = ") for line in lines)


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main([*words, "--json"]) == 0
    return dict(json.loads(capsys.readouterr().out))


def test_every_documented_use_has_a_scene(capsys: pytest.CaptureFixture[str]) -> None:
    kinds = {each["name"]: each["kind"] for each in printed(capsys, "scene", "list")["scenes"]}
    assert KINDS.items() <= kinds.items()


@pytest.mark.parametrize("name", SCENES)
def test_it_starts_only_installed_nodes_and_explains_started_and_missing_ones(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, installed = load_scene(name), executables()
    for node in scene.nodes:
        assert installed[node] == f"deltacharger_scenes.executables:{node}"
    found = printed(capsys, "scene", "explain", name)
    started = [part["name"] for part in found["parts"]]
    assert [node for node in started if node in NODES] == scene.start_order()
    assert all(part["why"] for part in found["parts"])
    left_out = {entry["name"]: entry["why"] for entry in found["left_out"] if entry["kind"] == "node"}
    assert set(left_out) - {"simulated charger"} == set(NODES) - set(scene.nodes)
    for node, why in left_out.items():
        lacks = NODES[node].lacks if node in NODES else ""
        assert lacks in why or any(NODES[other].replaces(node) for other in scene.nodes), (node, why)


@pytest.mark.parametrize("name", HARDWARE)
def test_on_hardware_it_names_the_missing_port(name: str, context: Any, namespace: str) -> None:
    scene = load_scene(name)
    ports = [NODES[node].port for node in scene.start_order() if NODES[node].port]
    absent = dataclasses.replace(scene.ports, **{port: f"/dev/absent_{port}" for port in ports})
    with (
        pytest.raises(StartupError, match=rf"{ports[0]}.*: there is no such port"),
        Composition(dataclasses.replace(scene, ports=absent), context, namespace),
    ):
        pass


def test_ports_agree_with_the_udev_rules() -> None:
    rules = (ROOT / "config" / "udev" / "99-deltacharger.rules").read_text(encoding="utf-8")
    for name in ("oakd", "rgbd", "tactile_lab"):
        for port in filter(None, dataclasses.astuple(load_scene(name).ports)):
            assert f'SYMLINK+="{Path(port).name}"' in rules


def test_a_scene_can_name_the_topics_of_any_camera(context: Any, namespace: str) -> None:
    pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")
    own = {"color_topic": "/front/rgb/image", "depth_topic": "/front/depth/image", "camera_info_topic": "rgb/info"}
    assert set(load_scene("rgbd").parameters["electrode_detector_node"]) == set(own)
    node = {"nodes": ["electrode_detector_node"], "parameters": {"electrode_detector_node": own}}
    with Composition(parse_scene(node, "mine"), context, namespace) as composition:
        names = composition.node("electrode_detector_node")._camera.names
    assert names == ["/front/rgb/image", "/front/depth/image", f"/{namespace}/rgb/info"]


def test_the_level_target_is_at_the_pose_that_recording_assumes() -> None:
    scene = load_scene("level")
    assert scene.simulation is not None
    assert scene.goal is not None
    target = scene.simulation.world.target
    options = build_parser().parse_args(["tactile", "record", "--set", "reference", "--out", "F.npz"])
    assert (1e3 * target.x, 1e3 * target.y, 1e3 * target.z) == (options.x_mm, options.y_mm, options.z_mm)
    assert target.roll == 0.0
    assert all(getattr(scene.goal, axis) == getattr(target, axis) for axis in ("x", "y", "z", "roll"))


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("dock", "--scene", "tactile_lab"), "starts no docking_node"),
        (("undock", "--scene", "replay"), "starts no docking_node"),
        (("up", "--scene", "mocks", "--recording", __file__), "starts no recording_player_node"),
        (("up", "--scene", "mocks", "--board-port", "/dev/null"), "no node of this scene opens it"),
    ],
)
def test_a_command_that_a_scene_cannot_serve_is_refused_before_anything_starts(
    words: tuple[str, ...], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words]) == WRONG_INPUT
    assert reason in capsys.readouterr().err


@pytest.mark.rest
def test_a_goal_for_a_missing_camera_names_the_scenes_with_a_camera(
    start: Callable[..., Process], deltacharger: tuple[str, ...], quick_file: Path, namespace: str, tmp_path: Path
) -> None:
    blind = tmp_path / "blind.yaml"
    blind.write_text(quick_file.read_text(encoding="utf-8").replace("mock_detector_node, ", ""), encoding="utf-8")
    words = ("dock", "--camera", "--scene", str(blind), "--namespace", namespace, "--json", "--no-picture")
    dock = start(*deltacharger, *words)
    assert dock.end() == 1
    assert json.loads("\n".join(dock.out))["error_name"] == "ELECTRODES_NOT_FOUND"
    assert any("--scene camera" in line for line in dock.err), dock.err
