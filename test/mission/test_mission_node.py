# SPDX-License-Identifier: Apache-2.0
"""mission_node over real topics, actions and services: charged and home, or a code and home.

Docking's decisions are tested with the real docking_node on mocks; the rest of a mission with a node that has only
docking_node's interface. The laws are in test/mission/test_mission.py, in virtual time.
"""

from __future__ import annotations

import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
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
from deltacharger_mission.ros.messages import fill_pose
from deltacharger_ros.client import ChargerClient
from deltacharger_ros.executor import Spinner
from deltacharger_ros.messages import CODES, duration
from deltacharger_ros.node_support import StartupError
from deltacharger_ros.tf_tree import installed
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.scene import Scene, load_scene, parse_scene

from ..chargers import DEADLINE, Process, Spin, new_namespace, wait_until
from ..docking.mock_docking import MockDocking
from ..marks import rest
from ..nodes import options
from ..transforms import Robot as Broadcaster

pytestmark = pytest.mark.ros

WITHOUT_NAVIGATION = "nav2_msgs is not installed: it comes with Nav2, or `make navigation` builds a stand-in"
TARGET = Place(1.0, 0.0, math.pi)
HOME = Place(-1.0, 0.0, 0.0)
REAL = Path(__file__).with_name("mission.yaml")
STANDS = read_yaml(REAL)["parameters"]["mission_node"]["stands_max"]


class ActiveGoal:
    """A running ChargeRobot goal: its stages as reported, and its result."""

    def __init__(self) -> None:
        self.stages: list[Stage] = []
        self.status = 0
        self.result: Any = None
        self._handle: Any = None
        self._done = threading.Event()

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
        self.status, self.result = future.result().status, future.result().result
        self._done.set()

    def reaches(self, stage: Stage) -> bool:
        wait_until(lambda: stage in self.stages or self._done.is_set(), f"{stage.name} in {self.stages}")
        return stage in self.stages

    def reach(self, stage: Stage) -> None:
        assert self.reaches(stage), self.result

    def cancel(self) -> None:
        wait_until(lambda: self._handle is not None, "the goal's response")
        self._handle.cancel_goal_async()

    def end(self) -> Any:
        assert self._done.wait(DEADLINE), self.stages
        return self.result


class Robot:
    """The charging robot under test and a client of its mission; `docking` replaces docking_node, or is None."""

    def __init__(self, scene: Scene, context: Any) -> None:
        self.namespace = new_namespace()
        self.context = context
        self.docking = None if "docking_node" in scene.nodes else MockDocking(context, self.namespace)
        self.composition = Composition(scene, context, self.namespace).start()
        self._client_node = Node("mission_client", **options(context, self.namespace))
        self._client: ActionClient[Any, Any, Any] = ActionClient(self._client_node, ChargeRobot, "charge_robot")
        self._spinner = Spinner(self._client_node)
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

    def node(self, name: str) -> Any:
        return self.composition.node(name)

    def set(self, node: str, fault: str) -> None:
        answer = self.node(node).set_parameters([Parameter("fault", value=fault)])[0]
        assert answer.successful, answer.reason

    @property
    def place(self) -> Place:
        found: Place = self.node("mock_navigator_node").place
        return found

    @property
    def live(self) -> bool:
        if self.docking is not None:
            return self.docking.charging
        return bool(self.node("mock_tactile_node").contactor_closed)

    def heal(self) -> None:
        """Make it ready for the next scenario."""
        for running in self.composition.nodes:
            if running.node.has_parameter("fault"):
                self.set(running.name, "none")
        if self.docking is None:
            self.node("mock_servo_node").reboot()
            with ChargerClient(self.namespace, self.context) as client:
                assert client.undock(deadline=DEADLINE).success
        else:
            self.docking.tell(DockingState.STATE_IDLE)

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


@pytest.fixture(scope="module")
def shared(context: Any) -> Iterator[Callable[[bool], Robot]]:
    """The robots of all scenarios, each created on first use: with the real docking_node, and with a mock."""
    pytest.importorskip("nav2_msgs", reason=WITHOUT_NAVIGATION)
    robots: dict[bool, Robot] = {}

    def wanted(real: bool) -> Robot:
        if real not in robots:
            robots[real] = Robot(load_scene(REAL) if real else mocked(), context)
        return robots[real]

    yield wanted
    for robot in robots.values():
        robot.close()


@pytest.fixture
def real(shared: Callable[[bool], Robot]) -> Iterator[Robot]:
    robot = shared(True)
    yield robot
    robot.heal()


@pytest.fixture
def robot(shared: Callable[[bool], Robot]) -> Iterator[Robot]:
    robot = shared(False)
    yield robot
    robot.heal()


def named(result: Any) -> tuple[bool, str, bool]:
    """Return success, the code's name and whether it returned."""
    return result.success, CODES[result.error_code], result.returned


def test_it_drives_docks_charges_and_comes_home(real: Robot) -> None:
    real.node("mock_navigator_node").arrived.clear()
    result, active = real.run(request_id="r1", stop_after=1.0)
    assert named(result) == (True, "NONE", True), result
    assert result.energy > 0.0
    assert set(active.stages) == set(Stage)
    assert active.stages[-4:] == [Stage.DOCK, Stage.CHARGE, Stage.UNDOCK, Stage.RETURN]
    assert real.place == HOME
    first = real.node("mock_navigator_node").arrived[0]
    assert (first.x, first.y) == pytest.approx((1.0 - 0.2, 0.0), abs=1e-6), "before a target at x = 1 that faces −x"
    assert not real.live


def test_home_is_moved_between_missions(robot: Robot) -> None:
    def home(x: float) -> str:
        both = [Parameter("home_x", value=x), Parameter("stands_max", value=STANDS)]
        return str(robot.node("mission_node").set_parameters_atomically(both).reason)

    active = robot.send(stop_after=1.0)
    active.reach(Stage.DRIVE)
    assert home(HOME.x + 0.5).startswith("home_x, stands_max not set: a goal is running")
    assert active.end().success
    assert robot.place == HOME
    assert home(HOME.x + 0.5) == ""
    result, _ = robot.run()
    assert result.success, result
    assert robot.place.x == pytest.approx(HOME.x + 0.5)
    assert home(HOME.x) == ""


def test_if_the_target_is_out_of_reach_the_robot_moves_and_docks(real: Robot) -> None:
    real.set("mock_detector_node", "beyond_reach")
    real.node("mock_navigator_node").arrived.clear()
    active = real.send()
    wait_until(lambda: len(real.node("mock_navigator_node").arrived) > 1, "a second stand")
    real.set("mock_detector_node", "none")
    result = active.end()
    assert named(result) == (True, "NONE", True), result
    first, second = real.node("mock_navigator_node").arrived[:2]
    assert second.x - first.x == pytest.approx(0.5 - 0.08, abs=1e-6), "it came nearer by what was missing"
    assert real.place == HOME


def test_a_target_that_stays_out_of_reach_fails_with_a_suggested_base_pose(real: Robot) -> None:
    real.set("mock_detector_node", "beyond_reach")
    result, _ = real.run()
    assert named(result) == (False, "UNREACHABLE", True), result
    assert result.suggested_base_pose.header.frame_id == "charger_base"
    assert result.suggested_base_pose.pose.position.z == pytest.approx(0.5 - 0.08)
    assert len(real.node("mock_navigator_node").arrived) > 2


def test_a_target_that_stays_askew_fails_after_the_allowed_moves(real: Robot) -> None:
    """The mock's electrodes move with the base, so every move leaves them askew."""
    real.set("mock_detector_node", "leaning")
    arrived = real.node("mock_navigator_node").arrived
    arrived.clear()
    result, _ = real.run()
    assert named(result) == (False, "LEANING", True), result
    assert result.suggested_base_pose.pose.orientation.y == pytest.approx(math.sin(math.radians(5.0)))
    turns = [math.remainder(b.yaw - a.yaw, 2.0 * math.pi) for a, b in pairwise(arrived[:-1])]
    assert turns == pytest.approx([math.radians(10.0)] * STANDS), "to the left each time"


@pytest.mark.parametrize("stage", [Stage.DRIVE, Stage.SEARCH, Stage.DOCK, Stage.CHARGE])
def test_a_cancelled_mission_opens_undocks_and_comes_home(robot: Robot, stage: Stage) -> None:
    if stage in (Stage.DRIVE, Stage.SEARCH):
        robot.set("mock_navigator_node", "slow")
    if stage is Stage.SEARCH:
        robot.set("mock_detector_node", "nothing")
    active = robot.send(stop_after=100.0)
    active.reach(stage)
    active.cancel()
    robot.set("mock_navigator_node", "none")
    result = active.end()
    assert named(result) == (False, "CANCELED", True), result
    assert result.retriable
    assert not robot.live
    assert robot.place == HOME
    if stage is Stage.CHARGE:
        assert result.energy > 0.0
        assert active.stages[-2:] == [Stage.UNDOCK, Stage.RETURN]


def test_a_cancel_during_the_return_stops_the_robot(robot: Robot) -> None:
    active = robot.send()
    active.reach(Stage.CHARGE)
    robot.set("mock_navigator_node", "slow")
    active.reach(Stage.RETURN)
    active.cancel()
    result = active.end()
    assert named(result) == (False, "CANCELED", False), result
    assert robot.place != HOME


def test_a_second_goal_is_rejected_and_the_same_request_joins(robot: Robot) -> None:
    first = robot.send(request_id="twice", stop_after=100.0)
    first.reach(Stage.CHARGE)
    second, _ = robot.run(request_id="another")
    assert named(second) == (False, "REJECTED", False)
    assert second.retriable
    assert "twice" in second.error_message
    same = robot.send(request_id="twice")
    same.reach(Stage.CHARGE)
    third, _ = robot.run(request_id="twice")
    assert named(third)[1] == "REJECTED", "one may join, not a crowd"
    same.cancel()
    assert named(same.end()) == named(first.end()) == (False, "CANCELED", True)


@pytest.mark.parametrize(
    ("fault", "name", "reason"),
    [
        ("refuse", "REJECTED", "active"),
        ("abort", "UNREACHABLE", "the way is blocked (error 9000 of the navigator)"),
        ("lost", "UNREACHABLE", "unknown in that frame"),
    ],
)
def test_a_failing_navigator_is_reported(robot: Robot, fault: str, name: str, reason: str) -> None:
    robot.set("mock_navigator_node", fault)
    active = robot.send()
    active.reach(Stage.RETURN)
    result = active.end()
    assert named(result) == (False, name, False), result
    assert reason in result.error_message
    assert "then" in result.error_message
    assert result.contact_force != result.contact_force, "what was not measured is NaN"


@pytest.mark.parametrize("frame", ["", "the_moon"])
def test_a_target_in_an_unknown_frame_is_refused(robot: Robot, frame: str) -> None:
    result, _ = robot.run(frame=frame)
    assert not result.success
    assert CODES[result.error_code] == ("UNREACHABLE" if frame and not installed() else "REJECTED")


def test_a_target_in_another_tf_frame_is_transformed_to_map(robot: Robot, context: Any, spin: Spin) -> None:
    """A navigator that knows only the frame map is sent to the same place."""
    broadcaster = spin(Broadcaster(context))
    active = robot.send(stop_after=60.0)
    active.reach(Stage.CHARGE)
    stand = robot.place
    active.cancel()
    active.end()
    odom = Place(3.0, -2.0, 0.7)
    wait_until(lambda: broadcaster.heard, "mission_node")
    pose = (odom.x, odom.y, 0.0, 0.0, 0.0, math.sin(0.5 * odom.yaw), math.cos(0.5 * odom.yaw))
    timer = broadcaster.create_timer(0.02, lambda: broadcaster.move(("map", "odom", pose)))
    origin = Place(0.0, 0.0, -odom.yaw).at(-odom.x, -odom.y)  # of map in odom
    active = robot.send(stop_after=60.0, frame="odom", at=origin.at(TARGET.x, TARGET.y, TARGET.yaw))
    active.reach(Stage.CHARGE)
    assert robot.place.distance(stand) < 1e-6
    assert robot.place.turn(stand) < 1e-6
    active.cancel()
    active.end()
    timer.cancel()


def test_the_base_pose_follows_the_charger_mount_in_tf(
    made: Callable[[Scene], Robot], context: Any, spin: Spin
) -> None:
    def without(content: dict[str, Any]) -> None:
        content["parameters"]["mission_node"].pop("base_pose", None)

    def given(content: dict[str, Any]) -> None:
        content["parameters"]["mission_node"]["base_pose"] = [0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5]

    pytest.importorskip("nav2_msgs", reason=WITHOUT_NAVIGATION)
    broadcaster = spin(Broadcaster(context))
    broadcaster.fix("base_link", "charger_base", (0.25, 0.0, 0.4, 0.5, 0.5, 0.5, 0.5))
    robot = made(mocked(without))
    active = robot.send(stop_after=60.0)
    active.reach(Stage.CHARGE)
    assert robot.place.x == pytest.approx(TARGET.x - 0.25 - 0.2, abs=1e-6), "view_distance before it"
    active.cancel()
    active.end()
    robot = made(mocked(given))
    wait_until(lambda: robot.node("mission_node")._frames._tf.knows("charger_base"), "tf")
    result, _ = robot.run()
    assert named(result) == (False, "REJECTED", False)
    assert "base_pose contradicts tf" in result.error_message


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


@pytest.fixture
def made(context: Any) -> Iterator[Callable[[Scene], Robot]]:
    robots: list[Robot] = []

    def make(scene: Scene) -> Robot:
        robots.append(Robot(scene, context))
        return robots[-1]

    yield make
    for robot in robots:
        robot.close()


def test_missing_nodes_are_named_and_nothing_moves(made: Callable[[Scene], Robot]) -> None:
    pytest.importorskip("nav2_msgs", reason=WITHOUT_NAVIGATION)

    def change(content: dict[str, Any]) -> None:
        content["nodes"].remove("mock_navigator_node")
        del content["parameters"]["mock_navigator_node"]
        content["parameters"]["mission_node"]["wait_timeout"] = 1.0

    result, active = made(mocked(change)).run()
    assert named(result) == (False, "REJECTED", False), result
    assert result.retriable
    assert "navigate_to_pose" in result.error_message
    assert active.stages == [Stage.WAIT]


def standing(content: dict[str, Any]) -> None:
    """Remove the navigator: the charger is stationary."""
    content["nodes"].remove("mock_navigator_node")
    del content["parameters"]["mock_navigator_node"]
    content["parameters"]["mission_node"] |= {"navigation": "none", "undock_timeout": 1.0}


@pytest.mark.rest
def test_a_stationary_charger_needs_no_navigator_and_reports_missing_docking(
    made: Callable[[Scene], Robot],
) -> None:
    robot = made(mocked(standing))
    result, active = robot.run(frame="")
    assert named(result) == (True, "NONE", True), result
    assert not {Stage.DRIVE, Stage.RETURN} & set(active.stages)
    active = robot.send(frame="", stop_after=100.0)
    active.reach(Stage.CHARGE)
    assert robot.docking is not None
    robot.docking.stop()
    result = active.end()
    assert named(result) == (False, "TIMEOUT", False), result
    assert "docking_node disappeared" in result.error_message
    assert "undock_timeout" in result.error_message


def test_closing_mission_node_ends_charging_and_its_goal_and_drives_nowhere(
    made: Callable[[Scene], Robot],
) -> None:
    pytest.importorskip("nav2_msgs", reason=WITHOUT_NAVIGATION)
    robot = made(mocked())
    active = robot.send(stop_after=100.0)
    active.reach(Stage.CHARGE)
    stood = robot.place
    mission = next(running for running in robot.composition.nodes if running.name == "mission_node")
    closing = time.monotonic()
    mission.node.close()
    assert time.monotonic() - closing < DEADLINE
    result = active.end()
    assert named(result) == (False, "CANCELED", False), result
    assert "undock before you drive it" in result.error_message
    wait_until(lambda: not robot.live, "an open contactor")
    assert robot.place == stood


@pytest.mark.parametrize("number", [signal.SIGINT, rest(signal.SIGTERM)])
def test_the_process_ends_with_0(start: Callable[..., Process], context: Any, namespace: str, number: int) -> None:
    code = "import sys; from deltacharger_mission.ros.mission_node import main; sys.exit(main())"
    words = ["--ros-args", "-r", f"__ns:=/{namespace}"]
    process = start(sys.executable, "-c", code, *words)
    node = Node("waits_for_a_mission", **options(context, namespace))
    client: ActionClient[Any, Any, Any] = ActionClient(node, ChargeRobot, "charge_robot")
    wait_until(client.server_is_ready, "charge_robot")
    assert process.end(number) == 0, process.err
    client.destroy()
    node.destroy_node()


def test_without_nav2_msgs_the_node_names_what_to_install(
    context: Any, namespace: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "nav2_msgs", None)
    monkeypatch.setitem(sys.modules, "nav2_msgs.action", None)
    scene = parse_scene({"nodes": ["mission_node"], "parameters": {"mission_node": {"navigation": "nav2"}}}, "alone")
    with pytest.raises(StartupError, match="make navigation"):
        Composition(scene, context, namespace).start()


def test_a_defect_at_the_beginning_of_a_mission_leaves_the_node_free(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    result, _ = robot.run()
    assert result.success, result


def test_a_mission_is_logged_stage_by_stage(robot: Robot, capfd: pytest.CaptureFixture[str]) -> None:
    result, _ = robot.run(request_id="r9")
    assert result.success, result
    lines = [line.split("charge_robot r9: ", 1)[1] for line in capfd.readouterr().err.splitlines() if "r9: " in line]
    assert lines[0] == "accepted"
    assert lines[-1].startswith("done in ")
    passages = [line.split(" after ")[0].split(" → ") for line in lines[1:-1]]
    assert passages[0] == ["wait", "drive"]
    assert passages[-1] == ["undock", "return"]
    assert all(before[1] == after[0] for before, after in pairwise(passages)), passages
