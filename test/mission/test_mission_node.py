# SPDX-License-Identifier: Apache-2.0
"""mission_node over real topics, actions and services: charged and home, or a code and home.

One mission uses the real docking_node on mocks; the others a node that has only docking_node's interface. The laws are
in test/mission/test_mission.py, in virtual time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from deltacharger.action import ChargeRobot
from deltacharger.msg import DockingState
from rclpy.action.client import ActionClient
from rclpy.node import Node
from rclpy.parameter import Parameter

from deltacharger_core.yaml_file import read_yaml
from deltacharger_mission.dialogue import Stage
from deltacharger_mission.places import Place
from deltacharger_mission.ros.others import fill_pose
from deltacharger_ros.executor import Spinner
from deltacharger_ros.messages import CODES, duration, seconds
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.scene import Scene, load_scene, parse_scene

from ..chargers import Process, Spin, new_namespace, wait_until
from ..docking.mock_docking import MockDocking
from ..nodes import options
from ..running_charger import node_command
from ..transforms import Robot as Broadcaster

pytestmark = pytest.mark.ros

WITHOUT_NAVIGATION = "nav2_msgs is not installed: it comes with Nav2, or `make navigation` builds a stand-in"
TARGET = Place(1.0, 0.0, math.pi)
HOME = Place(-1.0, 0.0, 0.0)
REAL = Path(__file__).with_name("mission.yaml")


class ActiveGoal:
    """A running ChargeRobot goal: its stages as reported, and its result."""

    def __init__(self) -> None:
        self.stages: list[Stage] = []
        self.result: Any = None
        self._handle: Any = None

    def send(self, client: ActionClient[Any, Any, Any], goal: ChargeRobot.Goal) -> None:
        sent = client.send_goal_async(goal, feedback_callback=self._on_feedback)
        sent.add_done_callback(self._on_response)

    def _on_feedback(self, message: Any) -> None:
        stage = Stage(message.feedback.stage)
        if self.stages[-1:] != [stage]:
            self.stages.append(stage)

    def _on_response(self, future: Any) -> None:
        self._handle = future.result()
        self._handle.get_result_async().add_done_callback(self._on_result)

    def _on_result(self, future: Any) -> None:
        self.result = future.result().result

    def reach(self, stage: Stage) -> None:
        wait_until(lambda: stage in self.stages or self.result, f"{stage.name} in {self.stages}")
        assert stage in self.stages, self.result

    def cancel(self) -> Any:
        """Cancel the goal and return its result."""
        wait_until(lambda: self._handle is not None, "the goal's response")
        self._handle.cancel_goal_async()
        return self.end()

    def end(self) -> Any:
        return wait_until(lambda: self.result, "the result")


class Robot:
    """The charging robot under test and a client of its mission; `docking` replaces docking_node, or is None."""

    def __init__(self, scene: Scene, context: Any) -> None:
        namespace = new_namespace()
        self.docking = None if "docking_node" in scene.nodes else MockDocking(context, namespace)
        self.composition = Composition(scene, context, namespace).start()
        self.node = self.composition.node
        client_node = Node("mission_client", **options(context, namespace))
        self._client: ActionClient[Any, Any, Any] = ActionClient(client_node, ChargeRobot, "charge_robot")
        self._spinner = Spinner(client_node)
        wait_until(self._client.server_is_ready, "charge_robot")

    def send(self, request_id: str = "", stop_after: float = 0.2, frame: str = "map", at: Place = TARGET) -> ActiveGoal:
        goal = ChargeRobot.Goal(request_id=request_id, stop_after=duration(stop_after))
        fill_pose(goal.target, replace(at, frame=frame))
        active = ActiveGoal()
        self._spinner.call_soon(active.send, self._client, goal)
        return active

    def run(self, **fields: Any) -> tuple[Any, ActiveGoal]:
        active = self.send(**fields)
        return active.end(), active

    def set(self, node: str, fault: str) -> None:
        answer = self.node(node).set_parameters([Parameter("fault", value=fault)])[0]
        assert answer.successful, answer.reason

    @property
    def place(self) -> Place:
        found: Place = self.node("mock_navigator_node").place
        return found

    def close(self) -> None:
        self.composition.close()
        if self.docking is not None:
            self.docking.stop()
        self._spinner.close(self._client)


def mocked(change: Callable[[dict[str, Any]], None] | None = None) -> Scene:
    """Return a scene of detector, navigator and mission only; `change` may change it."""
    content = read_yaml(REAL)
    content["nodes"] = ["mock_detector_node", "mock_navigator_node", "mission_node"]
    content["parameters"] = {name: content["parameters"].get(name, {}) for name in content["nodes"]}
    if change is not None:
        change(content)
    return parse_scene(content, "mocked")


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


@pytest.fixture(scope="module")
def shared(context: Any) -> Iterator[Robot]:
    pytest.importorskip("nav2_msgs", reason=WITHOUT_NAVIGATION)
    robot = Robot(mocked(), context)
    yield robot
    robot.close()


@pytest.fixture
def robot(shared: Robot) -> Iterator[Robot]:
    """A robot with a mock of docking_node, free for the next scenario at the end."""
    yield shared
    shared.set("mock_detector_node", "none")
    shared.set("mock_navigator_node", "none")
    assert shared.docking is not None
    shared.docking.tell(DockingState.STATE_IDLE)


def named(result: Any) -> tuple[bool, str, bool]:
    """Return success, the code's name and whether it returned."""
    return result.success, CODES[result.error_code], result.returned


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
    assert set(active.stages) == set(Stage)
    assert active.stages[-4:] == [Stage.DOCK, Stage.CHARGE, Stage.UNDOCK, Stage.RETURN]
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
    robot = made(mocked(lambda content: content["parameters"]["mission_node"].pop("base_pose", None)))
    active = robot.send(stop_after=60.0)
    active.reach(Stage.CHARGE)
    assert robot.place.x == pytest.approx(TARGET.x - 0.25 - 0.2, abs=1e-6), "view_distance before it"
    active.cancel()


@pytest.mark.version
def test_a_docked_charger_is_not_driven(robot: Robot) -> None:
    assert robot.docking is not None
    undockings = robot.docking.undockings
    robot.docking.tell(DockingState.STATE_CHARGING, docked=True, charging=True)
    node = robot.node("mission_node")
    wait_until(lambda: node._others.is_at_work, "docking_state")
    result, active = robot.run()
    assert named(result) == (False, "REJECTED", False)
    assert "undock" in result.error_message
    assert active.stages == [Stage.WAIT]
    assert robot.docking.undockings == undockings, "another client's charging continues"


@pytest.mark.rest
def test_closing_mission_node_ends_charging_and_its_goal_and_drives_nowhere(made: Callable[[Scene], Robot]) -> None:
    robot = made(mocked())
    active = robot.send(stop_after=100.0)
    active.reach(Stage.CHARGE)
    stood, docking = robot.place, robot.docking
    robot.node("mission_node").close()
    result = active.end()
    assert named(result) == (False, "CANCELED", False), result
    assert "undock before you drive it" in result.error_message
    assert seconds(result.elapsed) > 0.5
    assert result.energy > 0.0
    assert docking is not None
    wait_until(lambda: not docking.charging, "an open contactor")
    assert robot.place == stood


@pytest.mark.rest
def test_a_process_that_needs_nav2_msgs_ends_with_2_and_names_it(
    start: Callable[..., Process], namespace: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "raise ModuleNotFoundError(\"No module named 'nav2_msgs'\", name='nav2_msgs')\n"
    (tmp_path / "nav2_msgs.py").write_text(text, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    process = start(*node_command(load_scene("mission"), "mission_node", namespace))
    assert process.end() == 2
    assert "needs the package nav2_msgs" in process.err[-1]


@pytest.mark.rest
def test_after_a_defect_the_node_is_free(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = robot.node("mission_node")._machine
    begins = machine.start

    def fail(*words: Any) -> None:
        monkeypatch.undo()
        begins(*words)
        raise RuntimeError("a defect at the beginning")

    monkeypatch.setattr(machine, "start", fail)
    result, _ = robot.run()
    assert named(result) == (False, "INTERNAL", False)
    assert not machine.busy, "it drives without a client"
    active = robot.send()
    active.reach(Stage.DRIVE)
    active.cancel()
