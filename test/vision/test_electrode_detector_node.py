# SPDX-License-Identifier: Apache-2.0
"""electrode_detector_node on real topics: answers, times of detection, and errors without images."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from deltacharger.msg import ElectrodeDetection
from deltacharger.srv import DetectElectrodes
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from deltacharger_core.rotation import rotation
from deltacharger_ros.executor import Spinner
from deltacharger_ros.node_support import StartupError
from deltacharger_sim.charger.simulated_camera_node import SimulatedCameraNode
from deltacharger_vision.mount import Mount, quaternion

from ..chargers import DEADLINE, Spin, wait_until
from ..nodes import options
from ..scenes.camera_driver import TARGET, Driver, picture
from ..transforms import Robot, transforms
from .detector_scenes import without_depth

pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

from deltacharger_vision.detector.electrode_detector_node import ElectrodeDetectorNode

pytestmark = pytest.mark.ros


@pytest.fixture
def driver(context: Any, namespace: str, spin: Spin) -> Driver:
    return spin(Driver(context, namespace))


@pytest.fixture
def detector(context: Any, namespace: str, driver: Driver, spin: Spin) -> Callable[..., ElectrodeDetectorNode]:
    def start(**values: Any) -> ElectrodeDetectorNode:
        node = spin(ElectrodeDetectorNode(**options(context, namespace, **values)))
        assert driver.client.wait_for_service(DEADLINE)
        return node

    return start


def test_electrodes_are_reported_in_charger_base_with_a_valid_covariance(
    detector: Callable[..., ElectrodeDetectorNode], driver: Driver
) -> None:
    detector()
    answer = driver.ask(5.0)
    assert answer.success, answer.message
    found = answer.detection
    place = found.pose.pose.position
    off = np.subtract((place.x, place.y, place.z), TARGET[:3])
    covariance = np.reshape(found.pose.covariance, (6, 6))
    assert np.linalg.norm(off) < 0.001
    assert off @ np.linalg.solve(covariance[:3, :3], off) < 9.0
    assert covariance[5, 5] == pytest.approx(math.radians(0.5) ** 2, rel=0.2)  # the mount's error dominates
    assert found.roll == pytest.approx(TARGET[3], abs=0.005)
    turn = found.pose.pose.orientation
    axes = np.array(rotation(turn.x, turn.y, turn.z, turn.w))
    assert math.atan2(axes[1, 0], axes[0, 0]) == pytest.approx(found.roll)
    assert axes[:2, 2] == pytest.approx(0.0, abs=0.01), "the target stands straight before the charger"
    assert np.sqrt(np.diag(covariance)[3:5]) == pytest.approx(math.radians(0.5), rel=0.2)
    assert found.header.frame_id == "charger_base"
    assert 0.2 < found.range < 0.3
    assert 0.5 < found.confidence <= 1.0


def test_the_camera_pose_can_come_from_tf(
    detector: Callable[..., ElectrodeDetectorNode], driver: Driver, context: Any, spin: Spin
) -> None:
    robot = spin(Robot(context))
    driver.silent = True
    node = detector(mount_from_tf=True, frame_prefix="left/", transform_timeout=10.0)
    usual = Mount.default().pose
    moved = (*(usual[:3, 3] + (0.0, 0.0, 0.1)), *quaternion(usual[:3, :3]))
    robot.fix("left/charger_base", "camera", moved)
    image = Header(frame_id="camera", stamp=node.get_clock().now().to_msg())
    np.testing.assert_allclose(node._mounted(image).pose[:3], np.c_[usual[:3, :3], moved[:3]], atol=1e-9)


@pytest.mark.parametrize("timeout", [0.2, 10.0])
def test_a_request_ends_in_time_if_detection_is_slower_than_the_camera(
    detector: Callable[..., ElectrodeDetectorNode], driver: Driver, timeout: float
) -> None:
    transforms()
    detector(mount_from_tf=True, transform_timeout=timeout)
    began = time.monotonic()
    answer = driver.ask(1.0)
    assert time.monotonic() - began < 5.0
    assert not answer.success
    assert "camera's pose is unknown: tf does not know the frame" in answer.message


def test_two_sources_of_the_camera_pose_are_refused(context: Any, namespace: str, tmp_path: Path) -> None:
    with pytest.raises(StartupError, match="mount_from_tf and mount_file both"):
        ElectrodeDetectorNode(**options(context, namespace, mount_from_tf=True, mount_file=str(tmp_path / "m.yaml")))


def test_without_expected_depth_no_normal_is_published(
    detector: Callable[..., ElectrodeDetectorNode], driver: Driver
) -> None:
    driver.image = without_depth(driver.image)
    detector()
    found = driver.ask(5.0).detection
    turn, covariance = found.pose.pose.orientation, np.reshape(found.pose.covariance, (6, 6))
    assert (turn.x, turn.y) == pytest.approx((0.0, 0.0))
    assert 2.0 * math.atan2(turn.z, turn.w) == pytest.approx(found.roll)
    unknown = np.isnan(covariance)
    assert unknown[3:5].all()
    assert unknown[:, 3:5].all()
    assert unknown.sum() == 20, "position and roll have their errors"


def test_it_subscribes_only_while_it_detects(detector: Callable[..., ElectrodeDetectorNode], driver: Driver) -> None:
    detector()
    assert driver.listeners == 0
    assert driver.ask(5.0).success
    wait_until(lambda: driver.listeners == 0, "the detector to stop listening")


def test_a_simulated_camera_renders_nothing_without_subscribers(
    context: Any, namespace: str, detector: Callable[..., ElectrodeDetectorNode], driver: Driver, spin: Spin
) -> None:
    driver.silent = True
    for publisher in (driver.color, driver.depth, driver.info):
        driver.destroy_publisher(publisher)
    detector()
    target = dict(zip(("target_x", "target_y", "target_z", "target_roll"), TARGET, strict=True))
    camera = spin(SimulatedCameraNode(**options(context, namespace, rate=60.0, **target)))
    assert driver.ask(10.0).success
    wait_until(lambda: camera.count_subscribers("color/image_raw") == 0, "the detector to stop listening")
    rendered = camera.rendered
    assert rendered >= 1
    looks = camera.looks
    wait_until(lambda: camera.looks > looks + 5, "the camera to look for subscribers")
    assert camera.rendered <= rendered + 1  # the pending image when the last subscriber left


def test_an_empty_scene_is_reported_after_the_timeout(
    detector: Callable[..., ElectrodeDetectorNode], driver: Driver
) -> None:
    driver.image = picture(target=False)
    detector()
    answer = driver.ask(1.0)
    assert not answer.success
    assert "no electrodes in the image" in answer.message
    assert "images in 1.0 s" in answer.message
    assert math.isnan(answer.detection.pose.pose.position.z)
    assert math.isnan(answer.detection.roll)


def test_without_a_camera_it_names_the_topics_and_diagnoses_them(
    detector: Callable[..., ElectrodeDetectorNode], driver: Driver, namespace: str
) -> None:
    driver.silent = True
    for publisher in (driver.color, driver.depth, driver.info):
        driver.destroy_publisher(publisher)
    detector()
    answer = driver.ask(0.3)
    assert not answer.success
    for topic in ("color/image_raw", "depth/image_raw", "color/camera_info"):
        assert f"/{namespace}/{topic}" in answer.message
    assert "start camera_node" in answer.message
    wait_until(lambda: any(each.level == DiagnosticStatus.WARN for each in driver.said), "a warning while idle")


def test_missing_images_are_an_error_that_names_the_camera(
    detector: Callable[..., ElectrodeDetectorNode], driver: Driver, namespace: str
) -> None:
    detector(rate=20.0)
    received: list[ElectrodeDetection] = []
    driver.create_subscription(ElectrodeDetection, "electrode_detection", received.append, 10)
    wait_until(lambda: len(received) > 2, "detections at a rate")
    driver.silent = True
    wait_until(lambda: driver.said and driver.said[-1].level == DiagnosticStatus.ERROR, "an error once images stopped")
    assert f"/{namespace}/color/image_raw" in driver.said[-1].message
    assert "cable" in driver.said[-1].message
    assert driver.said[-1].hardware_id == f"/{namespace}/color/image_raw"
    driver.silent = False
    count = len(received)
    wait_until(lambda: len(received) > count, "detections once images came back")
    wait_until(lambda: driver.said[-1].level == DiagnosticStatus.OK, "the error to end")


def test_at_a_rate_it_detects_only_with_subscribers(
    detector: Callable[..., ElectrodeDetectorNode], driver: Driver
) -> None:
    detector(rate=20.0)
    received: list[ElectrodeDetection] = []
    subscription = driver.create_subscription(ElectrodeDetection, "electrode_detection", received.append, 10)
    wait_until(lambda: received, "a detection")
    driver.destroy_subscription(subscription)
    wait_until(lambda: driver.listeners == 0, "the detector to stop listening")


def test_rate_and_limits_change_while_the_node_runs(
    detector: Callable[..., ElectrodeDetectorNode], driver: Driver
) -> None:
    node, received = detector(), []
    driver.create_subscription(ElectrodeDetection, "electrode_detection", received.append, 10)

    def put(**values: float) -> bool:
        given = [Parameter(name, value=value) for name, value in values.items()]
        return bool(node.set_parameters_atomically(given).successful)

    assert put(rate=20.0)
    wait_until(lambda: len(received) > 1, "detections at a rate")
    assert put(rate=0.0)
    wait_until(lambda: driver.listeners == 0, "the detector to stop listening")
    driver.age = 3.0
    assert put(timeout=0.3)
    assert "in 0.3 s" in driver.ask(0.0).message
    assert put(image_age_max=10.0)
    assert driver.ask(5.0).success
    assert not put(image_age_max=5.0, stamp_tolerance=0.5), "the camera keeps what it was made with"
    assert node.get_parameter("image_age_max").value == 10.0


def test_annotated_images_are_published_to_subscribers(
    detector: Callable[..., ElectrodeDetectorNode], driver: Driver
) -> None:
    detector()
    shown: list[Image] = []
    driver.create_subscription(Image, "electrode_detection/image", shown.append, qos_profile_sensor_data)

    def seen() -> bool:
        assert driver.ask(5.0).success
        return bool(shown)

    wait_until(seen, "an annotated image")
    drawn = np.frombuffer(shown[0].data, dtype=np.uint8).reshape(shown[0].height, shown[0].width, 3)
    changed = np.any(drawn != driver.image.color, axis=2)
    assert 100 < changed.sum() < changed.size // 4


@pytest.mark.parametrize(("age", "words"), [(3.0, "3."), (-3.0, "in the future")])
def test_an_old_or_future_stamp_is_refused(
    detector: Callable[..., ElectrodeDetectorNode], driver: Driver, age: float, words: str
) -> None:
    driver.age = age
    detector()
    answer = driver.ask(1.5)
    assert not answer.success
    assert words in answer.message
    assert "clocks" in answer.message


def test_late_images_do_not_hide_the_result_of_others(
    detector: Callable[..., ElectrodeDetectorNode], driver: Driver
) -> None:
    driver.image = picture(target=False)
    sent = 0

    def make_late(*messages: Image | CameraInfo) -> None:
        nonlocal sent
        sent += driver.listeners > 0
        for message in messages:
            message.header.stamp.sec -= 3 if sent > 5 else 0

    driver.spoil = make_late
    detector()
    answer = driver.ask(1.5)
    assert "no electrodes in the image" in answer.message
    assert " 0 of them too old" not in answer.message


def test_depth_of_another_time_is_not_used(detector: Callable[..., ElectrodeDetectorNode], driver: Driver) -> None:
    driver.apart = 0.024  # half a period: no nearer stamp ever arrives
    detector()
    answer = driver.ask(2.5)
    assert not answer.success
    assert "stamp_tolerance" in answer.message


def test_faults_of_a_driver_are_reported(detector: Callable[..., ElectrodeDetectorNode], driver: Driver) -> None:
    def halve_depth(color: Image, depth: Image, info: CameraInfo) -> None:
        depth.height //= 2
        depth.data = depth.data[: depth.height * depth.step]

    driver.spoil = halve_depth
    detector()
    answer = driver.ask(1.0)
    assert not answer.success
    assert "aligned to the colour" in answer.message


def test_a_negative_timeout_is_refused(detector: Callable[..., ElectrodeDetectorNode], driver: Driver) -> None:
    detector()
    assert "timeout" in driver.ask(-1.0).message


def test_closing_releases_waiting_requests(context: Any, namespace: str, driver: Driver) -> None:
    driver.silent = True
    spinner = Spinner(ElectrodeDetectorNode(**options(context, namespace)))
    assert driver.client.wait_for_service(DEADLINE)
    driver.client.call_async(DetectElectrodes.Request(timeout=Duration(sec=600)))
    wait_until(lambda: driver.listeners == 3, "the detector to listen")
    started = time.monotonic()
    spinner.close()
    assert time.monotonic() - started < 30.0


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"mount_file": "/nowhere/mount.yaml"}, "mount.yaml"),
        ({"mount": [0.0, 0.1]}, "has 2 numbers; give 7"),
        ({"mount": [0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0]}, "length"),
        ({"bar_length": 70.0}, "bar_length"),
        ({"rate": -1.0}, "rate"),
        ({"mount_flie": "x"}, "did you mean 'mount_file'"),
    ],
)
def test_wrong_parameters_stop_the_start(context: Any, namespace: str, values: dict[str, Any], words: str) -> None:
    with pytest.raises(StartupError, match=words):
        ElectrodeDetectorNode(**options(context, namespace, **values))


def test_a_mount_file_replaces_the_mount(
    detector: Callable[..., ElectrodeDetectorNode], driver: Driver, tmp_path: Path
) -> None:
    moved = Mount.default().pose.copy()
    moved[:3, 3] += (0.01, 0.0, 0.02)
    Mount(moved, 1e-10 * np.eye(6)).save(tmp_path / "mount.yaml")
    detector(mount_file=str(tmp_path / "mount.yaml"))
    answer = driver.ask(5.0)
    assert answer.success, answer.message
    place = answer.detection.pose.pose.position
    assert (place.x, place.y, place.z) == pytest.approx((TARGET[0] + 0.01, TARGET[1], TARGET[2] + 0.02), abs=5e-4)
    assert answer.detection.pose.covariance[0] < 1e-6
