# SPDX-License-Identifier: Apache-2.0
"""Whose trajectories and reports servo_node believes: its ROS inputs without ROS, in virtual time."""

import math
import struct
from array import array
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from deltacharger.msg import ChargerPower
from rclpy.clock import ROSClock
from rclpy.serialization import serialize_message
from rclpy.time import Time
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from deltacharger_core.machine import JOINTS
from deltacharger_core.ros.on_demand import Received
from deltacharger_driver.servos import motion, registers, servo_node

from .servo_rig import START, Rig

LEADER, STRANGER = ("a" * 32, b"1"), ("", b"2")
GOAL = [angle + 0.1 for angle in START]


class Topic:
    """A topic whose messages the test puts in."""

    name = "/topic"

    def __init__(self) -> None:
        self.waiting: list[Received] = []

    def take(self) -> list[Received]:
        taken, self.waiting = self.waiting, []
        return taken


@pytest.fixture
def node(clock: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A node whose stamps show a virtual clock; its service is ready, and requests to it are kept."""
    stamps = ROSClock()
    stamps._set_ros_time_is_active(True)
    monkeypatch.setattr(stamps, "now", lambda: Time(seconds=clock()))
    monkeypatch.setattr(servo_node, "BoundedTopic", lambda *arguments: Topic())
    requests: list[Any] = []
    client = SimpleNamespace(service_is_ready=lambda: True, call_async=requests.append)
    return SimpleNamespace(
        get_clock=lambda: stamps,
        create_client=lambda *arguments, **options: client,
        count_publishers=lambda name: 2,
        requests=requests,
    )


def trajectory(secret: str, *points: tuple[float, Any]) -> JointTrajectory:
    message = JointTrajectory(joint_names=list(JOINTS))
    message.header.frame_id = secret
    for seconds, angles in points:
        point = JointTrajectoryPoint(positions=array("d", angles))
        point.time_from_start.sec, point.time_from_start.nanosec = int(seconds), int(seconds % 1 * 1e9)
        message.points.append(point)
    return message


class Arm:
    """An arm with torque, and its inbox."""

    def __init__(self, rig: Rig, node: Any) -> None:
        self.rig, self.guard = rig, motion.MotionGuard()
        self.inbox = servo_node.TrajectoryInbox(node, motion.JointLimits(JOINTS, -1.2, 1.3, 4.4))
        self.state = motion.ContactorState.OPEN
        rig.torque_on()

    def receive(self, *messages: tuple[Any, bytes]) -> list[float]:
        """Take messages, each with its publisher's id, and return the goals of the second cycle from now."""
        topic: Any = self.inbox._topic
        for message, publisher in messages:
            data = message if isinstance(message, bytes) else serialize_message(message)
            topic.waiting.append(Received(data, publisher, JointTrajectory))
        self.inbox.serve(self.rig.controller, self.guard, self.state)
        self.rig.cycle()
        self.rig.cycle()
        return self.rig.references()

    def follows(self, sender: tuple[str, bytes], goal: Any) -> bool:
        secret, publisher = sender
        found = self.receive((trajectory(secret, (0.0, goal)), publisher))
        return found == pytest.approx(list(goal), abs=registers.TICK)


@pytest.fixture
def servos(rig: Rig, node: Any) -> Arm:
    return Arm(rig, node)


def test_only_allowed_senders_move_the_arm(servos: Arm) -> None:
    assert servos.follows(LEADER, GOAL)
    servos.state = motion.ContactorState.ARMED
    assert servos.follows(LEADER, START)
    before = servos.rig.references()
    for sender in (STRANGER, (LEADER[0], b"3")):  # who copies the secret is another publisher
        assert not servos.follows(sender, GOAL)
        assert servos.rig.references() == before
        assert servos.state.value in servos.inbox.last_refusal
    assert servos.inbox.forbidden == servos.inbox.refused == 2
    servos.state = motion.ContactorState.OPEN
    assert servos.follows(STRANGER, GOAL)


def test_a_flood_of_refused_messages_does_not_hide_the_leaders(servos: Arm) -> None:
    assert servos.follows(LEADER, GOAL)
    servos.state = motion.ContactorState.ARMED
    other = (trajectory("", (0.0, [0.9] * 3)), STRANGER[1])
    goals = servos.receive((trajectory(LEADER[0], (0.0, START)), LEADER[1]), *[other] * 60)
    assert goals == pytest.approx(list(START), abs=registers.TICK)


@pytest.mark.parametrize("state", [motion.ContactorState.UNKNOWN, motion.ContactorState.CLOSED])
def test_a_hold_is_always_accepted(servos: Arm, state: motion.ContactorState) -> None:
    servos.receive((trajectory(LEADER[0], (60.0, GOAL)), LEADER[1]))
    assert servos.rig.controller._goals.are_moving
    servos.state = state
    servos.receive((trajectory(""), STRANGER[1]))
    assert not servos.rig.controller._goals.are_moving
    assert servos.inbox.refused == 0


HOSTILE: dict[str, Callable[[JointTrajectory], Any]] = {  # each changes a good message, or returns its bytes
    "before 1970": lambda message: setattr(message.header.stamp, "sec", -1),
    "an endless frame_id": lambda message: setattr(message.header, "frame_id", "x" * 5_000_000),
    "no message": lambda message: b"\0\1\0\0" + b"\xff" * 40,
    "no text": lambda message: serialize_message(message).replace(JOINTS[0].encode(), b"\xff" * len(JOINTS[0])),
    "a length beyond the end": lambda message: serialize_message(message)[:12] + struct.pack("<I", 2**32 - 1),
}


@pytest.mark.parametrize("spoil", HOSTILE.values(), ids=HOSTILE)
def test_a_bad_message_is_refused_and_moves_nothing(servos: Arm, spoil: Callable[[JointTrajectory], Any]) -> None:
    message = trajectory("", (2.0, [0.9] * 3))
    spoilt = spoil(message)
    before = servos.rig.references()
    assert servos.receive((message if spoilt is None else spoilt, b"2")) == before
    assert servos.inbox.refused == 1
    assert len(servos.inbox.last_refusal) < 250
    assert servos.follows(STRANGER, GOAL)


def test_a_line_may_last_longer_than_its_stamp_is_valid_despite_refused_messages(servos: Arm) -> None:
    begin = servos.rig.clock()

    def piece(at: float, stamp: float) -> JointTrajectory:
        points = [(at + 0.02 * step, [angle + min(at, 1.0) * 0.2 for angle in START]) for step in (1, 2)]
        message = trajectory(LEADER[0], *points)
        message.header.stamp.sec, message.header.stamp.nanosec = int(stamp), round(stamp % 1 * 1e9)
        return message

    while (at := servos.rig.clock() - begin) < 1.2:
        servos.receive((piece(at, begin), LEADER[1]), (trajectory("", (-1.0, START)), b"2"))
        servos.rig.clock.sleep(0.01)
    end = [angle + 0.2 for angle in START]
    assert servos.receive() == pytest.approx(end, abs=registers.TICK)
    assert "time_from_start" in servos.inbox.last_refusal
    assert servos.receive((piece(0.0, servos.rig.clock() - 0.7), LEADER[1])) == pytest.approx(end, abs=registers.TICK)
    assert "old" in servos.inbox.last_refusal  # another stamp must be fresh


class Reports:
    """A client of the contactor, and what it receives of charger_power."""

    def __init__(self, node: Any, clock: Any) -> None:
        self.clock, self.client = clock, servo_node.ContactorClient(node, clock)

    def receive(self, publisher: bytes, closed: bool, sec: int | None = None, **fields: Any) -> motion.ContactorState:
        self.put(self.message(closed, sec, **fields), publisher)
        return self.client.state()

    def message(self, closed: bool, sec: int | None = None, **fields: Any) -> bytes:
        power = ChargerPower(contactor_closed=closed, **{"probe_age": math.inf, "probe_resistance": 470.0, **fields})
        self.clock.sleep(0.01)
        power.header.stamp.sec, power.header.stamp.nanosec = int(self.clock()), int(self.clock() % 1 * 1e9)
        power.header.stamp.sec = power.header.stamp.sec if sec is None else sec
        return serialize_message(power)

    def put(self, data: bytes, publisher: bytes) -> None:
        topic: Any = self.client._power
        topic.waiting.append(Received(data, publisher, ChargerPower))


@pytest.fixture
def reports(node: Any, clock: Any) -> Reports:
    return Reports(node, clock)


@pytest.mark.parametrize("named", [True, False], ids=["with its id", "as on Jazzy"])
def test_a_report_of_closed_overrides_reports_of_open(reports: Reports, named: bool) -> None:
    board, liar = (b"1", b"2") if named else (b"", b"")
    assert reports.receive(board, closed=True) is motion.ContactorState.CLOSED
    reports.client.request_open()
    for number in range(50):
        if number % 5 == 0:
            reports.receive(board, closed=True)
        state = reports.receive(liar, closed=False, sec=2**31 - 1 if number % 2 else None)
        assert state is motion.ContactorState.CLOSED
        assert not reports.client.is_open()
    reports.clock.sleep(0.2)
    assert reports.receive(board, closed=False) is motion.ContactorState.OPEN
    assert reports.client.is_open()


@pytest.mark.parametrize("board", [b"1", b""], ids=["with its id", "as on Jazzy"])
def test_the_contactor_is_open_only_once_measured_so_without_current_after_the_request(
    reports: Reports, node: Any, board: bytes
) -> None:
    node.count_publishers = lambda name: 1
    reports.receive(board, closed=False)
    reports.client.request_open()
    assert [request.close for request in node.requests] == [False]
    assert not reports.client.is_open()
    reports.receive(board, closed=False, charge_current=3.0)
    assert not reports.client.is_open()
    reports.put(reports.message(closed=False, charge_current=3.0), board)
    reports.put(reports.message(closed=False, charge_current=math.nan), board)  # the contactor alone decides
    assert reports.client.is_open()


def test_the_state_follows_the_reports_and_impossible_ones_are_ignored(reports: Reports) -> None:
    assert reports.client.state() is motion.ContactorState.UNKNOWN  # the service is there
    assert reports.receive(b"1", closed=False) is motion.ContactorState.OPEN
    for ohm in (math.nan, 470.0, math.inf):  # a live port, a dead one, one that may wake
        state = reports.receive(b"1", closed=False, probe_age=0.5, probe_resistance=ohm)
        assert state is motion.ContactorState.ARMED
        assert reports.receive(b"1", closed=False) is motion.ContactorState.OPEN
    for sec in (-1, 2**31 - 1, -(2**31)):
        reports.receive(b"2", closed=False, sec=sec, charge_current=math.nan, probe_age=math.nan)
    for data in (b"\0\1\0\0\xff\xff\xff\xff\xff", b"", bytes(5_000_000)):
        reports.put(data, b"2")
    assert reports.receive(b"2", closed=True, sec=0) is motion.ContactorState.OPEN  # stamped 1970
    for live in ({"closed": True}, {"closed": False, "charge_current": -0.6}, {"closed": False, "fault": 7}):
        assert reports.receive(b"1", closed=False) is motion.ContactorState.OPEN
        assert reports.receive(b"1", **live) is motion.ContactorState.CLOSED  # type: ignore[arg-type]
    reports.clock.sleep(0.3)
    assert reports.client.state() is motion.ContactorState.UNKNOWN
