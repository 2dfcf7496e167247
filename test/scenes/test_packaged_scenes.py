# SPDX-License-Identifier: Apache-2.0
"""Every packaged scene starts existing nodes, names missing devices and says what it cannot do."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from deltacharger_bringup.cli.main import COMMANDS, build_parser, main
from deltacharger_bringup.cli.output import WRONG_INPUT
from deltacharger_scenes.scene import load_scene

pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]


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
