# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate camera --take N` with a running charger of mocks and the simulated camera."""

from __future__ import annotations

import json
import math
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_bringup.calibrate.camera_client import CameraClient, CameraError
from deltacharger_bringup.calibrate.camera_views import ViewsFolder, read_rows
from deltacharger_bringup.cli.output import CommandError
from deltacharger_bringup.cli.take_views import _visit
from deltacharger_kinematics.geometry import Vector
from deltacharger_ros import qos
from deltacharger_ros.executor import Spinner
from deltacharger_vision.errors import CameraInfoError
from deltacharger_vision.hand_eye.board import AprilTag
from deltacharger_vision.mount import Mount
from deltacharger_vision.rendering.board_drawing import bracket
from deltacharger_vision.rendering.camera import OAK_D
from deltacharger_vision.ros.messages import camera_info_message, color_message

from ..chargers import DEADLINE, Process, wait_until
from ..nodes import options
from ..vision.hand_eye_rig import ARM, Rig, squared
from .running import Charger, running

pytestmark = pytest.mark.ros

pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

SCENE = """
nodes: [mock_servo_node, mock_tactile_node, mock_detector_node, kinematics_node, misalignment_node, docking_node,
        simulated_camera_node]
parameters:
  mock_servo_node: {damping: 0.3}
  docking_node: {servo_damping: 0.3, servo_age_max: 1.0, tactile_age_max: 1.0, power_age_max: 1.0}
  simulated_camera_node: {board: "apriltag:36h11:0", rate: 8.0}
"""


@pytest.fixture(scope="module")
def charger(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Charger]:
    scene = tmp_path_factory.mktemp("scene") / "board.yaml"
    scene.write_text(SCENE, encoding="utf-8")
    with running(scene) as charger:
        yield charger


@pytest.fixture
def taking(charger: Charger, start: Callable[..., Process]) -> Iterator[Callable[..., Process]]:
    place = bracket()[:3, 3]
    offset = [word for axis, v in zip("xyz", place, strict=True) for word in (f"--board-{axis}-mm", f"{1e3 * v:.3f}")]
    command = (sys.executable, "-m", "deltacharger_bringup.cli", "calibrate", "camera", "--namespace")

    def begin(*words: object) -> Process:
        return start(*command, charger.namespace, *offset, "--z-max-mm", "35", "--json", *map(str, words))

    yield begin
    wait_until(lambda: not charger.torque(), "torque off")


def test_an_interrupted_command_leaves_the_arm_safe_and_keeps_its_views(
    taking: Callable[..., Process], charger: Charger, tmp_path: Path
) -> None:
    folder = tmp_path / "views"
    command = taking("--views", folder, "--take", 5)
    command.wait_for_line("view_001.png", command.err)
    assert charger.torque()
    assert command.end(signal.SIGINT) == 130, command.err
    result = json.loads(command.out[0])
    assert result["success"] is False
    assert 1 <= result["views"] < 5
    assert f"{folder} contains {result['views']} views" in result["error"]
    wait_until(lambda: not charger.torque(), "torque off")
    assert len(read_rows(folder)) == result["views"]


def test_a_partly_filled_folder_is_completed_and_solved(
    taking: Callable[..., Process], charger: Charger, tmp_path: Path
) -> None:
    rig = Rig(1, joints=0.0, offset=0.0)
    rig.mount, rig.place = Mount.default().pose, bracket()  # as in the scene
    folder, out = rig.write(tmp_path / "views", 4), tmp_path / "mount.yaml"
    command = taking("--views", folder, "--take", 6, "--out", out)
    assert command.end() == 0, command.err
    assert any("contains 4 views already" in line for line in command.err)
    found = json.loads(command.out[0])
    assert found["views"] == 6
    assert found["held_out"]["rms"] < 0.001
    places = np.array([ARM.forward(*row.angles) for row in read_rows(folder) if row.angles is not None])
    assert len(places) == 6
    assert all(math.dist(a, b) > 0.005 for n, a in enumerate(places) for b in places[:n])
    mount = Mount.load(out)
    assert squared(rig.error(mount), mount.covariance) < 25.0
    assert np.linalg.norm(rig.dock_error(mount)) < 0.002


def test_no_charger_or_no_camera_ends_with_1(taking: Callable[..., Process], charger: Charger, tmp_path: Path) -> None:
    absent = taking("--views", tmp_path / "a", "--take", 5, "--namespace", "nobody_here")
    blind = taking("--views", tmp_path / "b", "--take", 5, "--color-topic", "other/image_raw")
    assert absent.end() == 1
    assert any("deltacharger up" in line for line in absent.err)
    elsewhere = taking("--views", tmp_path / "c", "--take", 5, "--board-x-mm", 400)
    assert blind.end() == 1
    assert elsewhere.end() == 1
    assert any("sees the board at no new position" in line for line in elsewhere.err)
    assert any("other/camera_info" in line for line in blind.err)
    assert not charger.torque()
    assert not (tmp_path / "b").exists()


class _Arm:
    """An arm that reaches each goal at once; if `restless`, it moves during every third image."""

    def __init__(self, restless: bool = False) -> None:
        self.angle: Vector = (0.0, 0.0, 0.0)
        self._asked, self._restless = 0, restless
        self.home = False

    def start(self) -> None:
        pass

    def check(self) -> None:
        pass

    def move(self, goal: Vector) -> None:
        self.angle = ARM.inverse(*goal)

    def angles(self) -> Vector:
        self._asked += 1
        moved = 0.02 if self._restless and self._asked % 6 == 0 else 0.0
        return self.angle[0] + moved, self.angle[1], self.angle[2]

    def go_home(self) -> None:
        self.home = True


class _Camera:
    def __init__(self, rig: Rig, arm: _Arm, board: AprilTag) -> None:
        self._rig, self._arm, self._board = rig, arm, board

    def image(self, timeout: float, check: Callable[[], None]) -> np.ndarray:
        return self._rig.image(self._arm.angle, self._board)


def visited(rig: Rig, arm: _Arm, shown: AprilTag, folder: ViewsFolder, wanted: int) -> None:
    arguments: Any = (arm, _Camera(rig, arm, shown))
    _visit(*arguments, rig.board, (place for place, _ in rig.stands()), folder, wanted)


def test_an_image_during_which_the_arm_moved_is_not_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, arm = Rig(1), _Arm(restless=True)
    folder = ViewsFolder(tmp_path / "views", OAK_D)
    visited(rig, arm, AprilTag(), folder, 5)
    assert len(folder.angles) == 5
    assert capsys.readouterr().err.count("the arm moved while") == 2
    assert arm.home


def test_a_board_that_is_never_visible_ends_it_early_with_the_visible_markers(tmp_path: Path) -> None:
    rig, arm = Rig(1), _Arm()
    folder = ViewsFolder(tmp_path / "views", OAK_D)
    with pytest.raises(CommandError, match="no image of 6 positions shows apriltag:36h11:0; it shows apriltag 36h11 4"):
        visited(rig, arm, AprilTag(tag=4), folder, 20)
    assert not folder.angles


class Driver:
    """A camera whose images the test publishes, with given stamps (s relative to now)."""

    def __init__(self, context: Any, namespace: str) -> None:
        node = Node("driver", **options(context, namespace))
        self._image = node.create_publisher(Image, "color/image_raw", qos.SENSOR)
        self._info = node.create_publisher(CameraInfo, "color/camera_info", qos.SENSOR)
        self._clock = node.get_clock()
        self.spinner = Spinner(node)

    def stamp(self, late: float) -> Any:
        return Time(nanoseconds=self._clock.now().nanoseconds + round(1e9 * late)).to_msg()

    def info(self, **changes: Any) -> None:
        message = camera_info_message(OAK_D, self.stamp(0.0))
        for name, value in changes.items():
            setattr(message, name, value)
        self._info.publish(message)

    def image(self, value: int, stamp: Any) -> None:
        self._image.publish(color_message(np.full((400, 640, 3), value, dtype=np.uint8), stamp))


@pytest.fixture
def driver(context: Any, namespace: str) -> Iterator[Driver]:
    found = Driver(context, namespace)
    yield found
    found.spinner.close()


@pytest.fixture
def client(context: Any, namespace: str, driver: Driver) -> Iterator[CameraClient]:
    with CameraClient(context, "color/image_raw", namespace) as found:
        yield found


def test_an_image_from_before_the_request_is_not_used(client: CameraClient, driver: Driver) -> None:
    def publish() -> None:
        driver.image(1, driver.stamp(-2.0))  # taken before the arm stopped
        driver.image(2, driver.stamp(0.05))

    assert client.image(DEADLINE, publish)[0, 0, 0] == 2


def test_with_another_camera_clock_the_arrival_time_counts(client: CameraClient, driver: Driver) -> None:
    image = client.image(DEADLINE, lambda: driver.image(3, Time(seconds=5).to_msg()))
    assert image.shape == (400, 640, 3)
    assert (image == 3).all()


def test_intrinsics_come_from_camera_info(client: CameraClient, driver: Driver) -> None:
    assert client.intrinsics(DEADLINE, driver.info) == OAK_D


def test_binned_images_and_silence_are_refused(client: CameraClient, driver: Driver) -> None:
    with pytest.raises(CameraError, match="no image received on color/image_raw"):
        client.image(0.05, lambda: None)
    with pytest.raises(CameraError, match="no color/camera_info received"):
        client.intrinsics(0.05, lambda: None)
    with pytest.raises(CameraInfoError, match="binning"):
        client.intrinsics(DEADLINE, lambda: driver.info(binning_x=2))
