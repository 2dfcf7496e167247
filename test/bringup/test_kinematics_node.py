"""kinematics_node: pose and force from servo_state, and kinematics with a status per point."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest
from deltacharger.msg import ServoState
from deltacharger.srv import SolveForwardKinematics, SolveInverseKinematics
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node

from deltacharger_bringup import qos
from deltacharger_bringup.node_support import Spinner
from deltacharger_kinematics import Status
from deltacharger_kinematics.kinematics_node import KinematicsNode
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_kinematics.statics import GRAVITY, TORQUE_CONSTANT

from .conftest import DEADLINE, new_namespace, wait_until

DELTA = ScalarDelta()


class Bench:
    """The node under test beside one that asks it."""

    def __init__(self, context: Any) -> None:
        options: dict[str, Any] = {"context": context, "namespace": new_namespace(), "use_global_arguments": False}
        self.asker = Node("asker", **options)
        self.state = self.asker.create_publisher(ServoState, "servo_state", qos.LATEST)
        self.inverse = self.asker.create_client(SolveInverseKinematics, "solve_inverse_kinematics")
        self.forward = self.asker.create_client(SolveForwardKinematics, "solve_forward_kinematics")
        self.poses: list[PoseStamped] = []
        self.wrenches: list[WrenchStamped] = []
        self.asker.create_subscription(PoseStamped, "end_effector_pose", self.poses.append, 10)
        self.asker.create_subscription(WrenchStamped, "contact_wrench", self.wrenches.append, 10)
        self.spinners = [Spinner(KinematicsNode(**options)), Spinner(self.asker)]
        wait_until(self.ready, "kinematics_node")

    def ready(self) -> bool:
        node = self.spinners[0].node
        listening = all(publisher.get_subscription_count() for publisher in (node._pose, node._wrench))
        served = self.inverse.service_is_ready() and self.forward.service_is_ready()
        return served and listening and self.state.get_subscription_count() == 1

    def call(self, client: Any, request: Any) -> Any:
        future = client.call_async(request)
        wait_until(future.done, "the answer", DEADLINE)
        return future.result()

    def close(self) -> None:
        for spinner in self.spinners:
            spinner.close()


@pytest.fixture(scope="module")
def bench(context: Any) -> Iterator[Bench]:
    bench = Bench(context)
    yield bench
    bench.close()


def test_forward_undoes_inverse_and_one_bad_point_fails_no_other(bench: Bench) -> None:
    points = [0.0, 0.0, 0.08, 0.03, -0.02, 0.05, 9.0, 0.0, 0.0, math.nan, 0.0, 0.0]
    solved = bench.call(bench.inverse, SolveInverseKinematics.Request(positions=points))
    assert list(solved.status[:2]) == [0, 0]
    assert solved.status[2] & Status.UNREACHABLE_FAR
    assert solved.status[3] == Status.INVALID_INPUT
    assert all(math.isnan(angle) for angle in solved.angles[6:])
    back = bench.call(bench.forward, SolveForwardKinematics.Request(angles=solved.angles[:6]))
    assert list(back.positions) == pytest.approx(points[:6], abs=1e-12)
    assert list(back.status) == [0, 0]


def test_an_incomplete_last_point_is_invalid_input(bench: Bench) -> None:
    solved = bench.call(bench.inverse, SolveInverseKinematics.Request(positions=[0.0, 0.0, 0.08, 0.0]))
    assert list(solved.status) == [0, Status.INVALID_INPUT]
    assert len(solved.angles) == 6


def test_no_points_is_no_error(bench: Bench) -> None:
    solved = bench.call(bench.inverse, SolveInverseKinematics.Request())
    assert (len(solved.angles), len(solved.status), len(solved.margin)) == (0, 0, 0)


def test_the_status_constants_of_both_services_are_those_of_the_library() -> None:
    for service in (SolveInverseKinematics.Response, SolveForwardKinematics.Response):
        for status in Status:
            assert getattr(service, f"STATUS_{status.name}") == status


def push(bench: Bench, current: list[float], position: tuple[float, float, float]) -> None:
    bench.poses.clear()
    bench.wrenches.clear()
    angles = list(DELTA.inverse(*position))
    bench.state.publish(ServoState(position=angles, current=current, velocity=[0.0] * 3, valid=[True] * 3))


def test_the_wrench_is_the_target_pushing_back_without_the_arms_weight(bench: Bench) -> None:
    position, force = (0.01, -0.02, 0.08), (1.0, -2.0, 17.0)
    held = DELTA.holding_torque(*position, GRAVITY)
    pressed = DELTA.torque(*position, force)
    current = [(hold + press) / TORQUE_CONSTANT for hold, press in zip(held, pressed, strict=True)]
    push(bench, current, position)
    wait_until(lambda: bench.poses and bench.wrenches, "pose and wrench")
    felt = bench.wrenches[0]
    assert felt.header.frame_id == "end_effector"
    assert (felt.wrench.force.x, felt.wrench.force.y, felt.wrench.force.z) == pytest.approx((-1.0, 2.0, -17.0))
    pose = bench.poses[0]
    assert pose.header.frame_id == "charger_base"
    assert (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z) == pytest.approx(position)


def test_an_unknown_current_gives_a_pose_and_no_force(bench: Bench) -> None:
    push(bench, [math.nan] * 3, (0.0, 0.0, 0.05))
    wait_until(lambda: bench.poses, "the pose")
    push(bench, [0.1] * 3, (0.0, 0.0, 0.06))  # messages keep their order, so this wrench would come second
    wait_until(lambda: bench.wrenches, "the next wrench")
    assert len(bench.wrenches) == 1
