# SPDX-License-Identifier: Apache-2.0
"""Messages of an RGB-D camera in an MCAP file, decoded; colour and depth images are matched by their stamps.

It needs the package mcap, `deltacharger[record]`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_core.mcap_file import McapFile, RecordingError
from deltacharger_vision.images import COLOR, DEPTH, INFO, STAMP_TOLERANCE, RgbdImage, StampMatcher
from deltacharger_vision.ros.messages import intrinsics_of, rgbd_of, stamp_ns

IMAGE, CAMERA_INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
_COMPRESSED = "sensor_msgs/msg/CompressedImage"
_COLOR_NAME = "color/image_raw"
_DEPTH_NAMES = ("depth/image_raw", "aligned_depth_to_color/image_raw")
_INFO_NAME = "camera_info"


@dataclass(frozen=True)
class CameraTopics:
    """Names of a camera's topics; "" = find it, or none.

    Attributes:
        color: sensor_msgs/Image.
        depth: sensor_msgs/Image, aligned to colour.
        info: sensor_msgs/CameraInfo of the colour image.
    """

    color: str = ""
    depth: str = ""
    info: str = ""


class Recorded(NamedTuple):
    """One message.

    Attributes:
        kind: COLOR, DEPTH or INFO.
        time: of recording, ns.
        data: CDR of IMAGE or CAMERA_INFO.
    """

    kind: str
    time: int
    data: bytes


class CameraRecording:
    """The images of one camera in an MCAP file; a truncated file is read up to its end.

    If no topics are named, colour is the only topic that ends in color/image_raw. Depth is its neighbour that ends in
    depth/image_raw or aligned_depth_to_color/image_raw. The intrinsics are the camera_info next to the colour.

    Args:
        path: of the file, or of a folder with one.
        asked: requested topics, with or without the leading slash; the class finds those that are "".

    Attributes:
        topics: color, and depth and info if present.
        images: number of colour images.

    Raises:
        OSError: the file cannot be read.
        RecordingError: mcap is missing, or the file is no MCAP file, has no raw colour images, or several cameras.
    """

    def __init__(self, path: Path, asked: CameraTopics | None = None) -> None:
        self._file = McapFile(path)
        self.path = path = self._file.path
        self.topics = _Topics(path, self._file.types).choose(asked or CameraTopics())
        self.images = self._file.counts[self.topics.color]

    def messages(self, *kinds: str) -> Iterator[Recorded]:
        """Yield the messages of some or all kinds, in the file's order.

        Raises:
            RecordingError: the file ends early, or is damaged from here on.
        """
        named = {getattr(self.topics, kind): kind for kind in kinds or (COLOR, DEPTH, INFO)}
        named.pop("", None)
        for each in self._file.messages(*named):
            yield Recorded(named[each.topic], each.received, each.data)


class _Topics:
    """The topics of a recording.

    Args:
        path: of the recording, for errors.
        types: type of each topic.
    """

    def __init__(self, path: Path, types: Mapping[str, str]) -> None:
        self._path = path
        self._types = types

    def choose(self, asked: CameraTopics) -> CameraTopics:
        """Return the camera's topics; raises RecordingError if they are ambiguous."""
        color = self._held(asked.color, IMAGE) if asked.color else self._color()
        depth = self._held(asked.depth, IMAGE) if asked.depth else self._depth(color)
        info = self._held(asked.info, CAMERA_INFO) if asked.info else self._beside(color, _INFO_NAME)
        return CameraTopics(color, depth, info)

    def _color(self) -> str:
        images = self._of(IMAGE)
        found = [topic for topic in images if _ends(topic, _COLOR_NAME)]
        if len(found) == 1:
            return found[0]
        compressed = [topic for topic in self._of(_COMPRESSED) if not images or f"/{_COLOR_NAME}/" in topic]
        held = ", ".join(found or images or sorted(self._types)) or "nothing"
        if found:
            problem = f"several topics end in {_COLOR_NAME}; name one of {held}"
        elif compressed:
            problem = _advice(compressed[0])
        elif images:
            problem = f"no topic ends in {_COLOR_NAME}; name one of {held}"
        else:
            problem = f"holds no images, only {held}"
        raise RecordingError(f"{self._path}: {problem}")

    def _depth(self, color: str) -> str:
        found = [topic for topic in self._of(IMAGE) if topic != color and any(_ends(topic, e) for e in _DEPTH_NAMES)]
        beside = [topic for topic in found if _ends(color, _COLOR_NAME) and _camera(topic) == _camera(color)]
        if len(beside or found) > 1:
            raise RecordingError(f"{self._path}: several depth topics; name one of {', '.join(beside or found)}")
        return (beside or found or [""])[0]

    def _beside(self, color: str, name: str) -> str:
        topic = f"{color.rpartition('/')[0]}/{name}"
        return topic if self._types.get(topic) == CAMERA_INFO else ""

    def _held(self, name: str, kind: str) -> str:
        topic = f"/{name.lstrip('/')}"
        held = self._types.get(topic)
        if held == kind:
            return topic
        if held == _COMPRESSED:
            raise RecordingError(f"{self._path}: {_advice(topic)}")
        if held is not None:
            raise RecordingError(f"{self._path}: {topic} has type {held or 'unknown'}; it must be {kind}")
        raise RecordingError(f"{self._path}: no topic {topic}; the file has {', '.join(sorted(self._types))}")

    def _of(self, kind: str) -> list[str]:
        return sorted(topic for topic, held in self._types.items() if held == kind)


def _ends(topic: str, name: str) -> bool:
    return topic.endswith(f"/{name}")


def _camera(topic: str) -> str:
    """Return a topic without its last two names: the namespace that a camera's topics share."""
    return topic.rsplit("/", 2)[0]


def _advice(topic: str) -> str:
    raw = topic.rpartition("/")[0]
    return f"{topic} holds compressed images; record {raw} instead, or republish it with image_transport"


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

    def read(self, camera: Any) -> RgbdImage:
        """Return it checked and converted, without depth if it has none; arguments and errors as of `rgbd_of`."""
        return rgbd_of(self.color, self.depth, camera)


def recorded_images(recording: CameraRecording) -> Iterator[RecordedImage]:
    """Yield the colour images in order, each with its depth image; colour images without one are left out.

    If the recording has no depth at all, every colour image is yielded without depth.

    Raises:
        RecordingError: the recording is damaged from this point on.
    """
    matcher: StampMatcher[Any, Any] = StampMatcher(STAMP_TOLERANCE)
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
