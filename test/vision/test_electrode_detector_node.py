# SPDX-License-Identifier: Apache-2.0
"""electrode_detector_node: answers from prepared images, problems of its topics, and one request over real topics."""

import contextlib
import itertools
import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from deltacharger.msg import ElectrodeDetection
from deltacharger.srv import DetectElectrodes
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from deltacharger_core.ros import messages, node_support
from deltacharger_vision import images, mount
from deltacharger_vision.ros.messages import camera_info_message, color_message, depth_message

from ..chargers import DEADLINE, Spin, wait_until
from ..nodes import numbers, options
from ..transforms import Robot, transforms
from .camera_driver import TARGET, Driver, picture, stamp

pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

from deltacharger_vision.detector import electrode_detector_node
from deltacharger_vision.detector.electrode_detector_node import ElectrodeDetectorNode, Shot

pytestmark = pytest.mark.ros

NodeMaker = Callable[..., ElectrodeDetectorNode]


@pytest.fixture(scope="module")
def seen() -> images.RgbdImage:
    return picture()


@pytest.fixture
def node(context: Any, namespace: str) -> Iterator[NodeMaker]:
    """Make nodes that nobody serves; the age of their images does not depend on this computer's load."""
    made: list[ElectrodeDetectorNode] = []

    def make(**values: Any) -> ElectrodeDetectorNode:
        made.append(ElectrodeDetectorNode(**options(context, namespace, image_age_max=2.0, **values)))
        return made[-1]

    yield make
    for each in made:
        each.close()
        each.destroy_node()


def shot(node: ElectrodeDetectorNode, image: images.RgbdImage, age: float = 0.0, apart: float = 0.0) -> Shot:
    """Messages of an image, `age` s old, and of its depth, `apart` s later."""
    now = node.get_clock().now().nanoseconds - round(1e9 * age)
    color, depth = color_message(image.color, stamp(now)), depth_message(image.depth, stamp(now + round(1e9 * apart)))
    return Shot(1, now, color, depth, camera_info_message(image.intrinsics, stamp(now)))


def asked(node: ElectrodeDetectorNode, shots: Iterable[Shot], timeout: float = 30.0) -> DetectElectrodes.Response:
    taken, watching = iter(shots), contextlib.nullcontext
    camera: Any = mock.Mock(shots=0, watching=watching, problem=lambda: "no images", after=lambda *_: next(taken, None))
    node._camera = camera
    return node._on_detect(DetectElectrodes.Request(timeout=messages.duration(timeout)), DetectElectrodes.Response())


def place(answer: DetectElectrodes.Response) -> list[float]:
    assert answer.success, answer.message
    position = answer.detection.pose.pose.position
    return [position.x, position.y, position.z]


def test_electrodes_are_reported_in_charger_base_with_a_valid_covariance(
    node: NodeMaker, seen: images.RgbdImage
) -> None:
    made = node()
    answer = asked(made, [shot(made, seen)])
    found, off = answer.detection, np.subtract(place(answer), TARGET[:3])
    covariance = np.reshape(found.pose.covariance, (6, 6))
    assert np.linalg.norm(off) < 0.001
    assert off @ np.linalg.solve(covariance[:3, :3], off) < 9.0
    assert np.sqrt(np.diag(covariance)[3:]) == pytest.approx(math.radians(0.5), rel=0.2)  # the mount's dominates
    assert found.roll == pytest.approx(TARGET[3], abs=0.005)
    assert (found.header.frame_id, found.source) == ("charger_base", "both")


def test_a_request_is_refused_with_its_reason_and_without_a_pose(node: NodeMaker, seen: images.RgbdImage) -> None:
    made, empty = node(), picture(target=False)
    aside, other, broken = (shot(made, seen) for _ in range(3))
    aside.depth.header.frame_id = other.info.header.frame_id = "left_infrared"
    object.__setattr__(broken, "image", mock.Mock(side_effect=OverflowError))
    old, future = shot(made, seen, age=3.0), shot(made, seen, age=-30.0)
    for shots, nouns in (
        ([], ["no images", "0 images"]),
        ([shot(made, empty)], ["no electrodes"]),
        ([aside], ["left_infrared", "camera_color_optical_frame", "align_depth.enable"]),
        ([other], ["left_infrared", "camera_info"]),
        ([broken], ["the detector failed", "OverflowError"]),
        ([old], ["old", "clocks", "1 of them"]),
        ([future], ["future", "clocks"]),
    ):
        answer = asked(made, shots)
        assert not answer.success
        assert all(noun in answer.message for noun in nouns), answer.message
        assert all(map(math.isnan, numbers(answer.detection)))
    assert "timeout" in asked(made, [shot(made, seen)], timeout=-1.0).message


def test_a_request_ends_in_time_if_detection_is_slower_than_the_camera(node: NodeMaker, seen: images.RgbdImage) -> None:
    transforms()
    made = node(mount_from_tf=True, transform_timeout=10.0)
    began = time.monotonic()
    answer = asked(made, (shot(made, seen) for _ in itertools.count()), 0.3)
    assert time.monotonic() - began < 5.0
    assert not answer.success
    assert "tf" in answer.message


def test_the_camera_pose_can_come_from_tf_or_a_file(node: NodeMaker, context: Any, spin: Spin, tmp_path: Path) -> None:
    robot = spin(Robot(context))
    made = spin(node(mount_from_tf=True, frame_prefix="left/", transform_timeout=10.0))
    usual = mount.Mount.default().pose
    moved = (*(usual[:3, 3] + (0.0, 0.0, 0.1)), *mount.quaternion(usual[:3, :3]))
    robot.fix("left/charger_base", "camera", moved)
    image = Header(frame_id="camera", stamp=made.get_clock().now().to_msg())
    expected = np.vstack([np.c_[usual[:3, :3], moved[:3]], [0.0, 0.0, 0.0, 1.0]])
    mount.Mount(expected, 1e-10 * np.eye(6)).save(tmp_path / "mount.yaml")
    for given in (made, node(mount_file=str(tmp_path / "mount.yaml"))):
        np.testing.assert_allclose(given._mounted(image).pose, expected, atol=1e-6)
    with pytest.raises(node_support.StartupError, match="mount_from_tf"):
        node(mount_from_tf=True, mount_file="m.yaml")


def test_missing_silent_and_unmatched_topics_are_named(
    node: NodeMaker, seen: images.RgbdImage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(electrode_detector_node, "SILENT", 0.05)
    made, numbered = node(), itertools.count()
    camera = made._camera

    def fed(apart: float) -> str:
        taken = shot(made, seen, -0.05 * next(numbered), apart)  # 20 Hz, for any computer
        for subscription, message in zip(camera._subscriptions, (taken.color, taken.depth, taken.info), strict=True):
            subscription.callback(message)
        return camera.problem()

    with camera.watching():
        assert all(name in camera.problem() for name in camera.names)
        for name, kind in zip(camera.names, (Image, Image, CameraInfo), strict=True):
            made.create_publisher(kind, name, 1)
        wait_until(lambda: "cable" in camera.problem(), "silent topics")
        wait_until(lambda: "synchronise" in fed(apart=0.024), "unmatched images")
        wait_until(lambda: not fed(apart=0.0), "images")


def test_closing_releases_waiting_requests(node: NodeMaker) -> None:
    made, response = node(), DetectElectrodes.Response()
    request = DetectElectrodes.Request(timeout=messages.duration(600.0))
    waiting = threading.Thread(target=made._on_detect, args=(request, response))
    waiting.start()
    wait_until(lambda: made._camera.watched, "the request to wait")
    made.close()
    waiting.join(DEADLINE)
    assert not waiting.is_alive()


@pytest.mark.version
def test_it_listens_only_while_it_detects(context: Any, namespace: str, node: NodeMaker, spin: Spin) -> None:
    driver, shown, received = spin(Driver(context, namespace)), list[Image](), list[ElectrodeDetection]()
    made = spin(node(rate=20.0))
    assert driver.client.wait_for_service(DEADLINE)
    assert driver.listeners == 0
    pictures = driver.create_subscription(Image, "electrode_detection/image", shown.append, qos_profile_sensor_data)
    wait_until(lambda: made._pictures.get_subscription_count(), "the picture's subscriber")
    place(driver.ask(30.0))
    wait_until(lambda: shown, "an annotated image")
    drawn = np.frombuffer(shown[0].data, dtype=np.uint8).reshape(shown[0].height, shown[0].width, 3)
    assert 100 < np.any(drawn != driver.image.color, axis=2).sum() < drawn.size // 12
    driver.destroy_subscription(pictures)
    wait_until(lambda: driver.listeners == 0, "the detector to stop listening")
    detections = driver.create_subscription(ElectrodeDetection, "electrode_detection", received.append, 10)
    wait_until(lambda: len(received) > 1, "detections at a rate")
    driver.destroy_subscription(detections)
    wait_until(lambda: driver.listeners == 0, "the detector to stop listening without subscribers")
