# SPDX-License-Identifier: Apache-2.0
"""kinematics_node: pose and force from servo_state, and kinematics with a status per point."""

from __future__ import annotations

import math
import sys
from array import array
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from deltacharger.msg import ServoState
from deltacharger.srv import SolveForwardKinematics, SolveInverseKinematics
from geometry_msgs.msg import PoseStamped, Quaternion, Vector3, WrenchStamped
from rclpy.node import Node
from std_msgs.msg import Header

from deltacharger_core.machine import GRAVITY, TORQUE_CONSTANT
from deltacharger_docking.ros.docking_node import DockingNode
from deltacharger_kinematics import Delta, Status, kinematics_node
from deltacharger_kinematics.geometry_file import load_geometry
from deltacharger_kinematics.kinematics_node import KinematicsNode
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_ros import qos
from deltacharger_ros.executor import Spinner
from deltacharger_ros.node_support import StartupError

from ..chargers import Process, new_namespace, wait_until
from ..nodes import call, options

pytestmark = pytest.mark.ros

DELTA = ScalarDelta()


class Bench:
    """The node under test with a client node."""

    def __init__(self, context: Any, **parameters: Any) -> None:
        namespace = new_namespace()
        self.asker = Node("asker", **options(context, namespace))
        self.state = self.asker.create_publisher(ServoState, "servo_state", qos.LATEST)
        self.inverse = self.asker.create_client(SolveInverseKinematics, "solve_inverse_kinematics")
        self.forward = self.asker.create_client(SolveForwardKinematics, "solve_forward_kinematics")
        self.poses: list[PoseStamped] = []
        self.wrenches: list[WrenchStamped] = []
        self.asker.create_subscription(PoseStamped, "end_effector_pose", self.poses.append, 10)
        self.asker.create_subscription(WrenchStamped, "contact_wrench", self.wrenches.append, 10)
        self.spinners = [Spinner(KinematicsNode(**options(context, namespace, **parameters))), Spinner(self.asker)]
        wait_until(self.ready, "kinematics_node")

    def ready(self) -> bool:
        node = self.spinners[0].node
        listening = all(publisher.get_subscription_count() for publisher in (node._pose, node._wrench))
        served = self.inverse.service_is_ready() and self.forward.service_is_ready()
        return served and listening and self.state.get_subscription_count() == 1

    def close(self) -> None:
        for spinner in self.spinners:
            spinner.close()


@pytest.fixture(scope="module")
def bench(context: Any) -> Iterator[Bench]:
    bench = Bench(context)
    yield bench
    bench.close()


def test_forward_inverts_inverse_and_a_bad_point_does_not_affect_others(bench: Bench) -> None:
    points = [0.0, 0.0, 0.08, 0.03, -0.02, 0.05, 9.0, 0.0, 0.0, math.nan, 0.0, 0.0]
    solved = call(bench.inverse, SolveInverseKinematics.Request(positions=points))
    assert list(solved.status[:2]) == [0, 0]
    assert solved.status[2] & Status.UNREACHABLE_FAR
    assert solved.status[3] == Status.INVALID_INPUT
    assert all(math.isnan(angle) for angle in solved.angles[6:])
    back = call(bench.forward, SolveForwardKinematics.Request(angles=solved.angles[:6]))
    assert list(back.positions) == pytest.approx(points[:6], abs=1e-12)
    assert list(back.status) == [0, 0]


def test_an_incomplete_last_point_is_invalid_input(bench: Bench) -> None:
    solved = call(bench.inverse, SolveInverseKinematics.Request(positions=[0.0, 0.0, 0.08, 0.0]))
    assert list(solved.status) == [0, Status.INVALID_INPUT]
    assert len(solved.angles) == 6


def test_an_empty_request_is_no_error(bench: Bench) -> None:
    solved = call(bench.inverse, SolveInverseKinematics.Request())
    assert (len(solved.angles), len(solved.status), len(solved.margin)) == (0, 0, 0)


def test_a_request_with_too_many_points_gets_an_empty_answer(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kinematics_node, "POINTS_MAX", 100)
    for count, answered in ((100, 100), (101, 0)):
        values = array("d", [0.0, 0.0, 0.08] * count)
        assert len(call(bench.inverse, SolveInverseKinematics.Request(positions=values)).status) == answered
        assert len(call(bench.forward, SolveForwardKinematics.Request(angles=values)).status) == answered


def test_the_status_constants_of_both_services_are_those_of_the_library() -> None:
    for service in (SolveInverseKinematics.Response, SolveForwardKinematics.Response):
        for status in Status:
            assert getattr(service, f"STATUS_{status.name}") == status


@pytest.mark.parametrize("count", [10_000, 10_001])
def test_many_points_are_solved_in_order_like_the_library(bench: Bench, count: int) -> None:
    positions = np.random.default_rng(3).uniform((-0.3, -0.3, -0.1), (0.3, 0.3, 0.3), (count, 3))
    positions[[0, -1]] = (0.0, 0.0, 0.08), (math.nan, 0.0, 0.0)
    solved = call(bench.inverse, SolveInverseKinematics.Request(positions=array("d", positions.tobytes())))
    wanted = Delta().inverse(positions)
    assert np.array_equal(np.reshape(solved.angles, (-1, 3)), wanted.angles, equal_nan=True)
    assert np.array_equal(solved.status, wanted.status)
    assert np.array_equal(solved.margin, wanted.margin, equal_nan=True)
    back = call(bench.forward, SolveForwardKinematics.Request(angles=solved.angles))
    again = Delta().forward(wanted.angles)
    assert np.array_equal(np.reshape(back.positions, (-1, 3)), again.position, equal_nan=True)
    assert np.array_equal(back.status, again.status)


def servo_state(position: tuple[float, float, float], current: Sequence[float], /, **fields: Any) -> ServoState:
    """Return the servo_state of an arm at `position`, changed by `fields`."""
    state = ServoState(position=DELTA.inverse(*position), velocity=[0.0] * 3, current=current)
    state.valid = state.torque_enabled = [True] * 3
    for name, value in fields.items():
        setattr(state, name, value)
    return state


def push(bench: Bench, state: ServoState) -> None:
    bench.poses.clear()
    bench.wrenches.clear()
    bench.state.publish(state)


def force(message: WrenchStamped) -> tuple[float, float, float]:
    return message.wrench.force.x, message.wrench.force.y, message.wrench.force.z


def test_the_wrench_is_the_targets_reaction_without_the_arms_weight(bench: Bench) -> None:
    position, pressed = (0.01, -0.02, 0.08), (1.0, -2.0, 17.0)
    torques = zip(DELTA.holding_torque(*position, GRAVITY), DELTA.torque(*position, pressed), strict=True)
    push(bench, servo_state(position, [sum(torque) / TORQUE_CONSTANT for torque in torques]))
    wait_until(lambda: bench.poses and bench.wrenches, "pose and wrench")
    assert bench.wrenches[0].header.frame_id == "end_effector"
    assert force(bench.wrenches[0]) == pytest.approx((-1.0, 2.0, -17.0))
    assert bench.wrenches[0].wrench.torque == Vector3()
    pose = bench.poses[0]
    assert pose.header.frame_id == "charger_base"
    assert (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z) == pytest.approx(position)
    assert pose.pose.orientation == Quaternion(w=1.0)


def test_half_an_ampere_more_on_every_servo_gives_a_reaction_along_z(bench: Bench) -> None:
    dock = (0.0, 0.0, 0.08)
    held = [torque / TORQUE_CONSTANT for torque in DELTA.holding_torque(*dock, GRAVITY)]
    for more, expected in ((0.0, 0.0), (0.521, -20.0), (-0.521, 20.0)):
        push(bench, servo_state(dock, [current + more for current in held]))
        wait_until(lambda: bench.wrenches, "the wrench")
        assert force(bench.wrenches[0]) == pytest.approx((0.0, 0.0, expected), abs=0.02)


def test_pose_and_wrench_carry_the_stamp_of_their_measurement(bench: Bench) -> None:
    state = servo_state((0.0, 0.0, 0.08), [0.1] * 3)
    state.header.stamp.sec, state.header.stamp.nanosec = 1234, 567
    push(bench, state)
    wait_until(lambda: bench.poses and bench.wrenches, "pose and wrench")
    for message in (bench.poses[0], bench.wrenches[0]):
        assert message.header.stamp == state.header.stamp


def what_follows(bench: Bench, **fields: Any) -> tuple[int, int]:
    """Return the number of poses and wrenches after a servo_state changed by `fields`."""
    bench.poses.clear()
    bench.wrenches.clear()
    # Passed directly: the topic keeps only the latest message, so this one might be lost.
    bench.spinners[0].node._on_servo_state(servo_state((0.0, 0.0, 0.05), [0.1] * 3, **fields))
    bench.state.publish(servo_state((0.0, 0.0, 0.06), [0.2] * 3, header=Header(stamp=Time(sec=99))))

    def arrived() -> bool:
        return all(seen and seen[-1].header.stamp.sec == 99 for seen in (bench.poses, bench.wrenches))

    wait_until(arrived, "the results of the next message")
    return len(bench.poses) - 1, len(bench.wrenches) - 1


def test_a_complete_message_gives_one_pose_and_one_wrench(bench: Bench) -> None:
    assert what_follows(bench) == (1, 1)


@pytest.mark.parametrize(
    "fields",
    [
        {"valid": [True, False, True]},
        {"valid": []},
        {"position": [math.nan, 0.0, 0.0]},
        {"position": [0.1, 0.1]},
    ],
)
def test_an_unknown_angle_gives_nothing(bench: Bench, fields: dict[str, Any]) -> None:
    assert what_follows(bench, **fields) == (0, 0)


@pytest.mark.parametrize(
    "fields", [{"current": [math.nan, 0.1, 0.1]}, {"current": []}, {"torque_enabled": [True, True, False]}]
)
def test_a_meaningless_current_gives_a_pose_and_no_force(bench: Bench, fields: dict[str, Any]) -> None:
    assert what_follows(bench, **fields) == (1, 0)


CALIBRATED = """
arm: 0.1012
z_offset: 0.096
workspace_max: [0.05, 0.05, 0.1]
limbs:
- {radius_offset: 0.0004, angle_offset: 0.01}
- {tangential_offset: -0.0003}
- {rod: 0.1806, height_offset: 0.0002}
"""


@pytest.fixture
def geometry_file(tmp_path: Path) -> Path:
    path = tmp_path / "calibrated.yaml"
    path.write_text(CALIBRATED)
    return path


def test_a_geometry_file_sets_each_limb(context: Any, geometry_file: Path) -> None:
    bench = Bench(context, geometry_file=str(geometry_file), arm=0.1012)
    try:
        positions = np.random.default_rng(4).uniform((-0.06, -0.06, 0.0), (0.06, 0.06, 0.11), (50, 3))
        solved = call(bench.inverse, SolveInverseKinematics.Request(positions=positions.ravel().tolist()))
        wanted = Delta(load_geometry(geometry_file)).inverse(positions)
        assert np.array_equal(np.reshape(solved.angles, (-1, 3)), wanted.angles)
        assert np.array_equal(solved.status, wanted.status)
        assert not np.allclose(wanted.angles, Delta().inverse(positions).angles, atol=1e-3)
        node = bench.spinners[0].node
        assert node.get_parameter("z_offset").value == 0.096
        assert list(node.get_parameter("workspace_max").value) == [0.05, 0.05, 0.1]
    finally:
        bench.close()


@pytest.mark.parametrize("kind", [KinematicsNode, DockingNode])
def test_a_dimension_that_contradicts_the_geometry_file_stops_the_node_with_both_names(
    kind: type[Node], context: Any, geometry_file: Path
) -> None:
    with pytest.raises(StartupError, match=r"'z_offset' is 0\.095, .*'geometry_file'.* has 0\.096"):
        kind(**options(context, new_namespace(), geometry_file=str(geometry_file), z_offset=0.095))
    with pytest.raises(StartupError, match=r"'workspace_max' is .*'geometry_file'"):
        kind(**options(context, new_namespace(), geometry_file=str(geometry_file), workspace_max=[0.06, 0.06, 0.11]))


@pytest.mark.parametrize("kind", [KinematicsNode, DockingNode])
@pytest.mark.parametrize(
    ("content", "reason"),
    [("arms: 0.1", "did you mean 'arm'"), ("arm: 1.5", r"'arm'.*geometry_file")],
)
def test_a_refused_geometry_file_stops_the_node_with_the_reason(
    kind: type[Node], context: Any, tmp_path: Path, content: str, reason: str
) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(content)
    with pytest.raises(StartupError, match=reason) as caught:
        kind(**options(context, new_namespace(), geometry_file=str(path)))
    assert "bad.yaml" in str(caught.value)


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"workspace_min": [0.0, 0.0]}, "workspace_min"),
        ({"workspace_min": [0.0, 0.0, 0.2]}, "workspace_min.*not below"),
        ({"workspace_max": [0.06, 0.06, 2.0]}, "'workspace_max'.*-1 to 1 m"),
        ({"joint_min": 0.5, "joint_max": 0.4}, "joint_min.*not below"),
        ({"gravity": [0.0, -9.81]}, "'gravity': has 2 numbers"),
    ],
)
def test_impossible_parameters_stop_the_node(context: Any, parameters: dict[str, Any], reason: str) -> None:
    with pytest.raises(StartupError, match=reason):
        KinematicsNode(**options(context, new_namespace(), **parameters))


def test_a_missing_geometry_file_ends_the_process_with_code_2_and_its_path(start: Callable[..., Process]) -> None:
    words = ("--ros-args", "-p", "geometry_file:=nowhere/arm.yaml")
    process = start(sys.executable, "-m", "deltacharger_kinematics.kinematics_node", *words)
    assert process.end() == 2
    assert len(process.err) == 1
    assert f"'geometry_file': '{Path('nowhere/arm.yaml').absolute()}' cannot be read: No such file" in process.err[0]
