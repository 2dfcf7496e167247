# SPDX-License-Identifier: Apache-2.0
"""`scene explain` lists what a scene starts, loads and leaves out; imports in a real process confirm it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from modulefinder import ModuleFinder
from pathlib import Path

import pytest

from deltacharger_scenes.node_table import CHARGER, NODES, NodeSpec
from deltacharger_scenes.parts import describe_parts, parts_text
from deltacharger_scenes.scene import Scene, load_scene, parse_scene

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.ros


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
