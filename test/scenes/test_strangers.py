# SPDX-License-Identifier: Apache-2.0
"""Foreign nodes on a simulated charger's topics and services: nothing live moves, and no docking fails."""

from __future__ import annotations

import threading
import time
from array import array
from collections.abc import Iterator
from typing import Any

import pytest
from deltacharger.msg import DockingState
from deltacharger.srv import Probe
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from deltacharger_core.machine import JOINTS
from deltacharger_driver.servos.motion_guard import ContactorState
from deltacharger_ros.client import ChargerClient
from deltacharger_ros.executor import Spinner
from deltacharger_ros.outcomes import DockRequest, Pose
from deltacharger_ros.qos import SERVICE, STATE
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.mocks.mock_servo_node import MockServoNode

from ..chargers import DEADLINE, Spin, dock_at_last, wait_until
from ..nodes import TELLS_PUBLISHERS, options
from ..quick import quick_simulation

pytestmark = pytest.mark.ros

NAMESPACE = "strangers"
GOAL = DockRequest(Pose(0.0, 0.0, 0.080))
DOCKINGS = 5
PULL = 4.0  # N·m of each servo, more than the magnets hold
HOME = (-0.2, -0.2, -0.2)  # rad; far from the target


class Stranger(Node):
    """Publishes arbitrary points on joint_trajectory, and receives the diagnostics about it."""

    def __init__(self, context: Any) -> None:
        super().__init__("stranger", **options(context, NAMESPACE))
        self.messages: list[str] = []
        self.states: list[DockingState] = []
        self._points = self.create_publisher(JointTrajectory, "joint_trajectory", QoSProfile(depth=1))
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.create_subscription(DockingState, "docking_state", self.states.append, STATE)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.messages += [
            status.message for status in message.status if status.name == f"{NAMESPACE}/servo_node: servo bus"
        ]

    def is_connected(self) -> bool:
        return self._points.get_subscription_count() > 0 and bool(self.states)

    def send(self, count: int, frame_id: str = "") -> None:
        """Command the arm away from the target, `count` times, 5 ms apart."""
        message = JointTrajectory(joint_names=list(JOINTS))
        message.header.frame_id = frame_id
        message.points = [JointTrajectoryPoint(positions=array("d", HOME), effort=array("d", [PULL] * 3))]
        for _ in range(count):
            self._points.publish(message)
            time.sleep(0.005)  # the sender's period, not a wait for a condition


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[Composition]:
    with Composition(quick_simulation("simulated"), context, NAMESPACE) as composition:
        yield composition


@pytest.fixture(scope="module")
def client(charger: Composition, context: Any) -> Iterator[ChargerClient]:
    client = ChargerClient(NAMESPACE, context)
    assert client.wait_until_ready(DEADLINE)
    yield client
    client.close()


@pytest.fixture
def stranger(context: Any) -> Iterator[Any]:
    """Create a foreign node on request, and remove it at the end."""
    came: list[Spinner] = []

    def come() -> Stranger:
        stranger = Stranger(context)
        came.append(Spinner(stranger))
        wait_until(stranger.is_connected, "the stranger's discovery")
        return stranger

    yield come
    for spinner in came:
        spinner.close()


def world(charger: Composition) -> Any:
    assert charger.charger is not None
    return charger.charger.world


def test_a_strangers_points_part_no_live_electrodes_and_do_not_end_the_charge(
    charger: Composition, client: ChargerClient, stranger: Any
) -> None:
    dock_at_last(client, GOAL)
    intruder = stranger()
    before = world(charger).snapshot()
    assert before.contactor_closed
    intruder.send(100)
    first = "" if TELLS_PUBLISHERS else f"one of /{NAMESPACE}/docking_node and "
    words = (ContactorState.CLOSED.value, f"sent by {first}/{NAMESPACE}/stranger")
    wait_until(
        lambda: any(all(word in text for word in words) for text in intruder.messages),
        "a diagnostic that names it",
    )
    after = world(charger).snapshot()
    assert after.contactor_closed
    assert max(abs(a - b) for a, b in zip(after.position, before.position, strict=True)) < 0.001
    assert intruder.states[-1].charging
    assert client.undock(deadline=DEADLINE).success
    assert world(charger).record.parted_live == 0
    assert world(charger).record.energised_shorts == 0


class Callers:
    """Calls one service endlessly, from several clients at once."""

    def __init__(self, context: Any, kind: Any, name: str, count: int) -> None:
        self.answers = 0
        self._over = threading.Event()
        self._spinners = [
            Spinner(Node(f"{name}_caller_{index}", **options(context, NAMESPACE))) for index in range(count)
        ]
        self._clients = [spinner.node.create_client(kind, name, qos_profile=SERVICE) for spinner in self._spinners]
        for each in self._clients:
            assert each.wait_for_service(DEADLINE)
            self._call(each)

    def _call(self, client: Any) -> None:
        if not self._over.is_set():
            client.call_async(client.srv_type.Request()).add_done_callback(lambda done: self._answered(client))

    def _answered(self, client: Any) -> None:
        self.answers += 1
        self._call(client)

    def close(self) -> None:
        self._over.set()
        for spinner in self._spinners:
            spinner.close()


@pytest.mark.rest
def test_endless_probes_and_tares_prevent_no_docking(charger: Composition, client: ChargerClient, context: Any) -> None:
    callers = [Callers(context, Probe, "probe", 3), Callers(context, Trigger, "tare", 2)]
    try:
        for _ in range(DOCKINGS):
            dock_at_last(client, GOAL)
            wait_until(lambda: client.undock(deadline=DEADLINE).success, "home")
    finally:
        for each in callers:
            each.close()
    assert all(each.answers > 10 for each in callers)
    assert world(charger).record.parted_live == 0


@pytest.mark.parametrize("sec", [-1, -(2**31), 1, 2**31 - 1])
def test_the_mock_also_refuses_impossible_stamps_and_serves_the_next(
    context: Any, namespace: str, spin: Spin, sec: int
) -> None:
    mock = spin(MockServoNode(**options(context, namespace)))
    sender = spin(Node("sender", **options(context, namespace)))
    points = sender.create_publisher(JointTrajectory, "joint_trajectory", QoSProfile(depth=1))
    wait_until(points.get_subscription_count, "discovery")
    message = JointTrajectory(joint_names=list(JOINTS), points=[JointTrajectoryPoint(positions=array("d", HOME))])
    message.header.stamp.sec = sec
    points.publish(message)
    message.header.stamp.sec = 0

    def followed() -> bool:
        points.publish(message)
        time.sleep(0.01)  # the sender's period
        return bool(mock._goals.angles == HOME)

    wait_until(followed, "the good one's goal")
