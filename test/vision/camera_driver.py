# SPDX-License-Identifier: Apache-2.0
"""A substitute of an RGB-D driver: repeats one image of a target at a known pose again and again."""

import math
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from deltacharger.srv import DetectElectrodes
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_core.ros.messages import duration
from deltacharger_vision import images, mount
from deltacharger_vision.rendering import camera, scene
from deltacharger_vision.ros.messages import camera_info_message, color_message, depth_message

from ..nodes import call, options

TARGET = (0.012, -0.009, 0.084, 0.06)
PERIOD = 50_000_000  # ns


def picture(target: bool = True) -> images.RgbdImage:
    """Image of a target at TARGET, from a camera at the default mount."""
    pose = np.eye(4)
    c, s = math.cos(TARGET[3]), math.sin(TARGET[3])
    pose[:2, :2], pose[:3, 3] = [[c, -s], [s, c]], TARGET[:3]
    camera_T_terminal = np.linalg.inv(mount.Mount.default().pose) @ pose
    return camera.SimulatedCamera().render(
        scene.RenderedScene(target=target), camera_T_terminal, np.random.default_rng(5)
    )


class Driver(Node):
    """An RGB-D driver that repeats one image at 20 Hz."""

    def __init__(self, context: Any, namespace: str) -> None:
        super().__init__("driver", **options(context, namespace))
        self.color = self.create_publisher(Image, "color/image_raw", qos_profile_sensor_data)
        self.depth = self.create_publisher(Image, "depth/image_raw", qos_profile_sensor_data)
        self.info = self.create_publisher(CameraInfo, "color/camera_info", qos_profile_sensor_data)
        self.image = picture()
        self.client = self.create_client(DetectElectrodes, "detect_electrodes")
        self.create_timer(1e-9 * PERIOD, self._publish)

    @property
    def listeners(self) -> int:
        return sum(each.get_subscription_count() for each in (self.color, self.depth, self.info))

    def ask(self, timeout: float = 0.0) -> DetectElectrodes.Response:
        return call(self.client, DetectElectrodes.Request(timeout=duration(timeout)))

    def _publish(self) -> None:
        now = self.get_clock().now().nanoseconds
        exposed = stamp(now - now % PERIOD)  # a camera exposes by its own clock, even if it is served late
        self.info.publish(camera_info_message(self.image.intrinsics, exposed))
        self.color.publish(color_message(self.image.color, exposed))
        self.depth.publish(depth_message(self.image.depth, exposed))


def stamp(nanoseconds: int) -> Time:
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
