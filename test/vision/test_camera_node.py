# SPDX-License-Identifier: Apache-2.0
"""camera_node on real topics: images of a camera that is plugged and unplugged, and of a recording; its errors."""

from __future__ import annotations

import dataclasses
import itertools
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_ros.node_support import StartupError
from deltacharger_vision.cameras.camera_info import from_camera_info
from deltacharger_vision.cameras.camera_node import CameraNode
from deltacharger_vision.cameras.keeper import CameraUnavailable
from deltacharger_vision.cameras.oak_pipeline import OakImage, OakSettings
from deltacharger_vision.cameras.ros_images import color_array, depth_array
from deltacharger_vision.images import Intrinsics, RgbdImage
from deltacharger_vision.ros.messages import camera_info_message, color_message, depth_message, stamp_ns

from ..chargers import DEADLINE, Spin, wait_until
from ..nodes import options

pytestmark = pytest.mark.ros

LENS = Intrinsics(64, 40, 44.0, 45.0, 31.0, 20.0, (-0.3, 0.1, 0.001, -0.002, 0.01))


def picture(number: int) -> RgbdImage:
    color = np.full((40, 64, 3), (number, 2 * number, 200), dtype=np.uint8)
    depth = np.full((40, 64), 0.3 + 1e-3 * number, dtype=np.float32)
    depth[0, 0] = np.nan
    return RgbdImage(color, depth, LENS)


class Camera:
    """An open camera that takes an image every 20 ms until unplugged."""

    def __init__(self, name: str, wanted: Callable[[], bool], take: Callable[[OakImage], None]) -> None:
        self.name, self.taken, self.refused, self._trouble = name, 0, 0, ""
        self._wanted, self._on_image = wanted, take
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(0.02):
            if self._trouble:
                continue
            if self._wanted():
                self.taken += 1
                self._on_image(OakImage(time.monotonic(), picture(self.taken % 100)))
            else:
                self.refused += 1

    def unplug(self) -> None:
        self._trouble = f"OAK camera {self.name} is gone"

    def problem(self) -> str:
        return self._trouble

    def close(self) -> None:
        self._stop.set()
        self._thread.join()


class Socket:
    """A port that may have a camera."""

    def __init__(self) -> None:
        self.plugged = ""
        self.opened: list[Camera] = []

    def open(self, settings: OakSettings, wanted: Callable[[], bool], take: Callable[[OakImage], None]) -> Camera:
        if not self.plugged:
            raise CameraUnavailable("no OAK camera found")
        self.opened.append(Camera(self.plugged, wanted, take))
        return self.opened[-1]


class Client(Node):
    """Subscribes to given topics and to diagnostics."""

    def __init__(self, context: Any, namespace: str) -> None:
        super().__init__("client", **options(context, namespace))
        self.color: list[Image] = []
        self.depth: list[Image] = []
        self.info: list[CameraInfo] = []
        self.statuses: list[DiagnosticStatus] = []
        self.create_subscription(DiagnosticArray, "/diagnostics", lambda each: self.statuses.extend(each.status), 10)

    def listen(self, *kinds: str) -> list[Any]:
        topics = {
            "color": (Image, "color/image_raw", self.color),
            "depth": (Image, "depth/image_raw", self.depth),
            "info": (CameraInfo, "color/camera_info", self.info),
        }
        return [
            self.create_subscription(kind, topic, into.append, qos_profile_sensor_data)
            for kind, topic, into in (topics[each] for each in kinds or topics)
        ]

    def wait_for_status(self, level: bytes, text: str) -> None:
        """Wait for a status with this text, since the list was cleared."""
        wait_until(lambda: any(each.level == level and text in each.message for each in list(self.statuses)), text)


@pytest.fixture
def client(context: Any, namespace: str, spin: Spin) -> Client:
    return spin(Client(context, namespace))


Start = Callable[..., CameraNode]


@pytest.fixture
def start(context: Any, namespace: str, spin: Spin) -> Start:
    return lambda camera=None, **values: spin(CameraNode(camera, **options(context, namespace, **values)))


def colors(messages: list[Image]) -> list[int]:
    return [int(each.data[0]) for each in list(messages)]


def depth_of(message: Image) -> int:
    """mm of the second pixel."""
    return int(message.data[2]) + 256 * int(message.data[3])


def test_camera_images_are_published_unchanged(start: Start, client: Client) -> None:
    socket = Socket()
    socket.plugged = "14442C10"
    client.listen()
    before = client.get_clock().now().nanoseconds
    start(socket.open)
    wait_until(lambda: len(client.color) > 5 and len(client.depth) > 5 and len(client.info) > 5, "images")
    after = client.get_clock().now().nanoseconds
    depths = {stamp_ns(each): each for each in list(client.depth)}
    infos = {stamp_ns(each): each for each in list(client.info)}
    complete = [each for each in list(client.color) if {stamp_ns(each)} <= depths.keys() & infos.keys()]
    assert complete
    for color in complete:
        stamp = stamp_ns(color)
        assert before <= stamp <= after
        depth, info = depths[stamp], infos[stamp]
        assert {each.header.frame_id for each in (color, depth, info)} == {"camera_color_optical_frame"}
        assert (color.encoding, depth.encoding) == ("rgb8", "16UC1")
        number = int(color.data[0])
        pixels = color_array(color)
        millimetres = depth_array(depth)
        np.testing.assert_array_equal(pixels, picture(number).color)
        assert (millimetres[0, 0], millimetres[1, 1]) == (0, 300 + number)
        assert from_camera_info(info.width, info.height, info.k, info.d, info.distortion_model) == LENS


def test_nothing_is_converted_without_subscribers(start: Start, client: Client) -> None:
    socket = Socket()
    socket.plugged = "14442C10"
    start(socket.open)
    client.wait_for_status(DiagnosticStatus.OK, "no subscribers")
    camera = socket.opened[0]
    wait_until(lambda: camera.refused > 5, "unwanted images")
    assert camera.taken == 0
    subscriptions = client.listen("depth")
    wait_until(lambda: client.depth, "depth")
    assert not client.color
    client.statuses.clear()
    client.wait_for_status(DiagnosticStatus.OK, "OK")
    for each in subscriptions:
        client.destroy_subscription(each)
    refused = camera.refused
    wait_until(lambda: camera.refused > refused + 5, "unwanted images")


def test_an_absent_or_unplugged_camera_is_reported_and_reconnected(start: Start, client: Client) -> None:
    socket = Socket()
    client.listen("color")
    node = start(socket.open, device_id="14442C10")
    client.wait_for_status(DiagnosticStatus.ERROR, "no OAK camera found")
    assert client.statuses[-1].hardware_id == "14442C10"
    socket.plugged = "14442C10"
    wait_until(lambda: client.color, "the first image")
    client.wait_for_status(DiagnosticStatus.OK, "OK")
    client.statuses.clear()
    socket.plugged = ""
    socket.opened[0].unplug()
    client.wait_for_status(DiagnosticStatus.ERROR, "OAK camera 14442C10 is gone")
    client.wait_for_status(DiagnosticStatus.ERROR, "no OAK camera found")
    client.color.clear()
    socket.plugged = "14442C10"
    wait_until(lambda: client.color, "the camera again")
    assert len(socket.opened) == 2
    node.close()
    taken = socket.opened[1].taken
    client.statuses.clear()
    client.wait_for_status(DiagnosticStatus.OK, "OK")
    assert socket.opened[1].taken == taken


def test_without_a_device_it_reports_the_error_and_keeps_running(start: Start, client: Client) -> None:
    depthai = pytest.importorskip("depthai", reason="drives an OAK-D with deltacharger[oak]")
    if depthai.Device.getAllAvailableDevices():
        pytest.skip("an OAK camera is connected")
    start()
    for _ in range(2):
        client.statuses.clear()
        client.wait_for_status(DiagnosticStatus.ERROR, "no OAK camera found: plug it in")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Five images 20 ms apart, depth 3 ms after colour, one camera_info in the middle, all under another namespace."""
    pytest.importorskip("mcap", reason="replays with deltacharger[record]")
    from deltacharger_records.recording.mcap_recording import McapWriter

    kinds = {"/old/color/image_raw": Image, "/old/depth/image_raw": Image, "/old/color/camera_info": CameraInfo}
    path = tmp_path / "rec.mcap"
    with McapWriter(path, kinds) as writer:
        for number in range(5):
            stamp = 10**9 + number * 20_000_000
            image, now = picture(number), rclpy.time.Time(nanoseconds=stamp).to_msg()
            later = rclpy.time.Time(nanoseconds=stamp + 3_000_000).to_msg()
            writer.add_message("/old/color/image_raw", color_message(image.color, now, "other"), stamp, stamp)
            writer.add_message("/old/depth/image_raw", depth_message(image.depth, later, "other"), stamp + 5, stamp)
            if number == 2:
                info = camera_info_message(LENS, now, "other")
                writer.add_message("/old/color/camera_info", info, stamp + 6, stamp)
    return path


def test_a_replay_keeps_pace_and_content_with_new_stamps(start: Start, client: Client, recording: Path) -> None:
    client.listen()
    before = client.get_clock().now().nanoseconds
    start(replay=str(recording), replay_loop=True)
    wait_until(lambda: {*range(5)} <= {*colors(client.color)}, "all images")
    wait_until(
        lambda: {*range(300, 305)} <= {int(each.data[2]) + 256 * int(each.data[3]) for each in client.depth}, "all"
    )
    wait_until(lambda: len(client.info) > 5, "intrinsics")
    messages, depths, infos = list(client.color), list(client.depth), list(client.info)
    after = client.get_clock().now().nanoseconds
    for each in messages:
        np.testing.assert_array_equal(color_array(each), picture(int(each.data[0])).color)
        assert each.header.frame_id == "camera_color_optical_frame"
        assert before < stamp_ns(each) < after + 10**9
    for one, two in itertools.pairwise(messages):
        number, following = int(one.data[0]), int(two.data[0])
        if following > number and stamp_ns(two) - stamp_ns(one) < 100_000_000:
            assert stamp_ns(two) - stamp_ns(one) == (following - number) * 20_000_000
    starts = {stamp_ns(each): int(each.data[0]) for each in messages}
    matched = [each for each in depths if stamp_ns(each) - 3_000_000 in starts]
    assert matched
    for depth in matched:
        assert depth_of(depth) == 300 + starts[stamp_ns(depth) - 3_000_000]
    assert {from_camera_info(each.width, each.height, each.k, each.d, each.distortion_model) for each in infos} == {
        LENS
    }
    assert {stamp_ns(each) for each in infos} & set(starts)


def test_a_replay_waits_for_a_subscriber_and_reports_its_end(start: Start, client: Client, recording: Path) -> None:
    start(replay=str(recording))
    client.wait_for_status(DiagnosticStatus.OK, "no subscribers")
    client.listen("color")
    client.wait_for_status(DiagnosticStatus.ERROR, "the recording has ended")
    assert client.statuses[-1].hardware_id == str(recording)
    assert colors(client.color) == sorted(set(colors(client.color)))


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"replay": "none.mcap"}, "none.mcap: there is no such file"),
        ({"replay": __file__}, "no MCAP file"),
        ({"replay": "empty"}, "holds no images"),
        ({"rate": 500.0}, "rate"),
        ({"width": 8}, "width"),
        ({"rate": 60.0, "exposure_us": 30_000}, "exposure_us"),
        ({"exposure": 5}, "did you mean 'exposure_us'"),
    ],
)
def test_wrong_parameters_stop_the_start(start: Start, tmp_path: Path, values: dict[str, Any], expected: str) -> None:
    if values.get("replay"):
        pytest.importorskip("mcap", reason="replays with deltacharger[record]")
        if values["replay"] == "empty":
            from deltacharger_records.recording.mcap_recording import McapWriter

            values = {"replay": str(tmp_path / "empty.mcap")}
            with McapWriter(Path(values["replay"]), {"/color/image_raw": Image}):
                pass
    with pytest.raises(StartupError, match=expected):
        start(Socket().open, **values)


def test_the_executable_takes_a_recording_and_ros_arguments() -> None:
    pytest.importorskip("mcap", reason="replays with deltacharger[record]")
    words = [sys.executable, "-m", "deltacharger_vision.cameras.camera_node"]
    for more, expected in (
        (["--replay", "none.mcap", "--ros-args", "-r", "__ns:=/a"], "none.mcap: there is no such file"),
        (["--ros-args", "-p", "replay:=other.mcap"], "other.mcap: there is no such file"),
        (["--reply", "none.mcap"], "unrecognized arguments"),
        (["--ros-args", "-p", "rate"], "ROS refuses"),
    ):
        ended = subprocess.run([*words, *more], capture_output=True, text=True, timeout=DEADLINE, check=False)
        assert (ended.returncode, expected in ended.stderr) == (2, True), ended


def test_every_setting_is_a_parameter(start: Start) -> None:
    node = start(Socket().open, width=320, rate=30.0)
    for item in dataclasses.fields(OakSettings):
        wanted = {"width": 320, "rate": 30.0}.get(item.name, item.default)
        assert node.get_parameter(item.name).value == wanted
