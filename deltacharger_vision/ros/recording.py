# SPDX-License-Identifier: Apache-2.0
"""Messages of an RGB-D camera in an MCAP file, decoded; colour and depth images are matched by their stamps.

It needs the package mcap, `deltacharger[record]`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_core.mcap_file import McapFile, RecordingError
from deltacharger_vision import images, parameters
from deltacharger_vision.ros.messages import intrinsics_of, rgbd_of, stamp_ns

IMAGE, CAMERA_INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
_COLOR_NAME = "/color/image_raw"
_DEPTH_NAMES = ("/depth/image_raw", "/aligned_depth_to_color/image_raw")


@dataclass(frozen=True)
class CameraTopics:
    """Names of a camera's topics; "" = find it, or none.

    Attributes:
        color: sensor_msgs/Image.
        depth: sensor_msgs/Image, aligned to colour.
        info: sensor_msgs/CameraInfo, camera_info beside the colour.
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
        self.topics = choose_topics(path, self._file.types, asked or CameraTopics())
        self.images = self._file.counts[self.topics.color]

    def messages(self, *kinds: str) -> Iterator[Recorded]:
        """Yield the messages of some or all kinds, in the file's order.

        Raises:
            RecordingError: the file ends early, or is damaged from here on.
        """
        named = {getattr(self.topics, kind): kind for kind in kinds or (images.COLOR, images.DEPTH, images.INFO)}
        named.pop("", None)
        for each in self._file.messages(*named):
            yield Recorded(named[each.topic], each.received, each.data)


def choose_topics(path: Path, types: Mapping[str, str], asked: CameraTopics) -> CameraTopics:
    """Return the camera's topics; raises RecordingError if they are missing or ambiguous."""
    color = asked.color and _held(path, types, asked.color, IMAGE)
    if not color:
        found = sorted(topic for topic, kind in types.items() if kind == IMAGE and topic.endswith(_COLOR_NAME))
        if len(found) != 1:
            held = ", ".join(found or sorted(types)) or "nothing"
            raise RecordingError(f"{path}: {len(found)} topics of raw images end in {_COLOR_NAME}; name one of {held}")
        color = found[0]
    camera = color.removesuffix(_COLOR_NAME)
    depths = [camera + name for name in _DEPTH_NAMES if types.get(camera + name) == IMAGE]
    if not asked.depth and len(depths) > 1:
        raise RecordingError(f"{path}: several depth topics; name one of {', '.join(depths)}")
    info = parameters.info_topic(color)
    return CameraTopics(
        color,
        _held(path, types, asked.depth, IMAGE) if asked.depth else "".join(depths),
        info if types.get(info) == CAMERA_INFO else "",
    )


def _held(path: Path, types: Mapping[str, str], name: str, kind: str) -> str:
    topic = f"/{name.lstrip('/')}"
    if topic not in types:
        raise RecordingError(f"{path}: no topic {topic}; the file has {', '.join(sorted(types))}")
    if types[topic] != kind:
        raise RecordingError(f"{path}: {topic} has type {types[topic] or 'unknown'}; it must be {kind}")
    return topic


def decoded(recording: CameraRecording, each: Recorded) -> Any:
    """Decode a recorded message.

    Raises:
        RecordingError: the data are not of its topic's type.
    """
    kind = CameraInfo if each.kind == images.INFO else Image
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

    def read(self, camera: Any) -> images.RgbdImage:
        """Return it checked and converted, without depth if it has none; arguments and errors as of `rgbd_of`."""
        return rgbd_of(self.color, self.depth, camera)


def recorded_images(recording: CameraRecording) -> Iterator[RecordedImage]:
    """Yield the colour images in order, each with its depth image; colour images without one are left out.

    If the recording has no depth at all, every colour image is yielded without depth.

    Raises:
        RecordingError: the recording is damaged from this point on.
    """
    matcher: images.StampMatcher[Any] = images.StampMatcher()
    for each in recording.messages(images.COLOR, images.DEPTH):
        message = decoded(recording, each)
        stamp = stamp_ns(message)
        if not recording.topics.depth:
            yield RecordedImage(stamp, message, None)
            continue
        pair = matcher.add_image(each.kind, stamp, message)
        if pair is not None:
            yield RecordedImage(*pair)


def recorded_info(recording: CameraRecording) -> Any:
    """Return the recording's first camera_info, or None.

    Raises:
        CameraInfoError: it is unusable.
        RecordingError: the recording is damaged.
    """
    first = next(recording.messages(images.INFO), None) if recording.topics.info else None
    if first is None:
        return None
    info = decoded(recording, first)
    intrinsics_of(info, f"{recording.path}: {recording.topics.info}")
    return info
