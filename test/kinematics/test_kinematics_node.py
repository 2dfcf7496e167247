# SPDX-License-Identifier: Apache-2.0
"""kinematics_node: pose and force from servo_state, and kinematics with a status per point."""

import math
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
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
from deltacharger_core.ros import executor, node_support, qos
from deltacharger_docking.ros.docking_node import DockingNode
from deltacharger_kinematics import Delta, Status, geometry, kinematics_node, scalar

from ..chargers import new_namespace, wait_until
from ..nodes import call, options

pytestmark = pytest.mark.ros

DELTA = scalar.ScalarDelta()


class Bench:
    """The node under test with a client node."""

    def __init__(self, context: Any, **parameters: Any) -> None:
        namespace = new_namespace()
        asker = Node("asker", **options(context, namespace))
        self.state = asker.create_publisher(ServoState, "servo_state", qos.LATEST)
        self.inverse = asker.create_client(SolveInverseKinematics, "solve_inverse_kinematics")
        self.forward = asker.create_client(SolveForwardKinematics, "solve_forward_kinematics")
        self.poses: list[PoseStamped] = []
        self.wrenches: list[WrenchStamped] = []
        asker.create_subscription(PoseStamped, "end_effector_pose", self.poses.append, 10)
        asker.create_subscription(WrenchStamped, "contact_wrench", self.wrenches.append, 10)
        self.node = kinematics_node.KinematicsNode(**options(context, namespace, **parameters))
        self.spinners = [executor.Spinner(self.node), executor.Spinner(asker)]
        wait_until(self.ready, "kinematics_node")

    def ready(self) -> bool:
        listening = all(publisher.get_subscription_count() for publisher in (self.node._pose, self.node._wrench))
        served = self.inverse.service_is_ready() and self.forward.service_is_ready()
        return served and listening and self.state.get_subscription_count() == 1

    def solve(self, positions: Any) -> Any:
        request = SolveInverseKinematics.Request(positions=array("d", np.asarray(positions, dtype=float).tobytes()))
        return call(self.inverse, request)

    def results(self, state: ServoState) -> tuple[PoseStamped, WrenchStamped]:
        """Publish a servo_state and return the pose and the wrench that follow."""
        self.poses.clear()
        self.wrenches.clear()
        self.state.publish(state)
        wait_until(lambda: self.poses and self.wrenches, "pose and wrench")
        return self.poses[0], self.wrenches[0]

    def close(self) -> None:
        for spinner in self.spinners:
            spinner.close()


@pytest.fixture(scope="module")
def bench(context: Any) -> Iterator[Bench]:
    bench = Bench(context)
    yield bench
    bench.close()


@pytest.mark.version
@pytest.mark.parametrize("count", [4, 3000])
def test_points_are_solved_in_order_like_the_library(bench: Bench, count: int) -> None:
    positions = np.random.default_rng(3).uniform((-0.3, -0.3, -0.1), (0.3, 0.3, 0.3), (count, 3))
    positions[[0, 1, -1]] = (0.0, 0.0, 0.08), (9.0, 0.0, 0.0), (math.nan, 0.0, 0.0)
    solved, wanted = bench.solve(positions), Delta().inverse(positions)
    assert np.array_equal(np.reshape(solved.angles, (-1, 3)), wanted.angles, equal_nan=True)
    assert np.array_equal(solved.status, wanted.status)
    assert np.array_equal(solved.margin, wanted.margin, equal_nan=True)
    assert solved.status[-1] == Status.INVALID_INPUT
    back = call(bench.forward, SolveForwardKinematics.Request(angles=solved.angles))
    again = Delta().forward(wanted.angles)
    assert np.array_equal(np.reshape(back.positions, (-1, 3)), again.position, equal_nan=True)
    assert np.array_equal(back.status, again.status)


def test_an_incomplete_last_point_is_invalid_input_and_none_is_no_error(bench: Bench) -> None:
    solved = bench.solve([0.0, 0.0, 0.08, 0.0])
    assert (list(solved.status), len(solved.angles)) == ([0, Status.INVALID_INPUT], 6)
    assert len(bench.solve([]).status) == 0


def test_a_request_with_too_many_points_gets_an_empty_answer(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kinematics_node, "POINTS_MAX", 100)
    for count, answered in ((100, 100), (101, 0)):
        values = array("d", [0.0, 0.0, 0.08] * count)
        assert len(bench.solve(values).status) == answered
        assert len(call(bench.forward, SolveForwardKinematics.Request(angles=values)).status) == answered


def test_the_status_constants_of_both_services_are_those_of_the_library() -> None:
    for service in (SolveInverseKinematics.Response, SolveForwardKinematics.Response):
        assert all(getattr(service, f"STATUS_{status.name}") == status for status in Status)


def servo_state(position: tuple[float, float, float], current: Sequence[float], /, **fields: Any) -> ServoState:
    """Return the servo_state of an arm at `position`, changed by `fields`."""
    state = ServoState(position=DELTA.inverse(*position), velocity=[0.0] * 3, current=current)
    state.valid = state.torque_enabled = [True] * 3
    for name, value in fields.items():
        setattr(state, name, value)
    return state


@pytest.mark.version
@pytest.mark.parametrize("pressed", [(1.0, -2.0, 17.0), (0.0, 0.0, 0.0)])
def test_the_wrench_is_the_targets_reaction_without_the_arms_weight(
    bench: Bench, pressed: tuple[float, float, float]
) -> None:
    position, stamp = (0.01, -0.02, 0.08), Time(sec=1234, nanosec=567)
    torques = zip(DELTA.holding_torque(*position, GRAVITY), DELTA.torque(*position, pressed), strict=True)
    currents = [sum(torque) / TORQUE_CONSTANT for torque in torques]
    pose, wrench = bench.results(servo_state(position, currents, header=Header(stamp=stamp)))
    assert wrench.header == Header(stamp=stamp, frame_id="end_effector")
    force = wrench.wrench.force
    assert (force.x, force.y, force.z) == pytest.approx([-each for each in pressed], abs=1e-9)
    assert wrench.wrench.torque == Vector3()
    assert pose.header == Header(stamp=stamp, frame_id="charger_base")
    assert (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z) == pytest.approx(position)
    assert pose.pose.orientation == Quaternion(w=1.0)


@pytest.mark.parametrize(
    ("fields", "count"),
    [
        ({}, (1, 1)),
        ({"valid": [True, False, True]}, (0, 0)),
        ({"position": [math.nan, 0.0, 0.0]}, (0, 0)),
        ({"current": [math.nan, 0.1, 0.1]}, (1, 0)),
        ({"torque_enabled": [True, True, False]}, (1, 0)),
    ],
)
def test_an_unknown_angle_gives_nothing_and_a_meaningless_current_no_force(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, fields: dict[str, Any], count: tuple[int, int]
) -> None:
    sent: tuple[list[Any], list[Any]] = [], []
    for name, messages in zip(("_pose", "_wrench"), sent, strict=True):
        monkeypatch.setattr(
            bench.node, name, SimpleNamespace(publish=messages.append, get_subscription_count=lambda: 1)
        )
    bench.node._on_servo_state(servo_state((0.0, 0.0, 0.05), [0.1] * 3, **fields))
    assert tuple(map(len, sent)) == count


@pytest.fixture
def geometry_file(tmp_path: Path) -> str:
    path = tmp_path / "calibrated.yaml"
    path.write_text("""
arm: 0.1012
z_offset: 0.096
workspace_max: [0.05, 0.05, 0.1]
limbs:
- {radius_offset: 0.0004, angle_offset: 0.01}
- {tangential_offset: -0.0003}
- {rod: 0.1806, height_offset: 0.0002}
""")
    return str(path)


def test_a_geometry_file_sets_each_limb(context: Any, geometry_file: str) -> None:
    bench = Bench(context, geometry_file=geometry_file)
    try:
        positions = np.random.default_rng(4).uniform((-0.06, -0.06, 0.0), (0.06, 0.06, 0.11), (50, 3))
        solved, wanted = bench.solve(positions), Delta(geometry.load_geometry(Path(geometry_file))).inverse(positions)
        assert np.array_equal(np.reshape(solved.angles, (-1, 3)), wanted.angles)
        assert not np.allclose(wanted.angles, Delta().inverse(positions).angles, atol=1e-3)
    finally:
        bench.close()


@pytest.mark.parametrize(
    ("parameters", "content", "reason"),
    [
        ({"z_offset": 0.095}, "", "z_offset"),
        ({}, "arms: 0.1", r"bad\.yaml.*'arm'"),
        ({}, "arm: 100.0", r"bad\.yaml.*'arm': 100.0 is outside.*millimetres"),
        ({"geometry_file": "nowhere/arm.yaml"}, "", "'geometry_file'.*nowhere/arm.yaml"),
    ],
)
def test_impossible_parameters_and_a_geometry_file_that_is_refused_or_contradicted_stop_the_node(
    context: Any, geometry_file: str, parameters: dict[str, Any], content: str, reason: str
) -> None:
    bad = Path(geometry_file).with_name("bad.yaml")
    bad.write_text(content)
    given = {"geometry_file": str(bad) if content else geometry_file, **parameters}
    for kind in (kinematics_node.KinematicsNode, DockingNode):
        with pytest.raises(node_support.StartupError, match=reason):
            kind(**options(context, new_namespace(), **given))
