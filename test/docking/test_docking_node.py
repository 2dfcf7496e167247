# SPDX-License-Identifier: Apache-2.0
"""docking_node over its real topics and actions, on mocks that misbehave: goals, clients, defects, clocks and its end.

What a code means and when it comes is tested in virtual time; here each way into the node is used. One charger serves
most tests, each of which begins with an undocking: that shows recovery.

With use_sim_time only stamps use /clock; control, the contactor's lease and the arm's watchdogs use the monotonic
clock. What clocks that jump, rest or run at another rate do to the data is tested in test_inputs.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from builtin_interfaces.msg import Duration
from deltacharger.action import Dock, Undock
from deltacharger.msg import DockingState
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from deltacharger_core.texts import REQUEST_ID_MAX
from deltacharger_ros.client import ChargerClient
from deltacharger_ros.messages import CODES, seconds
from deltacharger_ros.outcomes import Progress
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.scene import Scene

from ..chargers import DEADLINE, new_namespace, wait_until
from ..marks import rest
from ..nodes import answer, numbers, options
from ..running_charger import GOAL, RunningCharger
from ..waiting import host
from .raw_goals import RawGoals, goal_with, pose

pytestmark = pytest.mark.ros

NAN, INF, HUGE = math.nan, math.inf, 1e308
OPENS = 0.35  # s for the contactor to open after docking's thread has failed
MOCKS = ("mock_tactile_node", "mock_detector_node")
CONTACT_ONLY = replace(GOAL, start_charging=False)


@pytest.fixture(scope="module")
def shared(quick_scene: Scene, context: Any) -> Iterator[RunningCharger]:
    docking = {**quick_scene.parameters["docking_node"], "transform_timeout": 0.1}
    scene = replace(quick_scene, parameters={**quick_scene.parameters, "docking_node": docking})
    with RunningCharger(scene, context) as charger:
        yield charger


@pytest.fixture(scope="module")
def raw(shared: RunningCharger) -> RawGoals:
    return RawGoals(shared.client)


@pytest.fixture
def charger(shared: RunningCharger) -> RunningCharger:
    """A charger at rest; its mocks behave."""
    for node in MOCKS:
        shared.set(node, fault="none")
    if shared.state.docked or shared.state.error_code:
        bring_home(shared)
    return shared


def bring_home(charger: RunningCharger) -> None:
    """Undock after docking's own way back, if it is on it."""
    wait_until(lambda: charger.state.state != DockingState.STATE_RETRACT, "the end of the way back")
    charger.go_home()


@pytest.mark.witness
@pytest.mark.version
def test_docking_charges_and_reports_it_and_undocking_ends_it(charger: RunningCharger) -> None:
    seen: list[Progress] = []
    longest = "y" * REQUEST_ID_MAX
    outcome = charger.dock(replace(GOAL, request_id=longest), seen.append)
    assert (outcome.success, outcome.error_code, outcome.error_name) == (True, 0, "NONE"), outcome
    assert 0.4 <= outcome.details["contact_current"] <= 0.5
    assert outcome.details["charge_current"] > 0.5
    assert "redockings" in outcome.details
    assert not math.isnan(outcome.details["misalignment"]["vertical"])
    assert {"approach", "contact", "measure", "energise"} <= {progress.phase for progress in seen}
    assert {"predict_misalignment", "probe"} <= {progress.waiting_for for progress in seen}
    assert max(len(state.request_id) for state in charger.states) == REQUEST_ID_MAX
    assert charger.is_closed
    assert charger.dock().success, "docking when docked"
    charger.go_home()


ASIDE = math.sqrt(0.5)  # turned by a quarter about y the terminal's bars have no roll about z at all
WRONG = {
    "NaN place": pose(NAN, 0.0, 0.080),
    "huge place": pose(HUGE, -HUGE, HUGE),
    "huge place in the robot's frame": pose(HUGE, -HUGE, HUGE, frame="base_link"),
    "unknown frame": pose(frame="the_moon"),
    "blank frame": pose(frame=" "),
    "frame with a newline": pose(frame="charger_base\n"),
    "endless frame": pose(frame="charger_base" * 10_000),
    "no orientation": pose(w=0.0),
    "NaN orientation": pose(w=NAN),
    "endless orientation": pose(w=INF),
    "orientation too long to be normed": pose(w=HUGE, z=HUGE),
    "tiny orientation": pose(w=1e-200),
    "facing sideways": pose(w=ASIDE, y=ASIDE),
    "NaN critical angle": goal_with(critical_angle=NAN),
    "endless energy": goal_with(stop_energy=INF),
    "smallest duration": goal_with(stop_after=Duration(sec=-(2**31))),
    "seconds and nanoseconds cancel": goal_with(stop_after=Duration(sec=-5, nanosec=4_000_000_000)),
    "long request_id": goal_with(request_id="x" * 1_000_000),
}


"""Goals of which nothing is known without tf, on whose first lookup live electrodes must not wait."""


@pytest.mark.version
@pytest.mark.parametrize("goal", WRONG.values(), ids=WRONG)
def test_an_impossible_goal_is_refused_before_anything_moves(
    shared: RunningCharger, raw: RawGoals, goal: Dock.Goal
) -> None:
    """And reports nothing of an earlier docking."""
    servos = shared.node("mock_servo_node")
    before = servos.position
    result = raw.result(goal)
    assert not result.success
    assert CODES[result.error_code] in ("REJECTED", "UNREACHABLE", "CRITICAL_ANGLE"), result.error_message
    assert 0 < len(result.error_message) < 1000, "a person reads it"
    assert (servos.position, servos.torque_enabled) == (before, False)
    assert all(map(math.isnan, numbers(result.misalignment)))
    assert all(map(math.isnan, (result.contact_current, result.contact_force, result.charge_current)))
    assert result.energy == 0.0, "counted, and none flowed"
    assert result.alignments == result.redockings == 0


def defect(monkeypatch: pytest.MonkeyPatch, owner: Any, method: str, once: bool) -> None:
    """Let a method raise: at each call instead of its work, or once behind it."""
    works = getattr(owner, method)

    def fail(*words: Any, **options: Any) -> Any:
        if once:
            monkeypatch.undo()
            works(*words, **options)
        raise RuntimeError("a defect")

    monkeypatch.setattr(owner, method, fail)


@pytest.mark.parametrize(
    ("part", "method"),
    [
        pytest.param("_machine", "step", marks=pytest.mark.witness),
        rest("_inputs", "observation"),
        rest("_machine", "_begin"),
    ],
)
def test_an_internal_defect_while_charging_opens_the_contactor(
    charger: RunningCharger, part: str, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In its decisions or observations at each call, or at the beginning of undocking."""
    charger.charge()
    defect(monkeypatch, getattr(charger.node("docking_node"), part), method, once=method == "_begin")
    if method == "_begin":
        assert charger.undock().error_name == "INTERNAL"
    wait_until(lambda: not charger.is_closed, "an open contactor", host(OPENS))
    wait_until(lambda: not charger.node("mock_servo_node").torque_enabled, "no torque")
    monkeypatch.undo()
    assert not charger.node("docking_node")._machine.busy
    charger.go_home()


@pytest.mark.witness
def test_wrong_messages_on_a_topic_end_charging(charger: RunningCharger, monkeypatch: pytest.MonkeyPatch) -> None:
    """servo_state with the names of other joints, which only docking_node and kinematics_node read."""
    charger.charge()
    docking, publisher = charger.node("docking_node"), charger.node("mock_servo_node")._state
    warned: list[str] = []
    monkeypatch.setattr(docking._log, "warning", lambda line, *more: warned.append(line))
    before, publish = docking._inputs.heard.refused, publisher.publish

    def mislabel(message: Any) -> None:
        message.name = ["a", "b", "c"]
        publish(message)

    monkeypatch.setattr(publisher, "publish", mislabel)
    age_max = docking.get_parameter("age_max").value
    wait_until(lambda: not charger.is_closed, "an open contactor", age_max + host(OPENS))
    wait_until(lambda: charger.state.error_code, "a code")
    assert CODES[charger.state.error_code] == "SERVO_STALE"
    assert docking._inputs.heard.refused > before
    assert docking._inputs.heard.last_refusal.startswith("servo_state")
    assert any("SERVO_STALE" in line for line in warned), warned
    monkeypatch.undo()
    bring_home(charger)


@pytest.mark.rest
@pytest.mark.version
def test_parameters_set_at_run_time_apply_to_the_next_goal(charger: RunningCharger) -> None:
    node = charger.node("docking_node")

    def set_home(z: float) -> str:
        both = [Parameter("home_z", value=z), Parameter("search_depth", value=0.03)]
        return str(node.set_parameters_atomically(both).reason)

    usual, cancel, seen = node.get_parameter("home_z").value, threading.Event(), list[Progress]()
    ended = charger.begin("charging", lambda: charger.dock(replace(GOAL, hold=True), seen.append, cancel=cancel))
    assert "a goal is running" in set_home(0.03)
    cancel.set()
    assert ended.result(DEADLINE).error_name == "CANCELED"
    assert seen[-1].z == pytest.approx(usual, abs=2e-3), "it went where it would have gone"
    assert (node.get_parameter("home_z").value, node.get_parameter("search_depth").value) == (usual, 0.025)
    assert charger.dock(CONTACT_ONLY).success
    assert "undock" in set_home(0.03), "the electrodes rest on the target"
    charger.go_home()
    assert set_home(0.05) == ""
    assert charger.dock(CONTACT_ONLY).success
    assert charger.client.undock(deadline=DEADLINE, on_progress=seen.append).success
    assert seen[-1].z == pytest.approx(0.05, abs=2e-3)
    assert set_home(usual) == ""


@pytest.mark.rest
def test_goals_while_docking_node_ends_are_answered_and_everything_is_safe_before_the_others_end(
    quick_scene: Scene, context: Any
) -> None:
    with RunningCharger(quick_scene, context) as charger:
        raw = RawGoals(charger.client)
        running = raw.send(goal_with(hold=True))
        wait_until(lambda: charger.state.charging, "charging")
        running_result = running.get_result_async()
        closing = threading.Thread(target=charger.node("docking_node").close)
        closing.start()
        results = []
        while closing.is_alive():
            results.append(raw.result(pose()))
        assert not charger.is_closed
        assert not charger.node("mock_servo_node").torque_enabled
        results += [raw.result(Undock.Goal()), raw.result(pose())]
        for result in results:
            assert (result.success, CODES[result.error_code], bool(result.error_message)) == (False, "REJECTED", True)
        assert "shutting down" in results[-1].error_message
        assert results[-1].retriable
        account = answer(running_result).result
        assert (CODES[account.error_code], account.charge_end) == ("CANCELED", "CANCELED")
        assert seconds(account.elapsed) > 0.1
        assert account.energy > 0.0
        assert 0.3 < account.contact_current < 0.6


@pytest.mark.rest
@pytest.mark.version
def test_a_held_charger_moves_nothing_and_serves_queued_goals_after_release(quick_scene: Scene, context: Any) -> None:
    namespace = new_namespace()
    with (
        Composition(quick_scene, context, namespace, held=True) as composition,
        ChargerClient(namespace, context) as client,
    ):
        assert client.wait_until_ready(DEADLINE)
        ended = RawGoals(client).send(pose()).get_result_async()
        docking = composition.node("docking_node")
        wait_until(lambda: docking._waiting, "the queued goal")
        assert not any((docking._thread.is_alive(), composition.node("mock_servo_node").torque_enabled))
        composition.release()
        wait_until(ended.done, "the docking")
        assert ended.result().result.success, ended.result().result.error_message


_STEP = 0.01  # s of real time between two messages
_BEGIN = 100.0  # s, simulated


class Simulator:
    """Publishes /clock as a simulator does, at the real rate, until `close`."""

    def __init__(self, context: Any) -> None:
        self._node = Node("simulator", **options(context))
        self._publisher = self._node.create_publisher(Clock, "/clock", 1)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def _run(self) -> None:
        began = time.monotonic()
        while not self._over.wait(_STEP):
            now = _BEGIN + time.monotonic() - began
            message = Clock()
            message.clock.sec, message.clock.nanosec = int(now), int(now % 1.0 * 1e9)
            self._publisher.publish(message)

    def close(self) -> None:
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()
            self._node.destroy_node()


@pytest.fixture
def simulator(context: Any) -> Iterator[Simulator]:
    simulator = Simulator(context)
    yield simulator
    simulator.close()


@pytest.mark.witness
@pytest.mark.version
def test_goals_are_refused_before_the_first_clock_message_and_served_until_the_clock_stops(
    quick_scene: Scene, context: Any, simulator: Simulator
) -> None:
    given = {name: {**quick_scene.parameters.get(name, {}), "use_sim_time": True} for name in quick_scene.nodes}
    with RunningCharger(replace(quick_scene, parameters=given), context) as charger:
        for outcome in (charger.dock(), charger.undock()):
            assert (outcome.error_name, outcome.retriable) == ("REJECTED", True), outcome
            assert "/clock" in outcome.error_message
        assert not charger.node("mock_servo_node").torque_enabled
        simulator.start()
        node = charger.node("docking_node")
        wait_until(lambda: node.get_clock().now().nanoseconds >= _BEGIN * 1e9, "/clock at docking_node")
        charger.charge()
        assert _BEGIN <= charger.state.header.stamp.sec < _BEGIN + DEADLINE
        age_max = node.get_parameter("age_max").value
        simulator.close()
        wait_until(lambda: not charger.is_closed, "an open contactor", age_max + host(0.5))
        wait_until(lambda: charger.state.error_code, "a code")
        assert CODES[charger.state.error_code] in ("SERVO_STALE", "TACTILE_STALE", "POWER_STALE", "ESTIMATE_UNSURE")
        assert "/clock" in charger.state.error_message
