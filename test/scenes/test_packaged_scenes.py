# SPDX-License-Identifier: Apache-2.0
"""Every packaged scene starts existing nodes, names missing devices and says what it cannot do."""

from __future__ import annotations

import dataclasses
import json
import re
import sys
from modulefinder import ModuleFinder
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.cli.main import COMMANDS, build_parser, main
from deltacharger_bringup.cli.output import WRONG_INPUT
from deltacharger_ros.node_support import StartupError
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.scene import load_scene, packaged_scenes

from .. import libraries

pytestmark = pytest.mark.ros

SCENES = sorted(packaged_scenes())
HARDWARE = [name for name in SCENES if load_scene(name).touches_hardware]
ROOT = Path(__file__).parents[2]


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main([*words, "--json"]) == 0
    return dict(json.loads(capsys.readouterr().out))


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


def test_the_level_target_is_at_the_pose_that_recording_assumes() -> None:
    scene = load_scene("level")
    assert scene.simulation is not None
    assert scene.goal is not None
    target = scene.simulation.world.target
    options = build_parser(COMMANDS).parse_args(["tactile", "record", "--set", "reference", "--out", "F.npz"])
    assert (1e3 * target.x, 1e3 * target.y, 1e3 * target.z) == (options.x_mm, options.y_mm, options.z_mm)
    assert target.roll == 0.0
    assert all(getattr(scene.goal, axis) == getattr(target, axis) for axis in ("x", "y", "z", "roll"))


def test_a_command_that_a_scene_cannot_serve_is_refused_before_anything_starts(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["dock", "--scene", "tactile_lab"]) == WRONG_INPUT
    assert "starts no docking_node" in capsys.readouterr().err


WITH_RCLPY = ["ament_index_python", "numpy", "yaml"]
MESSAGES = re.compile(r"deltacharger.*|(?!nav2).*_(msgs|srvs|interfaces)")


def is_library(name: str) -> bool:
    return name not in sys.stdlib_module_names and not MESSAGES.fullmatch(name) and not name.startswith("_")


MODULES = {
    "simulated_charger": "deltacharger_sim.charger.simulated_charger",
    **{name: spec.module for name, spec in NODES.items()},
}


@pytest.mark.parametrize("name", MODULES)
def test_a_nodes_sources_import_the_libraries_in_the_table(name: str) -> None:
    finder = ModuleFinder(path=[str(ROOT)], excludes=WITH_RCLPY)
    finder.load_file(str(ROOT.joinpath(*MODULES[name].split(".")).with_suffix(".py")))
    found = {name.split(".")[0] for name in finder.badmodules} - {"rclpy", *WITH_RCLPY}
    assert set(filter(is_library, found)) == libraries.of(name)
