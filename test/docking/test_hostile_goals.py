# SPDX-License-Identifier: Apache-2.0
"""Malformed goals, two clients at once, a client that dies, and goals while the charger ends."""

from __future__ import annotations

import math
import random
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from action_msgs.srv import CancelGoal
from builtin_interfaces.msg import Duration
from deltacharger.action import Dock, Undock
from deltacharger.msg import DockingState
from rclpy.action.client import ActionClient
from rclpy.parameter import Parameter

from deltacharger_core.texts import REQUEST_ID_MAX
from deltacharger_ros import qos
from deltacharger_ros.client import ChargerClient
from deltacharger_ros.messages import CODES
from deltacharger_ros.outcomes import DockRequest, Pose
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.scene import Scene

from ..chargers import DEADLINE, dock_at_last, new_namespace, wait_until
from ..nodes import answer, call, numbers

pytestmark = pytest.mark.ros

PLACE = DockRequest(Pose(0.0, 0.0, 0.080))
NAN, INF, HUGE = math.nan, math.inf, 1e308
EARLY = ("REJECTED", "UNREACHABLE", "CRITICAL_ANGLE")
SEED = 45


class Charger:
    """A charger of mocks, its client, and raw action clients for goals that this client never sends."""

    def __init__(self, scene: Scene, context: Any) -> None:
        self.namespace, self.context = new_namespace(), context
        self.composition = Composition(scene, context, self.namespace).start()
        self.client = ChargerClient(self.namespace, context)
        self.docks: Any = ActionClient(self.client.node, Dock, "dock")
        self.undocks: Any = ActionClient(self.client.node, Undock, "undock")
        self.client.waitables += [self.docks, self.undocks]
        assert self.client.wait_until_ready(DEADLINE)
        assert self.docks.wait_for_server(DEADLINE)
        assert self.undocks.wait_for_server(DEADLINE)

    @property
    def servos(self) -> Any:
        return self.composition.node("mock_servo_node")

    @property
    def is_closed(self) -> bool:
        return bool(self.composition.node("mock_tactile_node").contactor_closed)

    def send(self, goal: Any) -> Any:
        """Send a goal and return its handle; every goal is accepted."""
        client = self.docks if isinstance(goal, Dock.Goal) else self.undocks
        handle = answer(answer(self.client.node.executor.call_soon(client.send_goal_async, goal)))
        assert handle.accepted
        return handle

    def result(self, goal: Any) -> Any:
        """Send a goal and return its result."""
        return answer(self.send(goal).get_result_async()).result

    def close(self) -> None:
        self.composition.close()
        self.client.close()


@pytest.fixture(scope="module")
def charger(quick_scene: Scene, context: Any) -> Iterator[Charger]:
    charger = Charger(quick_scene, context)
    yield charger
    charger.close()


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.080, frame: str = "charger_base", **turn: float) -> Dock.Goal:
    goal = Dock.Goal()
    goal.electrodes.header.frame_id = frame
    goal.electrodes.pose.position.x, goal.electrodes.pose.position.y, goal.electrodes.pose.position.z = x, y, z
    for name, value in turn.items():
        setattr(goal.electrodes.pose.orientation, name, value)
    return goal


def with_fields(**fields: Any) -> Dock.Goal:
    goal = pose()
    for name, value in fields.items():
        setattr(goal, name, value)
    return goal


LEANING = math.sqrt(0.5)
WRONG = {
    "NaN place": pose(x=NAN),
    "endless place": pose(z=INF),
    "huge place": pose(x=HUGE, y=-HUGE, z=HUGE),
    "huge place in the robot's frame": pose(x=HUGE, y=-HUGE, z=HUGE, frame="base_link"),
    "unknown frame": pose(frame="the_moon"),
    "blank frame": pose(frame=" "),
    "frame with a newline": pose(frame="charger_base\n"),
    "endless frame": pose(frame="charger_base" * 10_000),
    "no orientation": pose(w=0.0),
    "NaN orientation": pose(w=NAN),
    "endless orientation": pose(w=INF),
    "orientation too long to be normed": pose(z=0.080, x=0.0, y=0.0, w=HUGE),
    "tiny orientation": pose(w=1e-200),
    "NaN critical angle": with_fields(critical_angle=NAN),
    "negative critical angle": with_fields(critical_angle=-1e-300),
    "larger critical angle": with_fields(critical_angle=0.3),
    "NaN energy": with_fields(stop_energy=NAN),
    "endless energy": with_fields(stop_energy=INF),
    "negative energy": with_fields(stop_energy=-1.0),
    "negative duration": with_fields(stop_after=Duration(sec=-1)),
    "negative seconds and four of nanoseconds less one": with_fields(
        stop_after=Duration(sec=-5, nanosec=4_000_000_000)
    ),
    "request_id of 257 characters": with_fields(request_id="x" * 257),
    "smallest duration": with_fields(stop_after=Duration(sec=-(2**31))),
}
WRONG["orientation too long to be normed"].electrodes.pose.orientation.z = HUGE
LEANS = pose(y=0.0)
LEANS.electrodes.pose.orientation.y, LEANS.electrodes.pose.orientation.w = LEANING, LEANING
WRONG["facing sideways"] = LEANS  # turned by a quarter about y the terminal's bars have no roll about z at all


@pytest.mark.parametrize("goal", WRONG.values(), ids=WRONG)
def test_an_impossible_goal_is_refused_before_anything_moves(charger: Charger, goal: Dock.Goal) -> None:
    before = charger.servos.position
    result = charger.result(goal)
    assert not result.success
    assert CODES[result.error_code] in EARLY, result.error_message
    assert 0 < len(result.error_message) < 1000, "a person reads it"
    assert charger.servos.position == before
    assert not charger.servos.torque_enabled
    assert all(map(math.isnan, numbers(result.misalignment)))
    assert all(map(math.isnan, (result.contact_current, result.contact_force, result.charge_current)))
    assert result.energy == 0.0, "counted, and none flowed"
    assert not result.suggested_base_pose.header.frame_id or CODES[result.error_code] == "UNREACHABLE"


def test_a_goal_that_fails_before_measuring_reports_nothing_of_an_earlier_docking(charger: Charger) -> None:
    docked = dock_at_last(charger.client, PLACE)
    assert not math.isnan(docked.details["misalignment"]["vertical"])
    assert charger.client.undock(deadline=DEADLINE).success
    mock = charger.composition.node("mock_servo_node")
    mock.set_parameters([Parameter("fault", value="hardware_error")])
    try:
        result = charger.result(pose())
    finally:
        mock.set_parameters([Parameter("fault", value="none")])
        mock.reboot()
    assert CODES[result.error_code] == "SERVO_FAULT"
    assert all(map(math.isnan, numbers(result.misalignment)))
    assert result.alignments == result.redockings == 0


def random_goal(source: random.Random) -> Any:
    if source.random() < 0.1:
        return Undock.Goal(request_id=source.choice(("", "x" * 200, "\x00", "ä\U0001f50c")))
    numbers = (0.0, 1.0, -1.0, 0.080, 1e-300, HUGE, -HUGE, NAN, INF, -INF)
    goal = pose(*(source.choice(numbers) for _ in range(3)), frame=source.choice(("charger_base", "base_link", "x")))
    goal.electrodes.pose.position.x = source.choice((NAN, INF, HUGE, 5.0))  # never a goal that moves the arm
    for name in "xyzw":
        setattr(goal.electrodes.pose.orientation, name, source.choice(numbers))
    goal.critical_angle, goal.stop_energy = source.choice(numbers), source.choice(numbers)
    goal.stop_after = Duration(sec=source.choice((0, -1, -(2**31), 2**31 - 1)), nanosec=source.choice((0, 2**32 - 1)))
    goal.hold, goal.start_charging = source.random() < 0.5, source.random() < 0.5
    goal.request_id = source.choice(("", "r", "x" * 10_000, "\x00\n\x7f"))
    return goal


def test_fifty_wrong_goals_at_once_are_each_answered(charger: Charger) -> None:
    source = random.Random(SEED)
    goals = [random_goal(source) for _ in range(50)]
    handles = [charger.send(goal) for goal in goals]
    results = [answer(handle.get_result_async()).result for handle in handles]
    for goal, result in zip(goals, results, strict=True):
        if isinstance(goal, Dock.Goal):
            assert CODES[result.error_code] in EARLY, (goal, result.error_message)
        assert result.success or result.error_message
    assert not charger.servos.torque_enabled


def test_a_request_id_of_ten_megabytes_is_refused_and_not_repeated(charger: Charger) -> None:
    states: list[DockingState] = []
    subscription = charger.client.node.create_subscription(DockingState, "docking_state", states.append, qos.STATE)
    for goal in (with_fields(request_id="x" * 10_000_000), Undock.Goal(request_id="x" * 10_000_000)):
        result = charger.result(goal)
        assert CODES[result.error_code] == "REJECTED"
        assert "request_id" in result.error_message
        assert len(result.error_message) < 1000
    longest = "y" * REQUEST_ID_MAX
    assert charger.client.undock(longest, deadline=DEADLINE).success
    wait_until(lambda: states and states[-1].request_id == longest, "the longest id that is taken")
    assert max(len(state.request_id) for state in states) == REQUEST_ID_MAX
    charger.client.node.destroy_subscription(subscription)


def cancel_all(charger: Charger, action: str) -> Any:
    """Cancel every goal of an action, as a client may do that lost its own goal."""
    service = charger.client.node.create_client(CancelGoal, f"{action}/_action/cancel_goal")
    assert service.wait_for_service(DEADLINE)
    response = call(service, CancelGoal.Request())
    service.destroy()
    return response


def test_two_clients_at_once(charger: Charger) -> None:
    """The second gets the error that another goal is served, with the same action or not; it may cancel the first."""
    with ChargerClient(charger.namespace, charger.context) as other:
        began = threading.Event()
        first: list[Any] = []
        goal = DockRequest(PLACE.electrodes, request_id="same", hold=True)
        thread = threading.Thread(
            target=lambda: first.append(charger.client.dock(goal, lambda progress: began.set(), deadline=DEADLINE))
        )
        thread.start()
        assert began.wait(DEADLINE)
        for outcome in (other.dock(goal, deadline=DEADLINE), other.undock("same", deadline=DEADLINE)):
            assert (outcome.error_name, outcome.retriable) == ("REJECTED", True), outcome
            assert "another goal" in outcome.error_message
        assert not first, "the first is not disturbed"
        assert cancel_all(charger, "undock").goals_canceling == []
        assert len(cancel_all(charger, "dock").goals_canceling) == 1
        thread.join(DEADLINE)
        assert first[0].error_name == "CANCELED", first
        assert not charger.is_closed
        dock_at_last(other, PLACE)
        assert charger.is_closed
        assert charger.client.undock(deadline=DEADLINE).success


_DYING = """
import os, sys, threading
from deltacharger_core import environment
environment.prepare()
from deltacharger_ros.client import ChargerClient
from deltacharger_ros.outcomes import DockRequest, Pose
client = ChargerClient(sys.argv[1])
assert client.wait_until_ready(30.0)
def die(progress):
    if progress.phase == "charging":
        os._exit(9)
client.dock(DockRequest(Pose(0.0, 0.0, 0.080), hold=True), die)
"""


def test_the_goal_of_a_dead_client_continues_and_another_may_end_it(charger: Charger) -> None:
    """Charging continues under supervision; the next client gets an error, cancels the orphaned goal, and is served."""
    command = [sys.executable, "-c", _DYING, charger.namespace]
    # If a stalled mock spoils an estimate, that client's goal ends without charging.
    wait_until(lambda: subprocess.run(command, timeout=DEADLINE, check=False).returncode == 9, "a client that dies")
    assert charger.is_closed
    assert charger.client.undock(deadline=DEADLINE).error_name == "REJECTED"
    assert charger.is_closed
    assert len(cancel_all(charger, "dock").goals_canceling) == 1
    wait_until(lambda: not charger.is_closed, "an open contactor")
    wait_until(lambda: charger.client.undock(deadline=DEADLINE).success, "the arm home")
    assert not charger.servos.torque_enabled


def test_goals_while_the_charger_ends_are_answered(quick_scene: Scene, context: Any) -> None:
    """One runs, others arrive while docking_node closes: the contactor opens; each result has a code and a reason."""
    charger = Charger(quick_scene, context)
    try:
        docking, results = charger.composition.node("docking_node"), []
        running = charger.send(pose())
        running_result = running.get_result_async()
        closing = threading.Thread(target=docking.close)
        closing.start()
        while closing.is_alive():
            results.append(charger.result(pose()))
        closing.join(DEADLINE)
        results += [charger.result(pose()), charger.result(Undock.Goal()), answer(running_result).result]
        for result in results:
            assert not result.success
            assert CODES[result.error_code] in ("REJECTED", "CANCELED"), result.error_message
            assert result.error_message
        assert "shutting down" in results[-2].error_message
        assert results[-2].retriable
        assert not charger.is_closed
        assert not charger.servos.torque_enabled
    finally:
        charger.close()
