# SPDX-License-Identifier: Apache-2.0
"""mission_node over real topics, actions and services: charged and home, or a code and home.

The real docking_node docks on mocks. The laws are in test/mission/test_mission.py, in virtual time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from deltacharger.action import ChargeRobot
from rclpy.action.client import ActionClient
from rclpy.node import Node
from rclpy.parameter import Parameter

from deltacharger_bringup.scenes.composition import Composition
from deltacharger_bringup.scenes.scene import Scene, load_scene
from deltacharger_core.ros import executor, messages
from deltacharger_docking.mission import dialogue, places
from deltacharger_docking.mission.ros.others import fill_pose

from ..chargers import Spin, new_namespace, wait_until
from ..nodes import answer, options
from ..transforms import Robot as Broadcaster

pytestmark = pytest.mark.ros

WITHOUT_NAVIGATION = "nav2_msgs is not installed: it comes with Nav2, or `make navigation` builds a stand-in"
TARGET = places.Place(1.0, 0.0, math.pi)
HOME = places.Place(-1.0, 0.0, 0.0)
REAL = Path(__file__).with_name("mission.yaml")


class ActiveGoal:
    """A running ChargeRobot goal: its stages as reported, and its result."""

    def __init__(self, call_soon: Callable[..., Any], client: Any, goal: ChargeRobot.Goal) -> None:
        self.stages: list[dialogue.Stage] = []
        sent = call_soon(client.send_goal_async, goal, feedback_callback=self._on_feedback)
        self._handle = answer(answer(sent))
        self._result = self._handle.get_result_async()

    def _on_feedback(self, message: Any) -> None:
        stage = dialogue.Stage(message.feedback.stage)
        if self.stages[-1:] != [stage]:
            self.stages.append(stage)

    def reach(self, stage: dialogue.Stage) -> None:
        wait_until(lambda: stage in self.stages or self._result.done(), f"{stage.name} in {self.stages}")
        assert stage in self.stages, self.end()

    def cancel(self) -> Any:
        """Cancel the goal and return its result."""
        self._handle.cancel_goal_async()
        return self.end()

    def end(self) -> Any:
        return answer(self._result).result


class Robot:
    """The charging robot under test and a client of its mission."""

    def __init__(self, scene: Scene, context: Any) -> None:
        namespace = new_namespace()
        self.composition = Composition(scene, context, namespace).start()
        self.node = self.composition.node
        client_node = Node("mission_client", **options(context, namespace))
        self._client: ActionClient[Any, Any, Any] = ActionClient(client_node, ChargeRobot, "charge_robot")
        self._spinner = executor.Spinner(client_node)
        wait_until(self._client.server_is_ready, "charge_robot")

    def send(
        self, request_id: str = "", stop_after: float = 0.2, frame: str = "map", at: places.Place = TARGET
    ) -> ActiveGoal:
        goal = ChargeRobot.Goal(request_id=request_id, stop_after=messages.duration(stop_after))
        fill_pose(goal.target, replace(at, frame=frame))
        return ActiveGoal(self._spinner.call_soon, self._client, goal)

    def set(self, node: str, fault: str) -> None:
        found = self.node(node).set_parameters([Parameter("fault", value=fault)])[0]
        assert found.successful, found.reason

    @property
    def place(self) -> places.Place:
        found: places.Place = self.node("mock_navigator_node").place
        return found

    def close(self) -> None:
        self.composition.close()
        self._spinner.close(self._client)


@pytest.fixture
def made(context: Any) -> Iterator[Callable[[Scene], Robot]]:
    pytest.importorskip("nav2_msgs", reason=WITHOUT_NAVIGATION)
    robots: list[Robot] = []

    def make(scene: Scene) -> Robot:
        robots.append(Robot(scene, context))
        return robots[-1]

    yield make
    for robot in robots:
        robot.close()


def named(result: Any) -> tuple[bool, str, bool]:
    """Return success, the code's name and whether it returned."""
    return result.success, messages.CODES[result.error_code], result.returned


@pytest.mark.witness
def test_it_drives_moves_nearer_docks_charges_and_comes_home(made: Callable[[Scene], Robot]) -> None:
    """With the real docking_node, which refuses the first stand as out of reach."""
    robot = made(load_scene(REAL))
    robot.set("mock_detector_node", "beyond_reach")
    arrived = robot.node("mock_navigator_node").arrived
    active = robot.send(request_id="r1", stop_after=0.5)
    wait_until(lambda: len(arrived) > 1, "a second stand")
    robot.set("mock_detector_node", "none")
    result = active.end()
    assert named(result) == (True, "NONE", True), result
    assert result.energy > 0.0
    assert set(active.stages) == set(dialogue.Stage)
    assert active.stages[-4:] == [
        dialogue.Stage.DOCK,
        dialogue.Stage.CHARGE,
        dialogue.Stage.UNDOCK,
        dialogue.Stage.RETURN,
    ]
    first, second = arrived[:2]
    assert (first.x, first.y) == pytest.approx((1.0 - 0.2, 0.0), abs=1e-6), "before a target at x = 1 that faces −x"
    assert second.x - first.x == pytest.approx(0.5 - 0.08, abs=1e-6), "it came nearer by what was missing"
    assert robot.place == HOME
    assert not robot.node("mock_tactile_node").contactor_closed


@pytest.mark.rest
def test_the_base_pose_follows_the_charger_mount_in_tf(
    made: Callable[[Scene], Robot], context: Any, spin: Spin
) -> None:
    broadcaster = spin(Broadcaster(context))
    broadcaster.fix("base_link", "charger_base", (0.25, 0.0, 0.4, 0.5, 0.5, 0.5, 0.5))
    robot = made(load_scene(REAL))
    active = robot.send()
    first = wait_until(lambda: robot.node("mock_navigator_node").arrived, "the first stand")[0]
    assert first.x == pytest.approx(TARGET.x - 0.25 - 0.2, abs=1e-6), "view_distance before it"
    active.cancel()


@pytest.mark.rest
def test_closing_mission_node_ends_charging_and_its_goal_and_drives_nowhere(made: Callable[[Scene], Robot]) -> None:
    robot = made(load_scene(REAL))
    active = robot.send(stop_after=100.0)
    active.reach(dialogue.Stage.CHARGE)
    stood = robot.place
    robot.node("mission_node").close()
    result = active.end()
    assert named(result) == (False, "CANCELED", False), result
    assert "undock before you drive it" in result.error_message
    assert messages.seconds(result.elapsed) > 0.5
    assert result.energy > 0.0
    wait_until(lambda: not robot.node("mock_tactile_node").contactor_closed, "an open contactor")
    assert robot.place == stood


@pytest.mark.rest
def test_after_a_defect_the_node_is_free(made: Callable[[Scene], Robot], monkeypatch: pytest.MonkeyPatch) -> None:
    robot = made(load_scene(REAL))
    machine = robot.node("mission_node")._machine
    begins = machine.start

    def fail(*words: Any) -> None:
        monkeypatch.undo()
        begins(*words)
        raise RuntimeError("a defect at the beginning")

    monkeypatch.setattr(machine, "start", fail)
    result = robot.send().end()
    assert named(result) == (False, "INTERNAL", False)
    assert not machine.busy, "it drives without a client"
    active = robot.send()
    active.reach(dialogue.Stage.DRIVE)
    active.cancel()
