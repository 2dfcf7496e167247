# SPDX-License-Identifier: Apache-2.0
"""The topics of an RGB-D camera, real, recorded or simulated."""

from __future__ import annotations

import time
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_vision import parameters as topics
from deltacharger_vision.images import COLOR, DEPTH, INFO, Intrinsics, RgbdImage
from deltacharger_vision.ros.messages import camera_info_message, color_message, depth_message


class CameraPublishers:
    """The three topics of an RGB-D camera.

    Args:
        node: that publishes.
        frame_id: full name of the camera's optical frame.

    Attributes:
        published: number of colour images published.
    """

    def __init__(self, node: Node, frame_id: str) -> None:
        self._frame_id = frame_id
        self._recorded_frame: str | None = None
        self._clock = node.get_clock()
        self._context = node.context
        self._publishers = {
            COLOR: node.create_publisher(Image, topics.COLOR, qos_profile_sensor_data),
            DEPTH: node.create_publisher(Image, topics.DEPTH, qos_profile_sensor_data),
            INFO: node.create_publisher(CameraInfo, topics.CAMERA_INFO, qos_profile_sensor_data),
        }
        self.published = 0

    def wanted(self, *kinds: str) -> bool:
        """Return whether one of these kinds, or any, has subscribers."""
        return any(self._publishers[kind].get_subscription_count() for kind in kinds or self._publishers)

    def now(self) -> int:
        """Return ROS time, ns."""
        return int(self._clock.now().nanoseconds)

    def image(self, image: RgbdImage, taken: float, has_depth: bool = True) -> None:
        """Publish the parts of an image that have subscribers; `taken` is its time (s, time.monotonic)."""
        stamp = _time(self.now() - round(1e9 * (time.monotonic() - taken)))
        if self.wanted(INFO):
            self._publish(INFO, camera_info_message(image.intrinsics, stamp, self._frame_id))
        if self.wanted(COLOR):
            self._publish(COLOR, color_message(image.color, stamp, self._frame_id))
        if has_depth and self.wanted(DEPTH):
            self._publish(DEPTH, depth_message(image.depth, stamp, self._frame_id))

    def info(self, intrinsics: Intrinsics) -> None:
        """Publish the calibration alone, stamped now."""
        self._publish(INFO, camera_info_message(intrinsics, _time(self.now()), self._frame_id))

    def recorded(self, kind: str, message: Any, stamp: int) -> None:
        """Publish a message again with another stamp, ns; its frame is this camera's if it was the first one's."""
        if self._recorded_frame is None:
            self._recorded_frame = message.header.frame_id
        message.header.stamp = _time(stamp)
        if message.header.frame_id == self._recorded_frame:  # so depth that is not aligned to colour still shows it
            message.header.frame_id = self._frame_id
        self._publish(kind, message)

    def _publish(self, kind: str, message: Any) -> None:
        if self._context.ok():
            self._publishers[kind].publish(message)
            self.published += kind == COLOR


def _time(stamp: int) -> Time:
    return Time(sec=stamp // 1_000_000_000, nanosec=stamp % 1_000_000_000)
