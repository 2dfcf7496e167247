# SPDX-License-Identifier: Apache-2.0
"""simulated_camera_node on the topics of a real camera: contents of its pictures."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from deltacharger.msg import ServoState
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_sim.charger.simulated_camera_node import SimulatedCameraNode
from deltacharger_vision.cameras.ros_formats import color_array, depth_array
from deltacharger_vision.hand_eye.board import Board

from ..chargers import Spin, wait_until
from ..nodes import options

pytestmark = pytest.mark.ros


class Viewer(Node):
    """Keeps the images of each subscribed topic."""

    def __init__(self, context: Any, namespace: str) -> None:
        super().__init__("viewer", **options(context, namespace))
        self.seen: dict[str, list[Any]] = {"color/image_raw": [], "depth/image_raw": [], "color/camera_info": []}

    def watch(self, *topics: str) -> None:
        for topic in topics:
            kind = CameraInfo if topic.endswith("info") else Image
            self.create_subscription(kind, topic, self.seen[topic].append, qos_profile_sensor_data)

    def color(self) -> np.ndarray:
        """Return the next colour image (H, W, 3)."""
        images = self.seen["color/image_raw"]
        count = len(images)
        return color_array(wait_until(lambda: images[count:], "a colour image")[0])

    def arm_at(self, *position: float) -> None:
        """Publish repeatedly that the platform is at `position`."""
        publisher = self.create_publisher(ServoState, "servo_state", QoSProfile(depth=1))
        angles = list(ScalarDelta().inverse(*position))
        self.create_timer(0.01, lambda: publisher.publish(ServoState(position=angles)))


@pytest.fixture
def viewer(context: Any, namespace: str, spin: Spin) -> Viewer:
    return spin(Viewer(context, namespace))


@pytest.fixture
def camera(context: Any, namespace: str, spin: Spin) -> Callable[..., SimulatedCameraNode]:
    return lambda **values: spin(SimulatedCameraNode(**options(context, namespace, rate=60.0, **values)))


def stamps(images: list[Image]) -> set[tuple[int, int]]:
    return {(each.header.stamp.sec, each.header.stamp.nanosec) for each in list(images)}


def test_a_picture_has_calibration_and_depth(camera: Callable[..., SimulatedCameraNode], viewer: Viewer) -> None:
    camera(target=[0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0])
    viewer.watch("color/image_raw", "color/camera_info", "depth/image_raw")
    color, depth, info = viewer.seen.values()
    wait_until(lambda: info and stamps(color) & stamps(depth), "colour and depth of one stamp")
    assert (color[0].encoding, depth[0].encoding) == ("rgb8", "16UC1")
    assert color[0].header.frame_id == depth[0].header.frame_id == "camera_color_optical_frame"
    assert (info[0].width, info[0].height) == (color[0].width, color[0].height) == (640, 400)
    middle = depth_array(depth[0])[195:206, 315:326]  # single pixels have no depth, as on a real camera
    assert np.median(middle) / 1e3 == pytest.approx(np.hypot(0.12, 0.2), abs=0.05)


def test_the_platform_and_a_board_on_it_are_drawn_at_the_servos_position(
    camera: Callable[..., SimulatedCameraNode], viewer: Viewer
) -> None:
    pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")
    camera(seed=3, board="apriltag:36h11:7")
    viewer.watch("color/image_raw")
    without = viewer.color().astype(float)
    viewer.arm_at(0.0, 0.0, 0.03)
    wait_until(lambda: np.abs(viewer.color().astype(float) - without).mean() > 5.0, "the platform in the picture")
    wait_until(lambda: Board(tag=7).detect(viewer.color()) is not None, "the tag in the picture")
