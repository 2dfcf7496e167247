# SPDX-License-Identifier: Apache-2.0
"""Docking from the image to charging, and every refusal by the image, with simulated camera and hardware."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

import pytest

from deltacharger_records.replay.recorder import Recorder
from deltacharger_ros.client import ChargerClient
from deltacharger_ros.outcomes import DockRequest, Outcome
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.scene import Scene, SceneError, parse_scene

from ..chargers import DEADLINE, new_namespace
from ..quick import quick_simulation

pytestmark = pytest.mark.ros

BY_CAMERA = DockRequest(None)


def scene(steps: Mapping[str, Any] = MappingProxyType({}), **target: Any) -> Scene:
    """The packaged scene with quick steps, other parameters of docking_node, and another target."""
    packaged = quick_simulation("camera", steps)
    assert packaged.simulation is not None
    world = packaged.simulation.world
    moved = dataclasses.replace(world, target=dataclasses.replace(world.target, **target))
    return dataclasses.replace(packaged, simulation=dataclasses.replace(packaged.simulation, world=moved))


@contextmanager
def charger(context: Any, what: Scene) -> Iterator[tuple[Composition, ChargerClient]]:
    name = new_namespace()
    with Composition(what, context, name) as composition, ChargerClient(name) as client:
        assert client.wait_until_ready(DEADLINE)
        yield composition, client


def refused(context: Any, what: Scene) -> Outcome:
    """Dock with a refusal and no motion, and return the outcome."""
    with charger(context, what) as (composition, client):
        assert composition.charger is not None
        world = composition.charger.world
        before = world.snapshot().position
        phases: list[str] = []
        outcome = client.dock(BY_CAMERA, lambda progress: phases.append(progress.phase), deadline=120.0)
        assert not outcome.success
        assert set(phases) <= {"idle", "locate", "retract"}
        assert math.dist(world.snapshot().position, before) < 1e-4
        assert not world.snapshot().contactor_closed
    return outcome


@pytest.fixture(autouse=True)
def with_opencv() -> None:
    pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")


def test_it_docks_from_the_image_and_charges(context: Any) -> None:
    with charger(context, scene()) as (composition, client):
        phases: list[str] = []
        with Recorder(context, client.node.get_namespace()) as recorder:
            outcome = client.dock(BY_CAMERA, lambda progress: phases.append(progress.phase), deadline=120.0)
        assert outcome.success, outcome
        assert recorder.run.seen is not None
        assert recorder.run.seen.shape == (400, 640, 3)
        assert phases[0] == "locate"
        assert composition.charger is not None
        truth = composition.charger.world
        assert truth.snapshot().contactor_closed
        assert truth.record.energised_shorts == 0
        assert truth.record.energised_unsafe == 0.0
        rendered = composition.node("simulated_camera_node").rendered
        assert 1 <= rendered < 60  # while it looked, not while it docked
        assert client.undock(deadline=60.0).success


def test_without_electrodes_in_the_image_the_arm_does_not_move(context: Any) -> None:
    outcome = refused(context, scene({"locate_timeout": 3.0}, present=False))
    assert outcome.error_name == "ELECTRODES_NOT_FOUND"
    assert "no electrodes in the image" in outcome.error_message
    assert outcome.retriable


def test_a_roll_that_could_be_critical_is_refused_before_contact(context: Any) -> None:
    outcome = refused(context, scene(roll=math.radians(11.8)))
    assert outcome.error_name == "CRITICAL_ANGLE"


def test_a_target_out_of_reach_is_refused_with_the_robots_correction(context: Any) -> None:
    place = {"x": 0.02, "y": 0.01, "z": 0.22}
    outcome = refused(context, scene(**place))
    assert outcome.error_name == "UNREACHABLE"
    suggested = outcome.details["suggested_base_pose"]
    there = [place[axis] - step for axis, step in zip("xyz", suggested["position"], strict=True)]
    assert there == pytest.approx([0.0, 0.0, 0.080], abs=0.02)  # the camera's mount is off by 2 mm and half a degree


def test_a_simulated_camera_is_refused_beside_real_servos() -> None:
    nodes = ["servo_node", "simulated_camera_node", "electrode_detector_node", "docking_node"]
    with pytest.raises(SceneError, match="real servos would move there"):
        parse_scene({"nodes": nodes, "ports": {"servo": "/dev/ttyUSB0"}}, "mixed")


def test_the_simulated_camera_sees_the_world_s_target() -> None:
    given = scene(x=0.015).node_parameters("simulated_camera_node", {})
    assert given["target_x"] == 0.015
    assert given["target_present"] is True
    assert given["clutter"] == 6
