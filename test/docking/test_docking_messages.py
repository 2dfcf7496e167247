# SPDX-License-Identifier: Apache-2.0
"""What docking publishes and reads, and its calls: it waits for a late service, and no call overtakes another."""

import math
from types import SimpleNamespace
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from deltacharger.msg import ElectrodeDetection
from geometry_msgs.msg import PoseStamped, Quaternion
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from deltacharger_core import frames, texts
from deltacharger_core.ros.messages import seconds
from deltacharger_docking import arm, codes, observation, parameters
from deltacharger_docking.ros import messages as io
from deltacharger_docking.ros.reports import PhaseLog
from deltacharger_docking.ros.services import Services
from deltacharger_kinematics import DeltaGeometry

from ..chargers import Spin, wait_until
from ..nodes import options


def test_a_line_is_sent_with_positions_velocities_and_efforts_and_ends_at_rest() -> None:
    waypoints = arm.Planner(parameters.DockingParameters(), DeltaGeometry()).line(
        (0.0, 0.0, 0.0), (0.0, 0.0, 0.06), 0.12
    )
    message = io.trajectory(waypoints, Time(sec=7))
    assert message.header.stamp.sec == 7
    assert list(message.joint_names) == list(io.JOINTS)
    assert len(message.points) == len(waypoints)
    for point, waypoint in zip(message.points, waypoints, strict=True):
        assert tuple(point.positions) == waypoint.angles
        assert tuple(point.velocities) == waypoint.velocities
        assert tuple(point.effort) == waypoint.torque_bound
        assert abs(seconds(point.time_from_start) - waypoint.time) < 1e-8
    assert list(message.points[-1].velocities) == [0.0, 0.0, 0.0]
    assert max(message.points[len(message.points) // 2].velocities) > 0.5


DEGREE = math.radians(1.0)
MOUNT = parameters.DockingNodeParameters()
TURNED = parameters.DockingNodeParameters(
    base_pose=(0.3, -0.1, 0.2, *(math.sqrt(0.125) * value for value in (2, 2, 0, 0)))
)
"""A charger_base with another mount on its robot."""


def turned(yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> tuple[float, ...]:
    """Return the quaternion of a roll, then a pitch, then a yaw, rad."""
    result: tuple[float, ...] = (0.0, math.sin(0.5 * yaw), 0.0, math.cos(0.5 * yaw))
    result = frames.product(result, (math.sin(0.5 * pitch), 0.0, 0.0, math.cos(0.5 * pitch)))
    return frames.product(result, (0.0, 0.0, math.sin(0.5 * roll), math.cos(0.5 * roll)))


def quaternion(numbers: tuple[float, ...]) -> Quaternion:
    return Quaternion(**dict(zip("xyzw", numbers, strict=True)))


def roll_of(numbers: tuple[float, ...]) -> float:
    """Return the roll as the camera reports it: of the x axis projected on charger_base's x and y, rad."""
    rows = frames.rotation(*numbers)
    return math.atan2(rows[1][0], rows[0][0])


def goal(numbers: tuple[float, ...], charger: tuple[float, ...] = frames.IDENTITY) -> observation.ElectrodePose:
    message = PoseStamped()
    message.header.frame_id = "charger_base"
    message.pose.position.z, message.pose.orientation = 0.08, quaternion(numbers)
    found = io.electrodes(message, charger)
    assert found is not None
    return found


@pytest.mark.parametrize(("yaw", "pitch"), [(4.0, 0.0), (-4.0, 0.0), (0.0, 2.0), (0.0, -2.0)])
@pytest.mark.parametrize("roll", [0.0, -7.0])
@pytest.mark.parametrize("mount", [MOUNT, TURNED])
def test_a_goal_that_leans_keeps_its_lean_in_either_frame(
    yaw: float, pitch: float, roll: float, mount: parameters.DockingNodeParameters
) -> None:
    orientation = turned(yaw * DEGREE, pitch * DEGREE, roll * DEGREE)
    in_robot = frames.product(mount.base_pose[3:], orientation)
    for found in (goal(orientation), goal(in_robot, mount.base_pose)):
        assert (found.yaw, found.pitch) == pytest.approx((yaw * DEGREE, pitch * DEGREE))
        assert found.yaw_stddev == found.pitch_stddev == DEGREE
        assert found.roll == pytest.approx(roll_of(orientation))


@pytest.mark.parametrize("roll", [0.0, 7.0])
@pytest.mark.parametrize("mount", [MOUNT, TURNED])
def test_the_lean_of_a_goal_with_only_a_roll_is_unknown_not_zero(
    roll: float, mount: parameters.DockingNodeParameters
) -> None:
    """Also with rounded numbers: a fleet that sends a roll has not measured the lean."""
    orientation = turned(roll=roll * DEGREE)
    rounded = tuple(round(value, 4) for value in frames.product(mount.base_pose[3:], orientation))
    for found in (goal(orientation), goal(rounded, mount.base_pose)):
        assert all(map(math.isnan, (found.yaw, found.pitch, found.yaw_stddev, found.pitch_stddev)))
        assert found.sure_yaw(2.0) == 0.0
        assert found.roll == pytest.approx(roll * DEGREE, abs=1e-3)


def test_a_goal_with_more_lean_than_30_degrees_is_refused() -> None:
    assert goal(turned(29.9 * DEGREE)).yaw == pytest.approx(29.9 * DEGREE)
    for numbers in (turned(30.1 * DEGREE), turned(pitch=-30.1 * DEGREE), turned(math.pi)):
        with pytest.raises(codes.Rejected, match="more than 30°"):
            goal(numbers)


def detection(numbers: tuple[float, ...], roll: float, variances: tuple[float, ...]) -> ElectrodeDetection:
    """Return a detection of that orientation with variances of the rotations about x, y and z, rad²."""
    message = ElectrodeDetection(roll=roll)
    message.header.frame_id = "charger_base"
    message.pose.pose.position.z, message.pose.pose.orientation = 0.08, quaternion(numbers)
    for index, variance in zip((21, 28, 35), variances, strict=True):
        message.pose.covariance[index] = variance
    return message


def test_a_detection_gives_its_lean_with_its_error() -> None:
    numbers = turned(4.0 * DEGREE, -2.0 * DEGREE, 6.0 * DEGREE)
    found = io.seen(detection(numbers, roll_of(numbers), (0.01**2, 0.02**2, 0.03**2)), 0.5)
    assert math.tan(found.pitch) == pytest.approx(math.tan(-2.0 * DEGREE) / math.cos(4.0 * DEGREE))
    assert found.yaw == pytest.approx(4.0 * DEGREE)
    stddevs = found.pitch_stddev, found.yaw_stddev, found.roll_stddev, found.age
    assert stddevs == pytest.approx((0.01, 0.02, 0.03, 0.5))


def test_a_detection_in_another_frame_is_refused() -> None:
    with pytest.raises(ValueError, match="'charger_base', not in left/charger_base"):
        io.seen(detection(turned(), 0.0, (0.01, 0.01, 0.01)), 0.0, "left/charger_base")


@pytest.mark.parametrize("variance", [math.nan, 0.0])
def test_a_normal_without_a_variance_is_unknown(variance: float) -> None:
    found = io.seen(detection(turned(roll=0.1), 0.1, (variance, variance, 0.01)), 0.0)
    assert all(map(math.isnan, (found.yaw, found.pitch, found.yaw_stddev, found.pitch_stddev)))
    assert found.roll == 0.1
    leaning = turned(4.0 * DEGREE)
    found = io.seen(detection(leaning, roll_of(leaning), (variance, 0.01, 0.01)), 0.0)
    assert math.isnan(found.pitch)
    assert found.yaw == pytest.approx(4.0 * DEGREE)


@pytest.mark.parametrize(
    ("numbers", "roll", "variances", "named"),
    [
        (turned(roll=0.1), 0.102, (0.01, 0.01, 0.01), "contradicts itself"),
        (turned(roll=0.1), math.nan, (0.01, 0.01, 0.01), "not finite"),
        ((0.0, 0.0, 0.0, 0.0), 0.0, (0.01, 0.01, 0.01), "not finite"),
        (turned(), 0.0, (0.01, 0.01, -1e-9), "negative variance"),
    ],
)
def test_a_contradictory_detection_is_refused_with_its_contradiction(
    numbers: tuple[float, ...], roll: float, variances: tuple[float, ...], named: str
) -> None:
    with pytest.raises(ValueError, match=named):
        io.seen(detection(numbers, roll, variances), 0.0)


@pytest.fixture
def node(context: Any, namespace: str, spin: Spin) -> Node:
    return spin(Node("docking", **options(context, namespace)))


@pytest.fixture
def services(node: Node) -> Services:
    return Services(node, frames.TransformParameters())


def reply(services: Services) -> observation.Reply:
    found: list[observation.Reply] = []
    wait_until(lambda: found.extend(services.take_replies()[0]) or found, "a reply")
    return found[0]


@pytest.mark.ros
@pytest.mark.version
def test_a_service_that_appears_after_the_call_is_used(node: Node, services: Services) -> None:
    services.call(observation.Request(7, observation.Service.TARE))
    assert services.take_replies() == ((), "")

    def tare(request: Any, response: Any) -> Any:
        response.success, response.message = True, "tared" + 1_000_000 * "!"
        return response

    node.create_service(Trigger, "tare", tare, callback_group=ReentrantCallbackGroup())
    answer = reply(services)
    assert (answer.number, answer.success, answer.message[:5]) == (7, True, "tared")
    assert len(answer.message) < 2 * texts.MESSAGE_MAX


def serve_torque(node: Node) -> list[bool]:
    """Serve set_torque; return what was asked for so far."""
    received = list[bool]()

    def set_torque(request: Any, response: Any) -> Any:
        received.append(request.data)
        response.success = True
        return response

    node.create_service(SetBool, "set_torque", set_torque)
    return received


@pytest.mark.ros
def test_torque_on_never_overtakes_torque_off_when_servo_node_appears_late(node: Node, services: Services) -> None:
    services.call(observation.Request(1, observation.Service.TORQUE_ON))
    received = serve_torque(node)
    wait_until(services._clients[observation.Service.TORQUE_ON].service_is_ready, "the service")
    services.call(observation.Request(2, observation.Service.TORQUE_OFF))
    wait_until(lambda: services.take_replies() and len(received) == 2, "both calls")
    assert received == [True, False]


def test_a_failure_is_a_warning_and_a_cancel_none() -> None:
    lines, warnings = list[str](), list[str]()
    log = PhaseLog(SimpleNamespace(info=lines.append, warning=warnings.append), codes.State.IDLE)  # type: ignore[arg-type]
    log.begin_goal("dock order-1")
    for code in (codes.Code.NO_CONTACT, codes.Code.NO_CONTACT, codes.Code.NONE, codes.Code.CANCELED):
        log.show(SimpleNamespace(code=code, message="why"), (), 0.0)
    assert warnings == ["dock order-1: 302 NO_CONTACT: why"]
    assert lines[1:] == ["dock order-1: 102 CANCELED: why"]
