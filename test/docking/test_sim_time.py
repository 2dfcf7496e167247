# SPDX-License-Identifier: Apache-2.0
"""use_sim_time with a real /clock: goals are refused before its first message, served at any rate, and end safely.

Control, the contactor's lease and the arm's watchdogs use the monotonic clock; only stamps use /clock.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
from deltacharger.msg import DockingState
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock

from deltacharger_ros.client import ChargerClient
from deltacharger_ros.messages import CODES
from deltacharger_ros.outcomes import DockRequest, Outcome, Pose
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.scene import Scene

from ..chargers import DEADLINE, dock_at_last, new_namespace, wait_until
from ..nodes import options

pytestmark = pytest.mark.ros

GOAL = DockRequest(Pose(0.0, 0.0, 0.080))
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_STEP = 0.01  # s of real time between two messages
_BEGIN = 100.0  # s, simulated
SIM = {"use_sim_time": True}


class Simulator:
    """Publishes /clock as a simulator does.

    Attributes:
        rate: simulated s per real s; 0 = paused: the same time repeatedly.
        now: simulated s.
    """

    def __init__(self, context: Any) -> None:
        self.rate, self.now = 1.0, _BEGIN
        self._node = Node("simulator", **options(context))
        self._publisher = self._node.create_publisher(Clock, "/clock", 1)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        before = time.monotonic()
        while not self._over.wait(_STEP):
            passed, before = time.monotonic() - before, time.monotonic()
            self.now += self.rate * passed
            message = Clock()
            message.clock.sec, message.clock.nanosec = int(self.now), int(self.now % 1.0 * 1e9)
            self._publisher.publish(message)

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self._node.destroy_node()


class Charger:
    """A charger of mocks whose nodes follow /clock, and a client that does not."""

    def __init__(self, scene: Scene, context: Any, **others: dict[str, Any]) -> None:
        given = {name: scene.parameters.get(name, {}) | SIM | others.get(name, {}) for name in scene.nodes}
        self.namespace = new_namespace()
        self.composition = Composition(replace(scene, parameters=given), context, self.namespace).start()
        self.client = ChargerClient(self.namespace, context)
        self.states: list[DockingState] = []
        self.client.node.create_subscription(DockingState, "docking_state", self.states.append, LATCHED)
        assert self.client.wait_until_ready(DEADLINE)

    def dock(self) -> Outcome:
        return self.client.dock(GOAL, deadline=DEADLINE)

    @property
    def is_closed(self) -> bool:
        return bool(self.composition.node("mock_tactile_node").contactor_closed)

    @property
    def node(self) -> Any:
        return self.composition.node("docking_node")

    def time(self) -> float:
        return float(self.node.get_clock().now().nanoseconds) * 1e-9

    def close(self) -> None:
        self.composition.close()
        self.client.close()


@pytest.fixture
def charge(quick_scene: Scene, context: Any) -> Iterator[Callable[..., Charger]]:
    made: list[Charger] = []

    def make(**others: dict[str, Any]) -> Charger:
        made.append(Charger(quick_scene, context, **others))
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.fixture
def simulate(context: Any) -> Iterator[Callable[[], Simulator]]:
    made: list[Simulator] = []

    def make() -> Simulator:
        made.append(Simulator(context))
        return made[-1]

    yield make
    for each in made:
        each.close()


def test_before_the_first_clock_message_a_goal_is_refused_and_afterwards_it_docks(
    charge: Callable[..., Charger], simulate: Callable[[], Simulator]
) -> None:
    charger = charge()
    for outcome in (charger.dock(), charger.client.undock(deadline=DEADLINE)):
        assert (outcome.error_name, outcome.retriable) == ("REJECTED", True), outcome
        assert "use_sim_time" in outcome.error_message
        assert "/clock" in outcome.error_message
    assert not charger.composition.node("mock_servo_node").torque_enabled
    simulate()
    wait_until(lambda: charger.time() >= _BEGIN, "/clock at docking_node")
    dock_at_last(charger.client, GOAL)
    assert charger.is_closed
    assert _BEGIN <= charger.states[-1].header.stamp.sec < _BEGIN + DEADLINE
    assert charger.client.undock(deadline=DEADLINE).success
    assert not charger.is_closed


def test_a_charger_without_any_clock_message_ends_safely(charge: Callable[..., Charger]) -> None:
    charger = charge()
    charger.dock()
    charger.close()
    assert not charger.composition.nodes


@pytest.mark.parametrize("rate", [0.5, 2.0])
def test_it_docks_at_half_and_at_double_rate(
    charge: Callable[..., Charger], simulate: Callable[[], Simulator], rate: float
) -> None:
    simulate().rate = rate
    charger = charge()
    wait_until(lambda: charger.time() >= _BEGIN, "/clock at docking_node")
    dock_at_last(charger.client, GOAL)
    assert charger.is_closed
    time.sleep(1.0)
    assert charger.is_closed, charger.states[-1]


@pytest.mark.parametrize(
    ("change", "reason"), [("pause", "stood still"), ("stop", "stood still"), ("back", "went back by 60")]
)
def test_a_stopped_clock_is_tolerated_or_ends_charging_by_name(
    charge: Callable[..., Charger], simulate: Callable[[], Simulator], change: str, reason: str
) -> None:
    simulator = simulate()
    charger = charge()
    wait_until(lambda: charger.time() >= _BEGIN, "/clock at docking_node")
    dock_at_last(charger.client, GOAL)
    if change == "pause":
        simulator.rate = 0.0
    elif change == "stop":
        simulator.close()
    else:
        simulator.now -= 60.0
        time.sleep(1.0)
    if change != "back":
        wait_until(lambda: not charger.is_closed, "an open contactor", 2.0)
    if charger.is_closed:  # tolerated: stale and fresh data are distinguished after the step as before it
        servos = charger.composition.node("mock_servo_node")
        servos._fault.active = lambda: "silence"
        wait_until(lambda: not charger.is_closed, "an open contactor", 2.0)
        return
    wait_until(lambda: charger.states[-1].error_code, "a code")
    assert CODES[charger.states[-1].error_code] in ("SERVO_FAULT", "TACTILE_STALE", "POWER_STALE", "ESTIMATE_UNSURE")
    assert "/clock, which use_sim_time follows" in charger.states[-1].error_message
    assert reason in charger.states[-1].error_message


@pytest.mark.parametrize("follows", ["docking_node", "mock_servo_node"])
def test_nodes_with_different_clocks_are_named(
    charge: Callable[..., Charger], simulate: Callable[[], Simulator], follows: str
) -> None:
    simulate()
    others = {name: {"use_sim_time": False} for name in charge().composition.scene.nodes if name != follows}
    charger = charge(**others)
    if follows == "docking_node":
        wait_until(lambda: charger.time() >= _BEGIN, "/clock at docking_node")
    outcome = charger.dock()
    assert outcome.error_name == "SERVO_FAULT", outcome
    assert "set use_sim_time for all nodes or for none" in outcome.error_message
    assert not charger.is_closed
