# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate camera --take N` with a running charger of mocks and the simulated camera."""

import itertools
import json
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import Image

from deltacharger_bringup.cli import camera_views, take_views
from deltacharger_bringup.scenes.scene import parse_scene
from deltacharger_core.ros import qos
from deltacharger_core.ros.executor import Spinner
from deltacharger_vision.mount import Mount
from deltacharger_vision.rendering.board_drawing import bracket
from deltacharger_vision.rendering.camera import OAK_D
from deltacharger_vision.ros.messages import color_message

from ..chargers import DEADLINE, Process, new_namespace, wait_until
from ..nodes import options
from ..running_charger import RunningCharger
from ..vision.hand_eye_rig import Rig, squared

pytestmark = pytest.mark.ros

pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

SCENE = {
    "nodes": [
        *("mock_servo_node", "mock_tactile_node", "mock_detector_node", "kinematics_node", "misalignment_node"),
        *("docking_node", "simulated_camera_node"),
    ],
    "parameters": {
        "docking_node": {"age_max": 1.0},
        "simulated_camera_node": {"board": "apriltag:36h11:0", "rate": 4.0},
    },
}


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[RunningCharger]:
    with RunningCharger(parse_scene(SCENE, "board"), context) as charger:
        yield charger


def torque(charger: RunningCharger) -> bool:
    return any(charger.servos.torque_enabled)


@pytest.fixture
def taking(charger: RunningCharger, start: Callable[..., Process]) -> Iterator[Callable[..., Process]]:
    place = bracket()[:3, 3]
    offset = [word for axis, v in zip("xyz", place, strict=True) for word in (f"--board-{axis}-mm", f"{1e3 * v:.3f}")]
    command = (sys.executable, "-m", "deltacharger_bringup.cli", "calibrate", "camera", "--namespace")

    def begin(*words: object) -> Process:
        return start(*command, charger.namespace, *offset, "--z-max-mm", "35", "--json", *map(str, words))

    yield begin
    wait_until(lambda: not torque(charger), "torque off")


@pytest.mark.night
def test_a_begun_folder_is_completed_and_solved(
    taking: Callable[..., Process], charger: RunningCharger, tmp_path: Path
) -> None:
    folder, out = tmp_path / "views", tmp_path / "mount.yaml"
    command = taking("--views", folder, "--take", 6)
    command.wait_for_line("view_001.png", command.err)
    assert torque(charger)
    assert command.end(signal.SIGINT) == 130, command.err
    command = taking("--views", folder, "--take", 6, "--out", out)
    assert command.end() == 0, command.err
    found = json.loads(command.out[0])
    assert found["views"] == 6
    assert found["held_out"]["rms"] < 0.001
    rig, mount = Rig(1, joints=0.0, offset=0.0), Mount.load(out)
    rig.mount, rig.place = Mount.default().pose, bracket()  # as in the scene
    assert squared(rig.error(mount), mount.covariance) < 25.0


def test_an_image_during_which_the_arm_moved_is_not_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, folder = Rig(1), camera_views.ViewsFolder(tmp_path / "views", OAK_D)
    places, stands = zip(*itertools.islice(rig.stands(), 3), strict=True)
    arm, camera = mock.Mock(), mock.Mock()
    after = [tuple(angle + 0.02 * (number == 1) for angle in angles) for number, angles in enumerate(stands)]
    arm.angles.side_effect = [angles for pair in zip(stands, after, strict=True) for angles in pair]
    camera.image.side_effect = [rig.image(angles) for angles in stands]
    take_views._visit(arm, camera, rig.board, places, folder, 2)
    assert len(folder.angles) == 2
    assert capsys.readouterr().err.count("moved while") == 1
    arm.go_home.assert_called_once()


@pytest.fixture(scope="module")
def camera(context: Any) -> Iterator[tuple[Callable[[], take_views.CameraClient], Callable[..., None]]]:
    """Functions that return a client, and publish its camera's image (with a stamp, ns)."""
    namespace = new_namespace()
    node = Node("driver", **options(context, namespace))
    images = node.create_publisher(Image, "color/image_raw", qos.SENSOR)

    def image(value: int, stamp: int) -> None:
        pixels = np.full((400, 640, 3), value, dtype=np.uint8)
        images.publish(color_message(pixels, Time(nanoseconds=stamp).to_msg()))

    spinner = Spinner(node)
    yield lambda: take_views.CameraClient(context, "color/image_raw", namespace), image
    spinner.close()


@pytest.mark.version
def test_an_image_from_before_the_request_is_not_used(camera: Any) -> None:
    client, image = camera

    def publish() -> None:
        image(1, time.time_ns() - 2 * 10**9)  # taken before the arm stopped
        image(2, time.time_ns() + 5 * 10**7)

    with client() as found:
        assert found.image(DEADLINE, publish)[0, 0, 0] == 2
        other_clock = found.image(DEADLINE, lambda: image(3, 5 * 10**9))  # its time of arrival counts
        assert (other_clock.shape, (other_clock == 3).all()) == ((400, 640, 3), True)
