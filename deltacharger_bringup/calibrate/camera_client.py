# SPDX-License-Identifier: Apache-2.0
"""A client of a running colour camera: its intrinsics, and an image taken after a given time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.context import Context
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_ros import qos
from deltacharger_ros.guest import Guest
from deltacharger_vision.cameras.ros_images import color_array
from deltacharger_vision.images import Intrinsics, rgb8
from deltacharger_vision.ros.messages import intrinsics_of, slash_hint

_SAME_CLOCK = 10.0  # s between stamp and arrival; beyond it the camera has another clock
_LATENCY = 0.5  # s; largest latency of an image of such a camera


class CameraError(RuntimeError):
    """No image from the camera; the message has the remedy."""


class CameraClient(Guest):
    """Subscribes to a colour image and its camera_info.

    Args:
        context: a running rclpy context.
        topic: of the colour image, relative to the charger's namespace; camera_info is beside it.
        namespace: of the charger.
    """

    def __init__(self, context: Context, topic: str, namespace: str = "") -> None:
        super().__init__("camera_client", context, namespace)
        self._topic = self.node.resolve_topic_name(topic)
        self._info_topic = f"{self._topic.rpartition('/')[0]}/camera_info"
        self._hint = slash_hint(self.node, topic)
        self._lock = threading.Lock()
        self._image: tuple[float, Image] | None = None
        self._info: Any = None
        self.node.create_subscription(Image, self._topic, self._on_image, qos.SENSOR)
        self.node.create_subscription(CameraInfo, self._info_topic, self._on_info, qos.SENSOR)
        self._clock = self.node.get_clock()
        self.serve()

    def intrinsics(self, timeout: float, check: Callable[[], None]) -> Intrinsics:
        """Wait for camera_info and return it.

        Args:
            timeout: s.
            check: called while waiting; may raise.

        Raises:
            CameraError: none arrives.
            CameraInfoError: it cannot be used.
        """
        if not self.wait(lambda: self._info is not None, timeout, check):
            raise CameraError(f"no {self._info_topic} received: start the camera in this ROS domain{self._hint}")
        return intrinsics_of(self._info, self._info_topic)

    def image(self, timeout: float, check: Callable[[], None]) -> NDArray[np.uint8]:
        """Return an image (H, W, 3) RGB taken after this call; arguments as in `intrinsics`.

        Raises:
            CameraError: none arrives.
            ImageError: its encoding is unknown.
        """
        since, asked = self._now(), time.monotonic()

        def fresh() -> Image | None:
            with self._lock:
                latest = self._image
            if latest is None:
                return None
            arrival, message = latest
            stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
            if abs(stamp - since) > _SAME_CLOCK:
                return message if arrival > asked + _LATENCY else None
            return message if stamp >= since and arrival > asked else None

        if not self.wait(lambda: fresh() is not None, timeout, check):
            raise CameraError(f"no image received on {self._topic}: check the camera's node and its cable{self._hint}")
        return rgb8(color_array(fresh()))

    def _now(self) -> float:
        return float(self._clock.now().nanoseconds) * 1e-9

    def _on_image(self, message: Image) -> None:
        with self._lock:
            self._image = (time.monotonic(), message)

    def _on_info(self, message: CameraInfo) -> None:
        self._info = message
