# SPDX-License-Identifier: Apache-2.0
"""Every packaged scene starts existing nodes, lists what it starts, loads and leaves out, and names missing devices."""

from __future__ import annotations

import configparser
import dataclasses
import json
import re
import subprocess
import sys
from modulefinder import ModuleFinder
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.cli.main import COMMANDS, build_parser, main
from deltacharger_bringup.cli.output import WRONG_INPUT
from deltacharger_ros.node_support import StartupError
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.node_table import CHARGER, NODES, NodeSpec
from deltacharger_scenes.parts import describe_parts, parts_text
from deltacharger_scenes.scene import Scene, load_scene, packaged_scenes, parse_scene

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
    options = build_parser(COMMANDS).parse_args(["tactile", "record", "--set", "reference", "--out", "F.npz"])
    assert (1e3 * target.x, 1e3 * target.y, 1e3 * target.z) == (options.x_mm, options.y_mm, options.z_mm)
    assert target.roll == 0.0
    assert all(getattr(scene.goal, axis) == getattr(target, axis) for axis in ("x", "y", "z", "roll"))


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("dock", "--scene", "tactile_lab"), "starts no docking_node"),
        (("undock", "--scene", "replay"), "starts no docking_node"),
    ],
)
def test_a_command_that_a_scene_cannot_serve_is_refused_before_anything_starts(
    words: tuple[str, ...], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words]) == WRONG_INPUT
    assert reason in capsys.readouterr().err


def effects(scene: Scene) -> dict[str, str]:
    return {entry["name"]: entry["why"] for entry in describe_parts(scene)["left_out"] if entry["kind"] == "effect"}


def test_a_zero_effect_is_left_out_and_others_are_computed() -> None:
    key = "simulation.world.magnets.force"
    off = parse_scene({"simulation": {"world": {"magnets": {"force": 0.0}, "servo": {"backlash": 0.01}}}}, "x")
    assert "is 0" in effects(off)[key]
    assert "simulation.world.servo.backlash" not in effects(off)
    assert key not in effects(parse_scene({"simulation": {}}, "x"))
    alone = parse_scene({"simulation": {"world": {"target": {"present": False}}}}, "x")
    assert "present is false" in effects(alone)["simulation.world.target"]


def test_mocks_need_no_driver_and_hardware_no_simulated_charger() -> None:
    mocks = describe_parts(load_scene("mocks"))
    assert not {"serial", "dynamixel_sdk"} & set(mocks["imports"])
    bench = describe_parts(load_scene("bench"))
    assert bench["computes"] == []
    assert "simulated charger" in {entry["name"] for entry in bench["left_out"]}
    assert "leaves out:" in parts_text(bench)


# Imports what every node has, then each module in a separate child, and prints what that loaded in addition.
NEEDED = """
import importlib, json, os, sys
from deltacharger_core import environment
environment.prepare()
import numpy, rclpy.node, rclpy.serialization  # Jazzy's loads numpy with the first message alone
roots = lambda: {name.split(".")[0] for name in sys.modules}
before = roots()
for module in sys.argv[1:]:
    if (child := os.fork()) == 0:
        importlib.import_module(module)
        print(json.dumps([module, sorted(roots() - before - sys.stdlib_module_names)]), flush=True)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0, module
"""
WITH_RCLPY = ["ament_index_python", "numpy", "yaml"]
MESSAGES = re.compile(r"deltacharger.*|(?!nav2).*_(msgs|srvs|interfaces)")


def is_library(name: str) -> bool:
    return name not in sys.stdlib_module_names and not MESSAGES.fullmatch(name) and not name.startswith("_")


@pytest.mark.rest
def test_a_nodes_import_loads_the_libraries_in_the_table() -> None:
    table = {spec.module: set(spec.needs) for spec in (CHARGER, *NODES.values())}
    ran = subprocess.run([sys.executable, "-c", NEEDED, *table], capture_output=True, text=True, check=True)
    loaded = {module: set(filter(is_library, found)) for module, found in map(json.loads, ran.stdout.splitlines())}
    assert loaded == table


@pytest.mark.parametrize("spec", [CHARGER, *NODES.values()], ids=lambda spec: spec.path.rpartition(".")[2])
def test_a_nodes_sources_import_the_libraries_in_the_table(spec: NodeSpec) -> None:
    finder = ModuleFinder(path=[str(ROOT)], excludes=WITH_RCLPY)
    finder.load_file(str(ROOT.joinpath(*spec.module.split(".")).with_suffix(".py")))
    found = {name.split(".")[0] for name in finder.badmodules} - {"rclpy", *WITH_RCLPY}
    assert set(filter(is_library, found)) == {*spec.needs, *spec.needs_when_used}
