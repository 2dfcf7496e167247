# SPDX-License-Identifier: Apache-2.0
"""A camera's recorded messages, decoded; colour and depth images are matched by their stamps.

Separate, because publishers and subscribers of images need no recordings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_core.mcap_file import RecordingError
from deltacharger_vision.cameras.recording import CameraRecording, Recorded
from deltacharger_vision.images import COLOR, DEPTH, INFO, MILLIMETRE, RgbdImage, StampMatcher
from deltacharger_vision.ros.messages import intrinsics_of, rgbd_of, stamp_ns

TOLERANCE = 15_000_000
"""ns between the stamps of colour and depth: less than half of an image period at 30 Hz."""


def decoded(recording: CameraRecording, each: Recorded) -> Any:
    """Decode a recorded message.

    Raises:
        RecordingError: the data are not of its topic's type.
    """
    kind = CameraInfo if each.kind == INFO else Image
    try:
        return deserialize_message(each.data, kind)
    except Exception as error:  # rclpy's own private classes
        raise RecordingError(f"{recording.path}: holds a message that is no {kind.__name__}: {error}") from error


@dataclass(frozen=True)
class RecordedImage:
    """One recorded image.

    Attributes:
        stamp: of the colour, ns.
        color: sensor_msgs/Image.
        depth: sensor_msgs/Image, or None.
    """

    stamp: int
    color: Any
    depth: Any

    @property
    def name(self) -> str:
        """The stamp in s."""
        return f"{self.stamp // 10**9}.{self.stamp % 10**9:09}"

    def read(self, camera: Any, depth_unit: float = MILLIMETRE) -> RgbdImage:
        """Return it checked and converted, without depth if it has none; arguments and errors as of `rgbd_of`."""
        return rgbd_of(self.color, self.depth, camera, depth_unit)


def recorded_images(recording: CameraRecording) -> Iterator[RecordedImage]:
    """Yield the colour images in order, each with its depth image; colour images without one are left out.

    If the recording has no depth at all, every colour image is yielded without depth.

    Raises:
        RecordingError: the recording is damaged from this point on.
    """
    matcher: StampMatcher[Any, Any] = StampMatcher(TOLERANCE)
    for each in recording.messages(COLOR, DEPTH):
        message = decoded(recording, each)
        stamp = stamp_ns(message)
        if not recording.topics.depth:
            yield RecordedImage(stamp, message, None)
            continue
        pair = (matcher.add_color if each.kind == COLOR else matcher.add_depth)(stamp, message)
        if pair is not None:
            yield RecordedImage(*pair)


def recorded_info(recording: CameraRecording) -> Any:
    """Return the recording's first camera_info, or None.

    Raises:
        CameraInfoError: it is unusable.
        RecordingError: the recording is damaged.
    """
    first = next(recording.messages(INFO), None) if recording.topics.info else None
    if first is None:
        return None
    info = decoded(recording, first)
    intrinsics_of(info, f"{recording.path}: {recording.topics.info}")
    return info
