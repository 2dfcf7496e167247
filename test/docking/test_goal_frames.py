# SPDX-License-Identifier: Apache-2.0
"""Goals of a charger in frames of tf, and the frames that two chargers write, over real topics and actions."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Any

import pytest
from deltacharger.action import Dock
from deltacharger.msg import DockingDecision
from rclpy.action.client import ActionClient

from deltacharger_core.rotation import Pose as Numbers
from deltacharger_core.rotation import composed
from deltacharger_ros import qos
from deltacharger_ros.client import ChargerClient
from deltacharger_ros.messages import CODES
from deltacharger_ros.outcomes import DockRequest, Pose
from deltacharger_ros.tf_tree import installed
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.overrides import Overrides, override
from deltacharger_scenes.scene import Scene

from ..chargers import DEADLINE, Spin, new_namespace, wait_until
from ..nodes import answer
from ..transforms import WITHOUT_TF, Robot

pytestmark = pytest.mark.ros

with_tf = pytest.mark.skipif(not installed(), reason=WITHOUT_TF)
MOUNT: Numbers = (0.31, -0.02, 0.42, 0.5, 0.5, 0.5, 0.5)
TARGET: Numbers = (0.004, -0.003, 0.080, 0.0, 0.0, 0.0, 1.0)


class Charger:
    """A charger of mocks that is given Dock goals in frames."""

    def __init__(self, scene: Scene, context: Any, prefix: str) -> None:
        namespace = new_namespace()
        self.composition = Composition(override(scene, Overrides(frame_prefix=prefix)), context, namespace).start()
        self.client = ChargerClient(namespace, context)
        assert self.client.wait_until_it_answers(DEADLINE)
        self.decisions: list[DockingDecision] = []
        node = self.client.node
        node.create_subscription(DockingDecision, "docking_decision", self.decisions.append, qos.DEFAULT_DEPTH)
        self._docks: Any = ActionClient(node, Dock, "dock")
        self.client.waitables.append(self._docks)
        wait_until(self._docks.server_is_ready, "the action")

    def dock(self, frame: str, pose: Numbers) -> Dock.Result:
        return answer(self.send(frame, pose).get_result_async()).result

    def send(self, frame: str, pose: Numbers) -> Any:
        """Return the handle of a goal."""
        goal = Dock.Goal()
        goal.electrodes.header.frame_id = frame
        place, turn = goal.electrodes.pose.position, goal.electrodes.pose.orientation
        place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = pose
        return answer(answer(self.client.node.executor.call_soon(self._docks.send_goal_async, goal)))

    def taken(self) -> DockingDecision:
        """Return the decision with the last goal's place."""
        wait_until(lambda: any(each.kind == "accepted" for each in self.decisions), "the decision")
        return next(each for each in reversed(self.decisions) if each.kind == "accepted")

    def close(self) -> None:
        self.composition.close()
        self.client.close()


@pytest.fixture
def charger(quick_scene: Scene, context: Any) -> Iterator[Charger]:
    charger = Charger(quick_scene, context, "left/")
    yield charger
    charger.close()


@with_tf
def test_it_docks_at_a_goal_in_map_while_localization_runs(charger: Charger, context: Any, spin: Spin) -> None:
    robot = spin(Robot(context))
    wait_until(lambda: robot.heard, "docking_node")
    robot.fix("base_link", "left/charger_base", MOUNT)
    base: Numbers = (4.0, -2.0, 0.0, 0.0, 0.0, math.sin(0.7), math.cos(0.7))
    localization = robot.create_timer(0.02, lambda: robot.move(("map", "base_link", base)))
    result = charger.dock("map", composed(composed(base, MOUNT), TARGET))
    assert result.success, result.error_message
    taken = charger.taken()
    values = dict(zip(taken.names, taken.values, strict=True))
    assert [values[f"{axis}_m"] for axis in "xyz"] == pytest.approx(TARGET[:3], abs=1e-9)
    assert values["roll_rad"] == pytest.approx(0.0, abs=1e-9)
    assert taken.header.frame_id == "left/charger_base"
    localization.cancel()


@with_tf
def test_a_goal_without_a_transform_moves_nothing(charger: Charger, context: Any, spin: Spin) -> None:
    robot = spin(Robot(context))
    wait_until(lambda: robot.heard, "docking_node")
    robot.fix("base_link", "left/charger_base", MOUNT)
    unknown = charger.dock("charger_base", TARGET)
    assert (CODES[unknown.error_code], unknown.retriable) == ("REJECTED", False)
    assert "'charger_base'" in unknown.error_message
    assert "left/charger_base" in unknown.error_message
    robot.move(("map", "base_link", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)), when=time.time() - 60.0)
    stale = charger.dock("map", TARGET)
    assert (CODES[stale.error_code], stale.retriable) == ("REJECTED", True), "it may come back"
    assert "s old" in stale.error_message
    assert not charger.composition.node("mock_servo_node").torque_enabled


@with_tf
def test_a_busy_charger_reads_no_tf_for_another_goal(charger: Charger) -> None:
    first = charger.send("left/charger_base", TARGET)
    wait_until(lambda: any(each.kind == "accepted" for each in charger.decisions), "the first goal")
    second = charger.dock("map", TARGET)
    assert (CODES[second.error_code], second.retriable) == ("REJECTED", True)
    assert "another goal is being served" in second.error_message
    assert charger.composition.node("docking_node")._frames._tf._buffer is None
    assert answer(first.get_result_async()).result.success


def test_the_client_sends_goals_in_charger_base_with_any_prefix(charger: Charger) -> None:
    outcome = charger.client.dock(DockRequest(Pose(*TARGET[:3])), deadline=DEADLINE)
    assert outcome.success, outcome.error_message


def test_all_frames_that_two_chargers_publish_are_their_own(quick_scene: Scene, context: Any, spin: Spin) -> None:
    """With tf or without: data in the frames of one charger are not used for the other."""
    prefixes = ("left/", "right/")
    chargers = [Charger(quick_scene, context, prefix) for prefix in prefixes]
    try:
        for charger, prefix in zip(chargers, prefixes, strict=True):
            received = _frame_ids(charger)
            result = charger.dock("", TARGET)  # by the camera, so that a detection is published
            assert result.success, result.error_message
            wait_until(lambda received=received: all(received.values()), "a message of each topic")
            assert {frame.removesuffix("charger_base").removesuffix("end_effector") for frame in received.values()} == {
                prefix
            }
            assert result.misalignment.header.frame_id == f"{prefix}end_effector"
            assert charger.dock(f"{prefix}charger_base", TARGET).success
            other = charger.dock(f"{prefixes[prefix == 'left/']}charger_base", TARGET)
            assert CODES[other.error_code] == "REJECTED", other.error_message
    finally:
        for charger in chargers:
            charger.close()


def _frame_ids(charger: Charger) -> dict[str, str]:
    """Return the frame_id of each topic of a charger that has one, after its first message."""
    node: Any = charger.client.node
    own = [each.node for each in charger.composition.nodes]
    ends = {each.topic_name: each.msg_type for every in own for each in every.publishers}
    stamped = {name: kind for name, kind in ends.items() if "header" in kind.get_fields_and_field_types()}
    received = {name: "" for name in stamped if not name.endswith(("diagnostics", "trajectory", "misalignment"))}
    assert len(received) >= 8, sorted(received)
    for name in received:
        node.create_subscription(
            stamped[name],
            name,
            lambda message, name=name: received.__setitem__(name, message.header.frame_id),
            qos.SENSOR,
        )
    return received
