# SPDX-License-Identifier: Apache-2.0
"""Poses of charger_base in tf frames are exact or refused by name."""

import math
import random
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node

from deltacharger_core.frames import IDENTITY, Pose, TransformParameters, apart, composed
from deltacharger_core.ros import frames as frames_module
from deltacharger_core.ros.frames import Contradiction, Frames, TransformError, UnknownFrame
from deltacharger_docking.parameters import DockingNodeParameters
from deltacharger_docking.ros.messages import electrodes

from ..chargers import DEADLINE, Spin, wait_until
from ..core.test_rotation import drawn
from ..nodes import options
from ..transforms import Robot, stamp
from ..waiting import host

pytestmark = pytest.mark.ros

USUAL = DockingNodeParameters().base_pose
MOUNT: Pose = (0.31, -0.02, 0.42, 0.5, 0.5, 0.5, 0.5)
EXACT = 1e-9
PATIENCE = 10.0  # s, the longest transform_timeout
Make = Callable[..., Frames]


def stamped(pose: Pose, frame: str) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = frame
    place, turn = message.pose.position, message.pose.orientation
    place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = pose
    return message


@pytest.fixture
def robot(context: Any, spin: Spin) -> Robot:
    return spin(Robot(context))  # type: ignore[no-any-return]


@pytest.fixture
def make(context: Any, namespace: str, robot: Robot) -> Iterator[Make]:
    """Create the frames of a node that receives the robot's tf, where the charger is mounted."""
    nodes: list[Node] = []

    def frames(
        prefix: str = "",
        timeout: float = 0.1,
        base_pose: Pose | None = None,
        mounted: bool = True,
        **given: Any,
    ) -> Frames:
        parameters = {} if base_pose is None else {"base_pose": list(base_pose)}
        nodes.append(Node(f"asker_{len(nodes)}", **options(context, namespace, **parameters)))
        transform = TransformParameters(prefix, transform_timeout=timeout, **given)
        found = Frames(nodes[-1], transform, "base_link", base_pose or USUAL)
        wait_until(lambda: robot.heard, "a subscription to tf")
        if mounted:
            robot.fix("base_link", "charger_base", MOUNT)
        return found

    yield frames
    for node in nodes:
        node.destroy_node()


def close(a: Pose, b: Pose) -> bool:
    return max(apart(a, b)) < EXACT


def await_frames(frames: Frames, *names: str) -> None:
    """Wait until tf knows frames."""
    assert frames._tf is not None
    wait_until(lambda: frames._tf is not None and frames._tf.knows(*names), f"{names} in tf")


def await_pose(frames: Frames, frame: str, pose: Pose = MOUNT) -> None:
    """Wait until charger_base has this pose in a frame."""

    def has() -> bool:
        try:
            return close(frames.charger_base_in(frame, timeout=0.0), pose)
        except TransformError:
            return False

    wait_until(has, f"charger_base in {frame}")


@contextmanager
def asking(frames: Frames, frame: str) -> Iterator[list[Any]]:
    """Ask in another thread until the end of the block; the list gets the pose or the error."""
    found: list[Any] = []

    def ask() -> None:
        try:
            found.append(frames.charger_base_in(frame))
        except TransformError as error:
            found.append(error)

    asker = threading.Thread(target=ask)
    asker.start()
    wait_until(lambda: frames._tf is not None and frames._tf._waits.locked(), "it to wait")
    yield found
    asker.join(DEADLINE)


def test_without_tf2_ros_parameters_are_used_and_other_frames_refused_by_name(
    context: Any, namespace: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frames_module, "installed", lambda: False)
    node = Node("asker", **options(context, namespace))
    frames = Frames(node, TransformParameters("left/"), "torso", MOUNT)
    assert frames.charger_base_in("torso") == MOUNT
    assert frames.charger_base_in("left/charger_base") == IDENTITY
    with pytest.raises(UnknownFrame, match="tf2_ros, which is not installed"):
        frames.charger_base_in("map")
    assert "/tf" not in {each.topic_name for each in node.subscriptions}
    node.destroy_node()


@pytest.mark.version
def test_a_goal_in_map_is_the_same_goal_in_charger_base(robot: Robot, make: Make) -> None:
    frames, source = make(), random.Random(23)
    target: Pose = (0.004, -0.01, 0.08, 0.0, math.sin(0.02), 0.0, math.cos(0.02))
    expected = electrodes(stamped(target, "charger_base"))
    assert expected is not None
    for number in range(5):
        place, odom = drawn(source), drawn(source)
        robot.move(("map", f"odom_{number}", odom), (f"odom_{number}", "base_link", place))
        await_frames(frames, f"odom_{number}")
        in_map = stamped(composed(composed(composed(odom, place), MOUNT), target), "map")
        found = electrodes(in_map, frames.charger_base_in("map"))
        assert found is not None
        assert (*found.position, found.roll, found.yaw, found.pitch) == pytest.approx(
            (*expected.position, expected.roll, expected.yaw, expected.pitch), abs=EXACT
        )


def test_only_one_goal_waits_so_that_unknown_frames_block_no_other(robot: Robot, make: Make) -> None:
    frames = make(timeout=PATIENCE)
    await_frames(frames, "charger_base")
    assert frames._tf is not None
    began = time.monotonic()
    with frames._tf._waits, pytest.raises(UnknownFrame):  # another one waits
        frames.charger_base_in("nowhere")
    assert time.monotonic() - began < host(1.0)


def test_an_unknown_frame_is_refused_with_its_name_and_those_known(robot: Robot, make: Make) -> None:
    frames = make()
    robot.fix("map", "odom", IDENTITY)
    await_frames(frames, "map", "charger_base")
    with pytest.raises(UnknownFrame, match=r"unknown frame 'mapp'.*charger_base"):
        frames.charger_base_in("mapp")
    with pytest.raises(UnknownFrame, match=r"'odom'.*the same tree"):
        frames.charger_base_in("odom")
    for endless in ("map" * 10_000, "map\n", "/map"):
        with pytest.raises(UnknownFrame) as refusal:
            frames.charger_base_in(endless)
        assert len(str(refusal.value)) < 1000
        assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(("age", "words"), [(5.0, "5.. s old"), (-5.0, "s in the future")])
def test_the_error_names_a_transform_of_another_time(robot: Robot, make: Make, age: float, words: str) -> None:
    frames = make()
    robot.move(("map", "base_link", IDENTITY), when=time.time() - age)
    await_frames(frames, "map", "charger_base")
    with pytest.raises(TransformError, match=f"'charger_base' .*'map' .*{words}.*transform_age_max") as refusal:
        frames.charger_base_in("map")
    assert not isinstance(refusal.value, UnknownFrame), "it may come back"
    robot.move(("map", "base_link", IDENTITY))
    await_pose(frames, "map")


def test_a_stamp_matters_only_if_a_transform_moves(robot: Robot, make: Make) -> None:
    frames = make(transform_age_max=20.0)
    robot.fix("tool", "base_link", IDENTITY)
    now = time.time()
    for age in (0.6, 0.4, 0.0):
        robot.move(("map", "tool", (age, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)), when=now - age)
    await_pose(frames, "map")
    between = frames.charger_base_in("map", stamp(now - 0.5))
    assert between[0] == pytest.approx(0.5 + MOUNT[0], abs=1e-6)
    assert close(frames.charger_base_in("tool", stamp(now - 3600.0)), MOUNT)
    for age in (30.0, -30.0, 0.9):
        with pytest.raises(TransformError, match="stamp 0"):
            frames.charger_base_in("map", stamp(now - age))


def test_the_default_is_not_used_while_tf_may_still_arrive(robot: Robot, make: Make) -> None:
    """Not even by a second caller that does not wait; a retry is allowed."""
    frames = make(timeout=PATIENCE, mounted=False)
    with asking(frames, "base_link") as found:
        with pytest.raises(TransformError, match="just started") as refusal:
            frames.charger_base_in("base_link")
        assert not isinstance(refusal.value, UnknownFrame)
        robot.fix("base_link", "charger_base", MOUNT)
    assert close(found[0], MOUNT)


def test_after_its_clock_went_back_only_static_transforms_stay(robot: Robot, make: Make) -> None:
    frames = make()
    robot.move(("map", "base_link", IDENTITY))
    await_pose(frames, "map")
    assert frames._tf is not None
    frames._tf._last += 2 * 10**9
    with pytest.raises(TransformError):
        frames.charger_base_in("map")
    assert close(frames.charger_base_in("base_link"), MOUNT)


def test_a_base_pose_that_contradicts_tf_is_an_error_but_rounding_is_not(robot: Robot, make: Make) -> None:
    rounded = make(base_pose=(0.3105, -0.0201, 0.4195, 0.502, 0.498, 0.5, 0.5))
    await_pose(rounded, "base_link")
    frames = make(base_pose=(0.31, -0.02, 0.52, 0.5, 0.5, 0.5, 0.5))
    robot.move(("map", "base_link", IDENTITY))
    await_frames(frames, "map", "charger_base")
    for frame in ("base_link", "map"):
        with pytest.raises(Contradiction, match=r"0\.31 -0\.02 0\.52 .*0\.31 -0\.02 0\.42 "):
            frames.charger_base_in(frame)
    assert frames.charger_base_in("charger_base") == IDENTITY
