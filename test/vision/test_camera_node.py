# SPDX-License-Identifier: Apache-2.0
"""camera_node: images of a camera over real topics, its errors, and topics of recordings."""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_core.mcap_file import RecordingError
from deltacharger_vision.cameras import camera_node, oak_pipeline, ros_formats
from deltacharger_vision.images import Intrinsics, RgbdImage
from deltacharger_vision.ros import messages, recording

from ..chargers import Spin, wait_until
from ..nodes import options

pytestmark = pytest.mark.ros

LENS = Intrinsics(64, 40, 44.0, 45.0, 31.0, 20.0, (-0.3, 0.1, 0.001, -0.002, 0.01))
MS = 1_000_000  # ns


def picture(number: int) -> RgbdImage:
    color = np.full((40, 64, 3), (number, 2 * number, 200), dtype=np.uint8)
    depth = np.full((40, 64), 0.3 + 1e-3 * number, dtype=np.float32)
    depth[0, 0] = np.nan
    return RgbdImage(color, depth, LENS)


def absent(*settings: Any) -> Any:
    raise oak_pipeline.CameraUnavailable("no OAK camera found")


@pytest.fixture
def client(context: Any, namespace: str, spin: Spin) -> Any:
    return spin(rclpy.create_node("client", **options(context, namespace)))


Start = Callable[..., camera_node.CameraNode]


@pytest.fixture
def start(context: Any, namespace: str, spin: Spin) -> Start:
    return lambda camera=absent, **values: spin(camera_node.CameraNode(camera, **options(context, namespace, **values)))


@pytest.mark.version
def test_images_are_published_unchanged_to_subscribers_only(start: Start, client: Any) -> None:
    opened, closed = list[tuple[Any, ...]](), threading.Event()
    camera = SimpleNamespace(name="14442C10", problem=lambda: "", close=closed.set)
    node = start(lambda *given: opened.append(given) or camera)
    wait_until(lambda: opened)
    _, wanted, take = opened[0]
    assert not wanted()
    kinds = {"color/image_raw": Image, "depth/image_raw": Image, "color/camera_info": CameraInfo}
    seen: dict[str, dict[int, Any]] = {topic: {} for topic in kinds}
    subscriptions = [
        client.create_subscription(
            kind,
            topic,
            lambda each, topic=topic: seen[topic].update({messages.stamp_ns(each): each}),
            qos_profile_sensor_data,
        )
        for topic, kind in kinds.items()
    ]

    def complete() -> int:
        take(oak_pipeline.OakImage(time.monotonic() - 0.5, picture(7)))
        return next(iter(set.intersection(*map(set, seen.values()))), 0)

    before = client.get_clock().now().nanoseconds
    stamp = wait_until(complete, "an image")
    assert before - 501 * MS <= stamp <= client.get_clock().now().nanoseconds - 499 * MS, "when it was taken"
    color, depth, info = (each[stamp] for each in seen.values())
    assert {each.header.frame_id for each in (color, depth, info)} == {"camera_color_optical_frame"}
    assert (color.encoding, depth.encoding) == ("rgb8", "16UC1")
    np.testing.assert_array_equal(ros_formats.color_array(color), picture(7).color)
    assert (ros_formats.depth_array(depth)[0, 0], ros_formats.depth_array(depth)[1, 1]) == (0, 307)
    assert ros_formats.from_camera_info(info.width, info.height, info.k, info.d, info.distortion_model) == LENS
    for each in subscriptions:
        client.destroy_subscription(each)
    wait_until(lambda: not wanted(), "nobody to want images")
    node.close()
    assert closed.is_set(), "the device is released"


def test_an_absent_camera_is_reported_with_its_settings(start: Start, client: Any) -> None:
    statuses: list[DiagnosticStatus] = []
    client.create_subscription(DiagnosticArray, "/diagnostics", lambda each: statuses.extend(each.status), 10)
    wait_until(lambda: client.count_subscribers("/diagnostics"))
    start(device_id="14442C10")
    status = wait_until(
        lambda: next((each for each in list(statuses) if "no OAK camera found" in each.message), None), "the problem"
    )
    assert (status.level, status.hardware_id) == (DiagnosticStatus.ERROR, "14442C10")


ANY = recording.CameraTopics()


def of(names: str) -> dict[str, str]:
    """Return types of topics by their names."""
    kinds = {"camera_info": recording.CAMERA_INFO, "compressed": "sensor_msgs/msg/CompressedImage"}
    return {name: kinds.get(name.rsplit("/", 1)[1], recording.IMAGE) for name in names.split()}


@pytest.mark.parametrize(
    ("names", "asked", "found"),
    [
        (
            "/c/color/image_raw /c/depth/image_rect_raw /c/aligned_depth_to_color/image_raw /c/color/camera_info",
            ANY,
            "/c/color/image_raw /c/aligned_depth_to_color/image_raw /c/color/camera_info",
        ),
        (
            "/oak/rgb/image_raw /oak/stereo/image_raw",
            recording.CameraTopics("oak/rgb/image_raw", "/oak/stereo/image_raw"),
            "/oak/rgb/image_raw /oak/stereo/image_raw ",
        ),
    ],
)
def test_topics_of_other_drivers_are_found_or_named(names: str, asked: recording.CameraTopics, found: str) -> None:
    assert recording.choose_topics(Path("rec"), of(names), asked) == recording.CameraTopics(*found.split(" "))


@pytest.mark.parametrize(
    ("names", "asked", "noun"),
    [
        ("/a/color/image_raw /b/color/image_raw", ANY, "/a/color/image_raw, /b/color/image_raw"),
        ("/color/image_raw", recording.CameraTopics("d"), "/d"),
        ("/color/image_raw/compressed", ANY, "name one of /color/image_raw/compressed"),
    ],
)
def test_ambiguous_compressed_and_missing_topics_are_refused_with_the_choices(
    names: str, asked: recording.CameraTopics, noun: str
) -> None:
    with pytest.raises(RecordingError, match=noun) as refused:
        recording.choose_topics(Path("rec.mcap"), of(names), asked)
    assert "rec.mcap" in str(refused.value)
