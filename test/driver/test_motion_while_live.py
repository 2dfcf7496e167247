# SPDX-License-Identifier: Apache-2.0
"""servo_node with a power stage controlled by the test: whose trajectories it follows, and what it survives."""

from __future__ import annotations

import math
import struct
import threading
import time
from array import array
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from deltacharger.msg import ChargerPower
from deltacharger.srv import SetContactor
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from deltacharger_core.machine import JOINTS
from deltacharger_driver.emulators.bench_arm import BenchArm
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.servos.motion_guard import ContactorState
from deltacharger_driver.servos.mx64 import TICK
from deltacharger_driver.servos.servo_node import ServoNode
from deltacharger_driver.servos.servo_node_io import ContactorClient
from deltacharger_ros import bounded_topic
from deltacharger_ros.executor import Spinner

from ..chargers import Spin, new_namespace
from ..nodes import TELLS_PUBLISHERS, options
from ..waiting import wait_until

pytestmark = pytest.mark.ros

START = (-0.7, -0.5, 0.2)  # of `arm`
SECRET = "a" * 32
RELIABLE = QoSProfile(depth=1)


class PowerStage(Node):
    """Publishes charger_power 20 times a second while `speaks`; its content may be set."""

    def __init__(self, context: Any, namespace: str) -> None:
        super().__init__("power_stage", **options(context, namespace))
        self.closed, self.speaks = False, threading.Event()
        self.probe_age = math.inf
        self._powers = self.create_publisher(ChargerPower, "charger_power", RELIABLE)
        self.create_timer(0.05, self.publish_power)

    def publish_power(self) -> None:
        if self.speaks.is_set():
            power = ChargerPower(contactor_closed=self.closed, probe_age=self.probe_age, probe_resistance=470.0)
            power.header.stamp = self.get_clock().now().to_msg()
            self._powers.publish(power)


class Sender(Node):
    """Sends trajectories, and receives servo_node's diagnostics about them."""

    def __init__(self, context: Any, namespace: str, name: str, secret: str = "") -> None:
        super().__init__(name, **options(context, namespace))
        self.secret = secret
        self.values: dict[str, str] = {}
        self.diagnostics: list[str] = []
        self.points = self.create_publisher(JointTrajectory, "joint_trajectory", RELIABLE)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == f"{self.get_namespace()}/servo_node: servo bus".lstrip("/"):
                self.diagnostics.append(status.message)
                self.values = {value.key: value.value for value in status.values}

    def message(self, *points: tuple[float, Any]) -> JointTrajectory:
        message = JointTrajectory(joint_names=list(JOINTS))
        message.header.frame_id = self.secret
        for seconds, angles in points:
            point = JointTrajectoryPoint(positions=array("d", angles))
            point.time_from_start.sec, point.time_from_start.nanosec = int(seconds), int(seconds % 1 * 1e9)
            message.points.append(point)
        return message

    def send(self, *points: tuple[float, Any]) -> None:
        self.points.publish(self.message(*points))


class Charger:
    """servo_node with torque, a power stage, the leader and a stranger."""

    def __init__(self, context: Any, path: str, arm: BenchArm, spin: Callable[[Any], Any]) -> None:
        self.arm, self.namespace, self._context, self._spin = arm, new_namespace(), context, spin
        self.node = spin(ServoNode(**options(context, self.namespace, port=path)))
        self.leader = self.sender("leader", SECRET)
        self.stranger = self.sender("stranger")
        answer = self.node._ask("torque_on", type("Answer", (), {})())
        assert answer.success, answer.message

    def sender(self, name: str, secret: str = "") -> Sender:
        sender = self._spin(Sender(self._context, self.namespace, name, secret))
        wait_until(lambda: sender.points.get_subscription_count(), "servo_node's discovery")
        return sender

    def power_stage(self, speaks: bool = True) -> PowerStage:
        stage = self._spin(PowerStage(self._context, self.namespace))
        if speaks:
            stage.speaks.set()
        wait_until(lambda: stage._powers.get_subscription_count(), "servo_node's discovery")
        return stage

    def becomes(self, state: ContactorState) -> None:
        wait_until(lambda: self.node._contactor_state is state, state.name)

    def goals(self) -> list[float]:
        return [command[1] for command in self.arm.commands]

    def goes_to(self, angles: Any, sender: Sender) -> None:
        """Send repeatedly, as docking does, until the servos have the goal."""

        def there() -> bool:
            sender.send((0.0, angles))
            time.sleep(0.01)  # the sender's pace
            return self.goals() == pytest.approx(list(angles), abs=TICK)

        wait_until(there, f"the arm at {angles}")

    def refuses(self, sender: Sender, state: ContactorState) -> None:
        """Check that trajectories are refused, the sender is named, and nothing moves."""
        before = self.goals()
        sender.diagnostics.clear()

        def is_refused() -> bool:
            sender.send((0.0, [angle + 0.3 for angle in START]))
            time.sleep(0.01)  # the sender's pace
            named = self.namespace_of(sender) if TELLS_PUBLISHERS else f"one of {self.namespace_of(self.leader)} and "
            return any(state.value in text and f"sent by {named}" in text for text in list(sender.diagnostics))

        wait_until(is_refused, "a refusal")
        assert self.goals() == before

    def namespace_of(self, sender: Sender) -> str:
        return f"/{self.namespace}/{sender.get_name()}"


@pytest.fixture
def charger(context: Any, terminal: PseudoTerminal, arm: BenchArm) -> Iterator[Charger]:
    running: list[Spinner] = []

    def spin(node: Any) -> Any:
        running.append(Spinner(node))
        return node

    yield Charger(context, terminal.path, arm, spin)
    for spinner in reversed(running):
        spinner.close()


def test_the_arm_moves_for_no_sender_while_the_contactor_is_closed_and_for_any_once_open(charger: Charger) -> None:
    stage = charger.power_stage()
    charger.becomes(ContactorState.OPEN)
    charger.goes_to([angle + 0.1 for angle in START], charger.leader)
    stage.closed = True
    charger.becomes(ContactorState.CLOSED)
    for sender in (charger.leader, charger.stranger):
        charger.refuses(sender, ContactorState.CLOSED)
    stage.closed = False
    charger.goes_to(START, charger.leader)  # its first piece may arrive before servo_node knows of the opening
    charger.goes_to([angle + 0.1 for angle in START], charger.stranger)


def test_a_running_line_becomes_a_hold_when_the_contactor_closes(charger: Charger) -> None:
    stage = charger.power_stage()
    charger.becomes(ContactorState.OPEN)
    end = [angle + 0.4 for angle in START]
    charger.stranger.send((60.0, end))
    wait_until(lambda: charger.goals()[0] > START[0] + TICK, "a running line")
    stage.closed = True
    charger.becomes(ContactorState.CLOSED)
    wait_until(lambda: not charger.node._controller._goals.are_moving, "the hold")
    stage.closed = False
    charger.becomes(ContactorState.OPEN)
    assert not charger.node._controller._goals.are_moving  # nor does it continue
    assert max(charger.goals()) < max(end) - 0.1


@pytest.mark.parametrize("armed", [True, False], ids=["about to close", "unknown"])
def test_only_the_leader_moves_the_arm_while_the_contactor_may_be_closed(charger: Charger, armed: bool) -> None:
    stage = charger.power_stage()
    charger.becomes(ContactorState.OPEN)
    charger.goes_to([angle + 0.1 for angle in START], charger.leader)
    if armed:
        stage.probe_age = 0.5
        charger.becomes(ContactorState.ARMED)
    else:
        stage.speaks.clear()
        charger.becomes(ContactorState.UNKNOWN)
    state = ContactorState.ARMED if armed else ContactorState.UNKNOWN
    charger.refuses(charger.stranger, state)
    if TELLS_PUBLISHERS:
        charger.refuses(charger.sender("thief", SECRET), state)  # a sender that copied the secret is another publisher
    over = threading.Event()

    def flood() -> None:
        message = charger.stranger.message((0.0, [angle + 0.3 for angle in START]))
        while not over.wait(0.0005):
            charger.stranger.points.publish(message)

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        charger.goes_to(START, charger.leader)
    finally:
        over.set()
        thread.join()
    assert charger.goals() == pytest.approx(list(START), abs=TICK)


def test_a_silent_power_stage_holds_the_arm_until_it_publishes(charger: Charger) -> None:
    charger.goes_to([angle + 0.1 for angle in START], charger.stranger)  # without a power stage
    stage = charger.power_stage(speaks=False)
    charger.becomes(ContactorState.UNKNOWN)
    charger.refuses(charger.leader, ContactorState.UNKNOWN)
    stage.speaks.set()
    charger.goes_to(START, charger.leader)


def test_a_hold_is_always_accepted(charger: Charger) -> None:
    stage = charger.power_stage()
    charger.becomes(ContactorState.OPEN)
    charger.leader.send((60.0, [angle + 0.4 for angle in START]))
    wait_until(lambda: charger.goals()[0] > START[0] + TICK, "a running line")
    stage.speaks.clear()
    charger.becomes(ContactorState.UNKNOWN)
    assert charger.node._controller._goals.are_moving
    charger.stranger.send()
    wait_until(lambda: not charger.node._controller._goals.are_moving, "the hold")


def hostile() -> dict[str, Callable[[JointTrajectory], Any]]:
    """Return faults of a message by name; each changes a good message, or returns its bytes."""

    def stamped(sec: int, nanosec: int) -> Callable[[JointTrajectory], None]:
        def change(message: JointTrajectory) -> None:
            message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec

        return change

    def named(*names: str) -> Callable[[JointTrajectory], None]:
        return lambda message: setattr(message, "joint_names", list(names))

    def pointed(**fields: Any) -> Callable[[JointTrajectory], None]:
        def change(message: JointTrajectory) -> None:
            for name, value in fields.items():
                setattr(message.points[0], name, value)

        return change

    def many(message: JointTrajectory) -> None:
        message.points = message.points * 1001

    def earlier(message: JointTrajectory) -> None:
        message.points[0].time_from_start.sec = -(2**31)

    def framed(message: JointTrajectory) -> None:
        message.header.frame_id = "x" * 5_000_000

    nan = math.nan
    return {
        "before 1970": stamped(-1, 0),
        "long before": stamped(-(2**31), 0),
        "long ago": stamped(1, 0),
        "far ahead": stamped(2**31 - 1, 2**32 - 1),
        "1001 points": many,
        "an endless name": named("x" * 100_000, *JOINTS[1:]),
        "5 MB of names": named(*["x" * 1000] * 5000),
        "one joint": named(JOINTS[0]),
        "one joint often": named(*JOINTS, *[JOINTS[0]] * 1000),
        "an endless frame_id": framed,
        "NaN": pointed(positions=array("d", [nan] * 3)),
        "infinite": pointed(positions=array("d", [math.inf] * 3)),
        "no angles": pointed(positions=array("d")),
        "a million angles": pointed(positions=array("d", [0.0] * 1_000_000)),
        "NaN effort": pointed(effort=array("d", [nan] * 3)),
        "negative effort": pointed(effort=array("d", [-1.0] * 3)),
        "a negative time": earlier,
        "no message": lambda message: b"\0\1\0\0" + b"\xff" * 40,
        "half a message": lambda message: serialize_message(message)[:60],
        "no bytes": lambda message: b"\0\1\0\0",
        "no text": lambda message: serialize_message(message).replace(JOINTS[0].encode(), b"\xff" * len(JOINTS[0])),
        "a length beyond the end": lambda message: serialize_message(message)[:12] + struct.pack("<I", 2**32 - 1),
    }


def test_no_bad_message_ends_the_servo_thread_or_moves_the_arm(charger: Charger) -> None:
    sender, inbox = charger.stranger, charger.node._inbox
    for number, (name, spoil) in enumerate(hostile().items()):
        before = charger.goals()
        refused = inbox.refused
        message = sender.message((0.0, [0.9] * 3))
        spoilt = spoil(message)
        sender.points.publish(message if spoilt is None else spoilt)
        wait_until(lambda refused=refused: inbox.refused > refused, f"a refusal of {name}")
        assert len(inbox.last_refusal) < 250, name
        assert charger.goals() == before, name
        charger.goes_to([angle + 0.1 * (number % 2) for angle in START], sender)
    wait_until(lambda: int(sender.values.get("refused_trajectories", 0)) >= len(hostile()), "the count in diagnostics")
    assert charger.node._thread.is_alive()
    assert charger.arm.torque_enabled() == [True] * 3


def test_a_line_continues_despite_refused_messages(charger: Charger) -> None:
    """A piece of a line may be older than a valid stamp; other messages must not make it count as a new line."""
    stamp = charger.leader.get_clock().now().to_msg()
    begin = time.monotonic()

    def fed() -> bool:
        now = time.monotonic() - begin
        message = charger.leader.message(
            *((now + 0.02 * step, [a + min(now, 1.0) * 0.2 for a in START]) for step in (1, 2))
        )
        message.header.stamp = stamp
        charger.leader.points.publish(message)
        charger.stranger.points.publish(charger.stranger.message((-1.0, START)))
        time.sleep(0.01)  # the feeder's pace
        return now > 1.1

    wait_until(fed)
    wait_until(lambda: charger.goals() == pytest.approx([angle + 0.2 for angle in START], abs=TICK), "the line's end")


def test_impossible_reports_of_the_power_stage_do_not_end_the_node(charger: Charger, spin: Spin, context: Any) -> None:
    charger.power_stage()
    charger.becomes(ContactorState.OPEN)
    liar = spin(Node("liar", **options(context, charger.namespace)))
    powers = liar.create_publisher(ChargerPower, "charger_power", RELIABLE)
    wait_until(lambda: powers.get_subscription_count(), "discovery")
    for sec, frame_id in ((-1, ""), (2**31 - 1, ""), (-(2**31), ""), (0, "x" * 5_000_000)):
        power = ChargerPower(charge_current=math.nan, probe_age=math.nan)
        power.header.stamp.sec, power.header.frame_id = sec, frame_id
        powers.publish(power)
        powers.publish(b"\0\1\0\0\xff\xff\xff\xff\xff")
    charger.goes_to([angle + 0.1 for angle in START], charger.leader)
    powers.publish(ChargerPower(contactor_closed=True))  # stamped 1970: ignored
    charger.goes_to(START, charger.leader)


@pytest.mark.parametrize("named", [True, False], ids=["with its id", "as on Jazzy"])
def test_a_report_of_closed_overrides_reports_of_open(
    context: Any, namespace: str, spin: Spin, monkeypatch: pytest.MonkeyPatch, named: bool
) -> None:
    if not named:
        monkeypatch.setattr(bounded_topic, "_publisher", lambda info: b"")
    stage = spin(PowerStage(context, namespace))
    stage.create_service(SetContactor, "set_contactor", lambda request, response: response)
    stage.closed = True
    stage.speaks.set()
    subject = ContactorClient(spin(Node("subject", **options(context, namespace))))
    liar = spin(Node("liar", **options(context, namespace)))
    powers = liar.create_publisher(ChargerPower, "charger_power", RELIABLE)
    wait_until(lambda: powers.get_subscription_count() and subject._client.service_is_ready(), "discovery")
    wait_until(lambda: subject.state() is ContactorState.CLOSED, "the power stage's report")
    subject.request_open()
    for number in range(100):
        power = ChargerPower(probe_age=math.inf)
        power.header.stamp = liar.get_clock().now().to_msg()
        if number % 2:
            power.header.stamp.sec = 2**31 - 1
        powers.publish(power)
        time.sleep(0.01)  # the false publisher's pace
        assert not subject.is_open()
        assert subject.state() is not ContactorState.OPEN
    stage.closed = False
    wait_until(subject.is_open, "the opening")
