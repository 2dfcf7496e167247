# SPDX-License-Identifier: Apache-2.0
"""What camera_node says to ROS: images from the camera, or from a recording at its own pace."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_core.mcap_file import RecordingError
from deltacharger_vision import parameters as topics
from deltacharger_vision.cameras import recording as camera_recording
from deltacharger_vision.cameras.keeper import ImageSource
from deltacharger_vision.cameras.recording import CameraRecording, Recorded
from deltacharger_vision.images import RgbdImage
from deltacharger_vision.mount import CAMERA_FRAME
from deltacharger_vision.ros.messages import camera_info_message, color_message, depth_message, stamp_ns
from deltacharger_vision.ros.recorded import decoded

_PAUSE = 0.05  # s between two looks for subscribers
_JUMP = 1_000_000_000  # ns; a stamp so far from its pace comes from another clock than those before
_LEAST_GAP = 0.01  # s between two passes of a recording whose images have all one time


class CameraPublishers:
    """The three topics of an RGB-D camera.

    Attributes:
        published: number of colour images, of those that somebody wanted.
    """

    def __init__(self, node: Node) -> None:
        self._clock = node.get_clock()
        self._context = node.context
        self._publishers = {
            camera_recording.COLOR: node.create_publisher(Image, topics.COLOR, qos_profile_sensor_data),
            camera_recording.DEPTH: node.create_publisher(Image, topics.DEPTH, qos_profile_sensor_data),
            camera_recording.INFO: node.create_publisher(CameraInfo, topics.CAMERA_INFO, qos_profile_sensor_data),
        }
        self.published = 0

    def wanted(self, *kinds: str) -> bool:
        """Return whether somebody subscribes to one of these kinds, or to any."""
        return any(self._publishers[kind].get_subscription_count() for kind in kinds or self._publishers)

    def now(self) -> int:
        """Return ROS time, ns."""
        return int(self._clock.now().nanoseconds)

    def image(self, image: RgbdImage, taken: float) -> None:
        """Publish what somebody wants of an image, taken at `taken` (s by time.monotonic), with one stamp for all."""
        stamp = _time(self.now() - round(1e9 * (time.monotonic() - taken)))
        messages: tuple[tuple[str, Callable[[], Any]], ...] = (
            (camera_recording.INFO, lambda: camera_info_message(image.intrinsics, stamp)),
            (camera_recording.COLOR, lambda: color_message(image.color, stamp)),
            (camera_recording.DEPTH, lambda: depth_message(image.depth, stamp)),
        )
        for kind, make in messages:
            if self.wanted(kind):
                self._publish(kind, make())

    def recorded(self, kind: str, message: Any, stamp: int) -> None:
        """Publish a message anew at another time, ns."""
        message.header.stamp, message.header.frame_id = _time(stamp), CAMERA_FRAME
        self._publish(kind, message)

    def _publish(self, kind: str, message: Any) -> None:
        if self._context.ok():
            self._publishers[kind].publish(message)
            self.published += kind == camera_recording.COLOR


class RecordingPlayer(ImageSource):
    """Publishes a recording at its own pace, from the moment that somebody subscribes.

    Stamps are moved to the present and keep their distances; each colour image has a camera_info of its stamp.

    Attributes:
        passes: how often it came to the end.

    Args:
        recording: to publish.
        publishers: of the topics.
        loop: begin again at the end.
        on_change: called in its thread when `problem` changes.
    """

    def __init__(
        self, recording: CameraRecording, publishers: CameraPublishers, loop: bool, on_change: Callable[[], None]
    ) -> None:
        super().__init__("", on_change)
        self.passes = 0
        self._recording = recording
        self._publishers = publishers
        self._loop = loop
        self._info = next((decoded(recording, each) for each in recording.messages(camera_recording.INFO)), None)

    def _run(self) -> None:
        while not self._publishers.wanted():
            if self._stop.wait(_PAUSE):
                return
        try:
            self._play()
            while self._loop and not self._stop.is_set():
                self._play()
            problem = "the recording has ended"
        except RecordingError as error:
            problem = str(error)
        if not self._stop.is_set():
            self._tell(problem)

    def _play(self) -> None:
        """Publish the recording once, or until it is told to stop."""
        started, first, shift = time.monotonic(), None, None
        for each in self._recording.messages():
            first = each.time if first is None else first
            lasted = 1e-9 * (each.time - first)
            if self._stop.wait(max(0.0, started + lasted - time.monotonic())):
                return
            if each.kind == camera_recording.INFO:
                self._info = decoded(self._recording, each)
            elif self._publishers.wanted(each.kind, camera_recording.INFO):
                shift = self._publish(each, shift)
        self.passes += 1
        if self._loop:
            self._stop.wait(max(_LEAST_GAP, lasted / max(self._recording.images - 1, 1)))

    def _publish(self, each: Recorded, shift: int | None) -> int:
        """Publish an image and return by how much its stamp was moved, ns."""
        message, now = decoded(self._recording, each), self._publishers.now()
        stamp = stamp_ns(message)
        if shift is None or abs(stamp + shift - now) > _JUMP:
            shift = now - stamp
        if each.kind == camera_recording.COLOR and self._info is not None:
            self._publishers.recorded(camera_recording.INFO, self._info, stamp + shift)
        self._publishers.recorded(each.kind, message, stamp + shift)
        return shift


def _time(stamp: int) -> Time:
    return Time(sec=stamp // 1_000_000_000, nanosec=stamp % 1_000_000_000)
