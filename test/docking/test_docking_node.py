# SPDX-License-Identifier: Apache-2.0
"""docking_node over its real topics and actions, on mocks that misbehave: goals, defects, clocks, strangers, its end.

A second source is named and keeps the contactor open, and so does an estimate of unknown frames.

What a code means and when it comes is tested in virtual time; here each way into the node is used. One charger serves
most tests, each of which begins with an undocking: that shows recovery.

With use_sim_time only stamps use /clock; control, the contactor's lease and the arm's watchdogs use the monotonic
clock. What clocks that jump, rest or run at another rate do to the data is tested in test_inputs.
"""

import math
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from builtin_interfaces.msg import Duration
from deltacharger.action import Dock, Undock
from deltacharger.msg import ChargerPower, DockingState
from deltacharger.srv import PredictMisalignment, Probe
from rclpy.action.client import ActionClient
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from deltacharger_bringup.scenes.scene import Scene
from deltacharger_core.ros import messages, outcomes, qos
from deltacharger_core.ros.client import ChargerClient
from deltacharger_core.texts import REQUEST_ID_MAX

from ..chargers import DEADLINE, Spin, wait_until
from ..marks import rest
from ..nodes import answer, numbers, options
from ..running_charger import GOAL, RunningCharger
from ..waiting import host

pytestmark = pytest.mark.ros

NAN, INF, HUGE = math.nan, math.inf, 1e308
OPENS = 0.35  # s for the contactor to open after docking's thread has failed
MOCKS = ("mock_tactile_node", "mock_detector_node")
CONTACT_ONLY = replace(GOAL, start_charging=False)


def pose(*place: float, frame: str = "charger_base", w: float = 1.0, **turn: float) -> Dock.Goal:
    """Return a goal at a place (m; default 80 mm ahead) in a frame, with this orientation."""
    goal = Dock.Goal()
    at, goal.electrodes.header.frame_id = goal.electrodes.pose.position, frame
    at.x, at.y, at.z = place or (0.0, 0.0, 0.080)
    for name, value in {"w": w, **turn}.items():
        setattr(goal.electrodes.pose.orientation, name, value)
    return goal


def goal_with(**fields: Any) -> Dock.Goal:
    """Return a goal at the usual place with these fields."""
    goal = pose()
    for name, value in fields.items():
        setattr(goal, name, value)
    return goal


class RawGoals:
    """Action clients on the node of a charger's client."""

    def __init__(self, client: ChargerClient) -> None:
        self._client = client
        self._actions: dict[Any, Any] = {
            kind: ActionClient(client.node, kind, name) for kind, name in ((Dock, "dock"), (Undock, "undock"))
        }
        client.waitables += self._actions.values()
        assert all(action.wait_for_server(DEADLINE) for action in self._actions.values())

    def send(self, goal: Any) -> Any:
        """Send a goal and return its handle; every goal is accepted."""
        action = self._actions[Dock if isinstance(goal, Dock.Goal) else Undock]
        handle = answer(answer(self._client.node.executor.call_soon(action.send_goal_async, goal)))
        assert handle.accepted
        return handle

    def result(self, goal: Any) -> Any:
        """Send a goal and return its result."""
        return answer(self.send(goal).get_result_async()).result


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
    seen: list[outcomes.Progress] = []
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
    "unknown frame": pose(frame="the_moon"),
    "endless frame": pose(frame="charger_base" * 10_000),
    "no orientation": pose(w=0.0),
    "NaN orientation": pose(w=NAN),
    "orientation too long to be normed": pose(w=HUGE, z=HUGE),
    "facing sideways": pose(w=ASIDE, y=ASIDE),
    "NaN critical angle": goal_with(critical_angle=NAN),
    "endless energy": goal_with(stop_energy=INF),
    "seconds and nanoseconds cancel": goal_with(stop_after=Duration(sec=-5, nanosec=4_000_000_000)),
    "long request_id": goal_with(request_id="x" * 1_000_000),
}


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
    assert messages.CODES[result.error_code] in ("REJECTED", "UNREACHABLE", "CRITICAL_ANGLE"), result.error_message
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
    assert messages.CODES[charger.state.error_code] == "SERVO_STALE"
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
        return str(node.set_parameters_atomically([Parameter("home_z", value=z)]).reason)

    usual, seen = node.get_parameter("home_z").value, list[outcomes.Progress]()
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
            assert (result.success, messages.CODES[result.error_code], bool(result.error_message)) == (
                False,
                "REJECTED",
                True,
            )
        assert "shutting down" in results[-1].error_message
        assert results[-1].retriable
        assert messages.CODES[answer(running_result).result.error_code] == "CANCELED"


_STEP = 0.01  # s of real time between two messages
_BEGIN = 100.0  # s, simulated


def publish_clock(node: Node) -> Any:
    """Publish /clock as a simulator does, at the real rate, until the returned timer is cancelled."""
    publisher, began = node.create_publisher(Clock, "/clock", 1), time.monotonic()

    def publish() -> None:
        now = _BEGIN + time.monotonic() - began
        message = Clock()
        message.clock.sec, message.clock.nanosec = int(now), int(now % 1.0 * 1e9)
        publisher.publish(message)

    return node.create_timer(_STEP, publish)


@pytest.mark.witness
@pytest.mark.version
def test_goals_are_refused_before_the_first_clock_message_and_served_until_the_clock_stops(
    quick_scene: Scene, context: Any, spin: Spin
) -> None:
    given = {name: {**quick_scene.parameters.get(name, {}), "use_sim_time": True} for name in quick_scene.nodes}
    with RunningCharger(replace(quick_scene, parameters=given), context) as charger:
        for outcome in (charger.dock(), charger.undock()):
            assert (outcome.error_name, outcome.retriable) == ("REJECTED", True), outcome
            assert "/clock" in outcome.error_message
        assert not charger.node("mock_servo_node").torque_enabled
        clock = publish_clock(spin(Node("simulator", **options(context))))
        node = charger.node("docking_node")
        wait_until(lambda: node.get_clock().now().nanoseconds >= _BEGIN * 1e9, "/clock at docking_node")
        charger.charge()
        assert _BEGIN <= charger.state.header.stamp.sec < _BEGIN + DEADLINE
        age_max = node.get_parameter("age_max").value
        clock.cancel()
        wait_until(lambda: not charger.is_closed, "an open contactor", age_max + host(0.5))
        wait_until(lambda: charger.state.error_code, "a code")
        assert messages.CODES[charger.state.error_code] in (
            "SERVO_STALE",
            "TACTILE_STALE",
            "POWER_STALE",
            "ESTIMATE_UNSURE",
        )
        assert "/clock" in charger.state.error_message


def closings(charger: RunningCharger) -> list[bool]:
    """Collect whether charger_power reports a closed contactor."""
    found: list[bool] = []
    charger.client.node.create_subscription(
        ChargerPower, "charger_power", lambda power: found.append(power.contactor_closed), qos.LATEST
    )
    return found


@pytest.mark.rest
def test_second_sources_are_named_and_docking_waits_until_they_are_gone(quick_scene: Scene, context: Any) -> None:
    with RunningCharger(quick_scene, context) as charger:
        named = lambda: charger.state.duplicate_sources  # noqa: E731
        node = Node("stranger", **options(context, charger.namespace))
        node.create_publisher(ChargerPower, "charger_power", 1)
        node.create_service(Probe, "probe", lambda request, response: response)
        wait_until(lambda: named().count("/stranger") == 2, "a topic and a service named")
        closed = closings(charger)
        ended = charger.begin("measure")
        assert not any(closed)
        node.destroy_node()
        assert ended.result().success
        assert charger.is_closed
        later = Node("stranger", **options(context, charger.namespace))
        later.create_publisher(ChargerPower, "charger_power", 1)
        wait_until(lambda: "stranger" in named(), "a second source while charging")
        assert charger.is_closed
        later.destroy_node()
        charger.go_home()


@pytest.mark.rest
def test_an_estimate_of_frames_that_nobody_heard_never_closes_the_contactor(
    quick_scene: Scene, context: Any, spin: Spin
) -> None:
    def lie(request: Any, response: Any) -> Any:
        felt = response.misalignment
        response.success = felt.contact = felt.sure = felt.in_range = True
        felt.angle_stddev, felt.vertical_stddev, felt.horizontal_stddev = 0.001, 1e-5, 1e-5
        return response

    nodes = tuple(name for name in quick_scene.nodes if name != "misalignment_node")
    with RunningCharger(replace(quick_scene, nodes=nodes), context) as charger:
        closed = closings(charger)
        liar = spin(Node("liar", **options(context, charger.namespace)))
        liar.create_service(PredictMisalignment, "predict_misalignment", lie)
        service = f"/{charger.namespace}/predict_misalignment"
        wait_until(lambda: charger.node("docking_node").count_services(service) == 1, "the liar")
        outcome = charger.dock()
        assert closed
        assert not any(closed)
        assert outcome.error_name == "TACTILE_STALE", outcome
        assert "confirmed" in outcome.error_message
