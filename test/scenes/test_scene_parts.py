# SPDX-License-Identifier: Apache-2.0
"""`scene explain` says what a scene starts, loads and leaves out; a real process is asked whether that is so."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_scenes.imports import libraries
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.parts import CHARGER, COMPOSITION, WITH_RCLPY, describe_parts, tell_parts
from deltacharger_scenes.scene import Scene, load_scene, parse_scene

from ..chargers import new_namespace

pytestmark = pytest.mark.ros

# Starts a scene, lets it answer a goal that it refuses before any motion, and tells which modules were loaded.
LOADED = """
import dataclasses, json, sys
from deltacharger_core import environment
environment.prepare()
import rclpy
from rclpy.context import Context
from deltacharger_scenes.composition import Composition
from deltacharger_ros.client import ChargerClient
from deltacharger_ros.outcomes import DockRequest, Pose
from deltacharger_scenes.scene import load_scene
scene = load_scene(sys.argv[1])
world = scene.simulation.world
world = dataclasses.replace(world, target=dataclasses.replace(world.target, roll=0.26))
scene = dataclasses.replace(scene, simulation=dataclasses.replace(scene.simulation, world=world))
request = DockRequest(Pose(0.0, 0.0, 0.08, 0.26) if scene.goal is not None else None)
context = Context()
rclpy.init(context=context)
with Composition(scene, context, sys.argv[2]), ChargerClient(sys.argv[2]) as client:
    assert client.wait_until_ready(30.0)
    outcome = client.dock(request, deadline=60.0)
rclpy.shutdown(context=context)
print(json.dumps({"error": outcome.error_name, "modules": sorted({name.split(".")[0] for name in sys.modules})}))
"""


def explained(capsys: pytest.CaptureFixture[str], name: str) -> dict[str, Any]:
    assert main(["scene", "explain", name, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert isinstance(found, dict)
    return found


def known_libraries() -> set[str]:
    """Return every library that some part of some scene loads, but for those that rclpy brings along in any case."""
    found = libraries([COMPOSITION, CHARGER, *(spec.module for spec in NODES.values())])
    return (set(found.at_once) | set(found.when_used)) - WITH_RCLPY


@pytest.mark.parametrize("name", ["simulated", "camera"])
def test_what_it_claims_to_load_is_what_a_real_process_loads(capsys: pytest.CaptureFixture[str], name: str) -> None:
    if name == "camera":
        pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")
    found = explained(capsys, name)
    ran = subprocess.run(
        [sys.executable, "-c", LOADED, name, new_namespace()], capture_output=True, text=True, timeout=100, check=False
    )
    assert ran.returncode == 0, ran.stderr
    told = json.loads(ran.stdout.splitlines()[-1])
    assert told["error"] == "CRITICAL_ANGLE"  # the camera has looked, and nothing has moved
    loaded = set(told["modules"])
    at_once, when_used = set(found["imports"]), set(found["imports_when_used"])
    assert at_once <= loaded
    assert loaded & known_libraries() <= at_once | when_used
    left_out = {entry["name"] for entry in found["left_out"] if entry["kind"] == "library"}
    assert not left_out & loaded
    assert ("cv2" in loaded) is (name == "camera") is ("cv2" in when_used)
    assert ("cv2" in left_out) is (name == "simulated")


def test_parts_are_those_of_the_scene_in_their_order() -> None:
    found = describe_parts(load_scene("simulated"))
    assert [part["name"] for part in found["parts"]] == ["simulated charger", *load_scene("simulated").start_order()]
    assert all(importlib.util.find_spec(part["module"]) for part in found["parts"])
    by_name = {entry["name"]: entry for entry in found["left_out"]}
    assert set(NODES) - set(load_scene("simulated").nodes) <= set(by_name)
    assert by_name["mock_servo_node"]["why"] == "servo_node itself is there"
    assert "electrode_detector_node" in by_name["cv2"]["why"]


def effects(scene: Scene) -> dict[str, str]:
    return {entry["name"]: entry["why"] for entry in describe_parts(scene)["left_out"] if entry["kind"] == "effect"}


def test_an_effect_that_is_zero_is_left_out_and_one_that_is_not_is_computed() -> None:
    key = "simulation.world.magnets.force"
    off = parse_scene({"simulation": {"world": {"magnets": {"force": 0.0}, "servo": {"backlash": 0.01}}}}, "x")
    assert "is 0" in effects(off)[key]
    assert "simulation.world.servo.backlash" not in effects(off)
    assert key not in effects(parse_scene({"simulation": {}}, "x"))
    assert (
        "present is false"
        in effects(parse_scene({"simulation": {"world": {"target": {"present": False}}}}, "x"))[
            "simulation.world.target"
        ]
    )


def test_mocks_need_no_driver_and_hardware_no_simulated_charger() -> None:
    mocks = describe_parts(load_scene("mocks"))
    assert not {"serial", "dynamixel_sdk"} & set(mocks["imports"])
    bench = describe_parts(load_scene("bench"))
    assert bench["computes"] == []
    assert {"kind": "node", "name": "simulated charger", "why": "the scene has no key 'simulation'"} in bench[
        "left_out"
    ]
    assert "leaves out:" in tell_parts(bench)


def test_imports_are_read_from_the_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "deltacharger_example"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "one.py").write_text(
        "import json\nimport first\nfrom typing import TYPE_CHECKING\n"
        "from deltacharger_example import two\nif TYPE_CHECKING:\n    import hint\n"
        "def use():\n    import second.part\n    from deltacharger_example.three import x\n",
        encoding="utf-8",
    )
    (package / "two.py").write_text("from . import four\ntry:\n    import third\nexcept ImportError:\n    pass\n")
    (package / "three.py").write_text("import fourth\nx = 1\n")
    (package / "four.py").write_text("class A:\n    import fifth\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    found = libraries(["deltacharger_example.one"])
    assert found.at_once == {"first", "third", "fifth"}
    assert found.when_used == {"fourth": ["deltacharger_example.three"], "second": ["deltacharger_example.one"]}
