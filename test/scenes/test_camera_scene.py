# SPDX-License-Identifier: Apache-2.0
"""Docking from the image to charging, and every refusal by the image, with simulated camera and hardware."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import pytest

from deltacharger_ros.outcomes import DockRequest
from deltacharger_scenes.scene import Scene, SceneError, parse_scene

from ..marks import rest
from ..quick import quick_simulation
from ..running_charger import PATIENT, RunningCharger

pytestmark = pytest.mark.ros

BY_CAMERA = DockRequest(None)


def scene(steps: Mapping[str, Any] = MappingProxyType({}), **target: Any) -> Scene:
    """The packaged scene with quick steps, other parameters of docking_node, and another target."""
    packaged = quick_simulation("camera", {**PATIENT, **steps})
    assert packaged.simulation is not None
    world = packaged.simulation.world
    moved = dataclasses.replace(world, target=dataclasses.replace(world.target, **target))
    return dataclasses.replace(packaged, simulation=dataclasses.replace(packaged.simulation, world=moved))


@pytest.fixture(autouse=True)
def with_opencv() -> None:
    pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")


@pytest.mark.rest
def test_it_docks_from_the_image_and_charges(context: Any) -> None:
    from deltacharger_records.replay.recorder import Recorder

    phases: list[str] = []
    with RunningCharger(scene(), context) as charger:
        with Recorder(context, f"/{charger.namespace}") as recorder:
            outcome = charger.dock(BY_CAMERA, lambda progress: phases.append(progress.phase))
        assert outcome.success, outcome
        assert charger.is_closed
        assert phases[0] == "locate"
        assert recorder.run.seen is not None
        assert recorder.run.seen.shape == (400, 640, 3)
        assert 1 <= charger.node("simulated_camera_node").rendered < 60  # while it looked, not while it docked
        charger.go_home()


PLACE = {"x": 0.02, "y": 0.01, "z": 0.22}


@pytest.mark.parametrize(
    ("target", "steps", "code"),
    [
        rest({"present": False}, {"locate_timeout": 3.0}, "ELECTRODES_NOT_FOUND"),
        rest({"roll": math.radians(11.8)}, {}, "CRITICAL_ANGLE"),
        rest(PLACE, {}, "UNREACHABLE"),
    ],
)
def test_what_the_image_forbids_is_refused_without_motion(
    context: Any, target: dict[str, Any], steps: dict[str, float], code: str
) -> None:
    phases: list[str] = []
    with RunningCharger(scene(steps, **target), context) as charger:
        before = charger.world.snapshot().position
        outcome = charger.dock(BY_CAMERA, lambda progress: phases.append(progress.phase))
        assert (outcome.success, outcome.error_name) == (False, code), outcome
        assert set(phases) <= {"idle", "locate", "retract"}
        assert math.dist(charger.world.snapshot().position, before) < 1e-4
        assert not charger.is_closed
    assert outcome.retriable is (code == "ELECTRODES_NOT_FOUND")
    if code == "UNREACHABLE":
        suggested = outcome.details["suggested_base_pose"]
        there = [PLACE[axis] - step for axis, step in zip("xyz", suggested["position"], strict=True)]
        assert there == pytest.approx(
            [0.0, 0.0, 0.080], abs=0.02
        )  # the camera's mount is off by 2 mm and half a degree


def test_a_simulated_camera_is_refused_beside_real_servos() -> None:
    nodes = ["servo_node", "simulated_camera_node", "electrode_detector_node", "docking_node"]
    with pytest.raises(SceneError, match="real servos would move there"):
        parse_scene({"nodes": nodes, "ports": {"servo": "/dev/ttyUSB0"}}, "mixed")


def test_the_simulated_camera_sees_the_world_s_target() -> None:
    given = scene(x=0.015).node_parameters("simulated_camera_node", {})
    assert (given["target_x"], given["target_present"], given["clutter"]) == (0.015, True, 6)
