# SPDX-License-Identifier: Apache-2.0
"""Goals of a charger in frames of tf, and the frames that two chargers write, over real topics and actions."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator
from typing import Any

import pytest
from deltacharger.action import Dock
from deltacharger.msg import DockingDecision

from deltacharger_core.rotation import Pose as Numbers
from deltacharger_core.rotation import composed
from deltacharger_ros import qos
from deltacharger_ros.messages import CODES
from deltacharger_ros.tf_tree import installed
from deltacharger_scenes.overrides import Overrides, override
from deltacharger_scenes.scene import Scene

from ..chargers import Spin, wait_until
from ..running_charger import RunningCharger
from ..transforms import WITHOUT_TF, Robot
from .raw_goals import RawGoals
from .raw_goals import pose as goal_at

pytestmark = [pytest.mark.ros, pytest.mark.rest]

with_tf = pytest.mark.skipif(not installed(), reason=WITHOUT_TF)
MOUNT: Numbers = (0.31, -0.02, 0.42, 0.5, 0.5, 0.5, 0.5)
TARGET: Numbers = (0.004, -0.003, 0.080, 0.0, 0.0, 0.0, 1.0)


class Framed:
    """A charger of mocks that is given Dock goals in frames."""

    def __init__(self, running: RunningCharger) -> None:
        self.running = running
        self.decisions: list[DockingDecision] = []
        running.client.node.create_subscription(
            DockingDecision, "docking_decision", self.decisions.append, qos.DEFAULT_DEPTH
        )
        self._raw = RawGoals(running.client)

    def dock(self, frame: str, pose: Numbers) -> Dock.Result:
        place, (a, b, c, w) = pose[:3], pose[3:]
        return self._raw.result(goal_at(*place, frame=frame, x=a, y=b, z=c, w=w))

    def accepted(self) -> DockingDecision:
        """Return the decision with the last goal's place."""
        wait_until(lambda: any(each.kind == "accepted" for each in self.decisions), "the decision")
        return next(each for each in reversed(self.decisions) if each.kind == "accepted")


@contextlib.contextmanager
def framed(scene: Scene, context: Any, prefix: str) -> Iterator[Framed]:
    with RunningCharger(override(scene, Overrides(frame_prefix=prefix)), context) as running:
        yield Framed(running)


@with_tf
@pytest.mark.version
def test_it_docks_at_a_goal_in_map_only_while_localization_runs(quick_scene: Scene, context: Any, spin: Spin) -> None:
    with framed(quick_scene, context, "left/") as charger:
        robot = spin(Robot(context))
        wait_until(lambda: robot.heard, "docking_node")
        robot.fix("base_link", "left/charger_base", MOUNT)
        base: Numbers = (4.0, -2.0, 0.0, 0.0, 0.0, math.sin(0.7), math.cos(0.7))
        robot.move(("map", "base_link", base), when=time.time() - 60.0)
        for frame, retriable in (("charger_base", False), ("map", True)):
            refused = charger.dock(frame, TARGET)
            assert (CODES[refused.error_code], refused.retriable) == ("REJECTED", retriable), refused.error_message
        assert not charger.running.node("mock_servo_node").torque_enabled
        localization = robot.create_timer(0.02, lambda: robot.move(("map", "base_link", base)))
        result = charger.dock("map", composed(composed(base, MOUNT), TARGET))
        assert result.success, result.error_message
        accepted = charger.accepted()
        values = dict(zip(accepted.names, accepted.values, strict=True))
        assert [values[f"{axis}_m"] for axis in "xyz"] == pytest.approx(TARGET[:3], abs=1e-9)
        assert values["roll_rad"] == pytest.approx(0.0, abs=1e-9)
        assert accepted.header.frame_id == "left/charger_base"
        localization.cancel()


def test_all_frames_that_two_chargers_publish_are_their_own(quick_scene: Scene, context: Any) -> None:
    """With tf or without: data in the frames of one charger are not used for the other."""
    with framed(quick_scene, context, "left/") as left, framed(quick_scene, context, "right/") as right:
        for charger, prefix, foreign in ((left, "left/", "right/"), (right, "right/", "left/")):
            received = _frame_ids(charger)
            result = charger.dock("", TARGET)  # by the camera, so that a detection is published
            assert result.success, result.error_message
            wait_until(lambda received=received: all(received.values()), "a message of each topic")
            assert {frame.removesuffix("charger_base").removesuffix("end_effector") for frame in received.values()} == {
                prefix
            }
            assert result.misalignment.header.frame_id == f"{prefix}end_effector"
            assert charger.running.dock().success, "the client names the frame by itself"
            assert charger.dock(f"{prefix}charger_base", TARGET).success
            assert CODES[charger.dock(f"{foreign}charger_base", TARGET).error_code] == "REJECTED"


def _frame_ids(charger: Framed) -> dict[str, str]:
    """Return the frame_id of each topic of a charger that has one, after its first message."""
    node: Any = charger.running.client.node
    assert charger.running.composition is not None
    own = [each.node for each in charger.running.composition.nodes]
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
