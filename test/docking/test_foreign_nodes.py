# SPDX-License-Identifier: Apache-2.0
"""Foreign nodes and frames: second sources are named and keep the contactor open; goals come in frames of tf.

Data in the frames of one charger are not used for another.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Any

import pytest
from deltacharger.action import Dock, Undock
from deltacharger.msg import ChargerPower, ServoState, TactileFrame
from deltacharger.srv import DetectElectrodes, PredictMisalignment, Probe, SetContactor
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action.server import ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from deltacharger_docking import energy
from deltacharger_ros import qos
from deltacharger_scenes.scene import Scene

from ..chargers import Spin, wait_until
from ..nodes import options
from ..running_charger import RunningCharger

pytestmark = [pytest.mark.ros, pytest.mark.rest]

TOPICS: dict[str, Any] = {
    "servo_state": ServoState,
    "tactile_frame": TactileFrame,
    "charger_power": ChargerPower,
    "joint_trajectory": JointTrajectory,
}
SERVICES: dict[str, Any] = {
    "predict_misalignment": PredictMisalignment,
    "detect_electrodes": DetectElectrodes,
    "set_torque": SetBool,
    "tare": Trigger,
    "probe": Probe,
    "set_contactor": SetContactor,
}
ACTIONS: dict[str, Any] = {"dock": Dock, "undock": Undock}
EARLY = 8  # frames sampled before the request that docking accepts: the false server can answer this much earlier
TILT = math.radians(9.0)  # past the clearance rule, before the angle at which the electrodes short


class Liar(Node):
    """Answers predict_misalignment first, with a target without tilt; names the frames it received, or none."""

    def __init__(self, context: Any, namespace: str, names_frames: bool) -> None:
        super().__init__("liar", **options(context, namespace))
        self.answers = 0
        self._heard: deque[int] = deque(maxlen=240)
        self._count = 0
        self._names_frames = names_frames
        self.create_subscription(TactileFrame, "tactile_frame", self._hear, qos.SENSOR)
        group = ReentrantCallbackGroup()  # it may wait
        self.create_service(PredictMisalignment, "predict_misalignment", self._lie, callback_group=group)

    def _hear(self, frame: TactileFrame) -> None:
        self._heard.append(frame.sequence)
        self._count += 1

    def _lie(self, request: Any, response: Any) -> Any:
        self.answers += 1
        felt = response.misalignment
        felt.contact = felt.sure = felt.in_range = True
        felt.angle_stddev, felt.vertical_stddev, felt.horizontal_stddev = 0.001, 1e-5, 1e-5
        response.success = True
        if self._names_frames:
            end = self._count + request.frames - EARLY
            wait_until(lambda: self._count >= end, "frames")
            response.sequences = list(self._heard)[-request.frames :]
        return response


def closings(charger: RunningCharger) -> list[bool]:
    """Collect whether charger_power reports a closed contactor."""
    found: list[bool] = []
    charger.client.node.create_subscription(
        ChargerPower, "charger_power", lambda power: found.append(power.contactor_closed), qos.LATEST
    )
    return found


def test_second_sources_are_named_and_docking_waits_until_they_are_gone(quick_scene: Scene, context: Any) -> None:
    with RunningCharger(quick_scene, context) as charger:
        named = lambda: charger.state.duplicate_sources  # noqa: E731
        texts: list[str] = []
        charger.client.node.create_subscription(
            DiagnosticArray, "/diagnostics", lambda array: texts.extend(each.message for each in array.status), 10
        )
        node = Node("stranger", **options(context, charger.namespace))
        for topic, kind in TOPICS.items():
            node.create_publisher(kind, topic, 1)
        for name, kind in SERVICES.items():
            node.create_service(kind, name, lambda request, response: response)
        servers = [ActionServer(node, kind, name, lambda handle: None) for name, kind in ACTIONS.items()]
        expected = [*TOPICS, *SERVICES, *ACTIONS]
        wait_until(lambda: all(name in named() for name in expected), "every source named")
        assert named().count("/stranger") == len(expected)
        assert named().count("/docking_node") == 1 + len(ACTIONS), "its own trajectories and goals"
        wait_until(lambda: any("stranger" in text for text in texts), "a warning in /diagnostics")
        for server in servers:
            server.destroy()
        node.destroy_node()
        wait_until(lambda: not named(), "no second source")

        node = Node("stranger", **options(context, charger.namespace))
        node.create_publisher(ChargerPower, "charger_power", 1)
        wait_until(named, "a second source")
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


@pytest.mark.parametrize("beside", [True, False])
def test_a_false_angle_estimate_never_closes_the_contactor(
    monkeypatch: pytest.MonkeyPatch, quick_scene: Scene, context: Any, spin: Spin, beside: bool
) -> None:
    """The target is tilted past the rule. Next to the true server it names frames; in its place it names none."""
    monkeypatch.setattr(energy, "_DUPLICATE_SOURCE_TIMEOUT", 0.5)
    tilted = {**quick_scene.parameters["mock_tactile_node"], "target_angle": TILT}
    nodes = tuple(name for name in quick_scene.nodes if beside or name != "misalignment_node")
    scene = replace(quick_scene, nodes=nodes, parameters={**quick_scene.parameters, "mock_tactile_node": tilted})
    with RunningCharger(scene, context) as charger:
        closed = closings(charger)
        liar = spin(Liar(context, charger.namespace, names_frames=beside))
        service = f"/{charger.namespace}/predict_misalignment"
        wait_until(lambda: charger.node("docking_node").count_services(service) == 1 + beside, "the liar")
        outcome = charger.dock()
        assert liar.answers
        assert closed
        assert not any(closed)
        refused = {"DUPLICATE_SOURCE", "CRITICAL_ANGLE", "MISALIGNED", "ESTIMATE_UNSURE"} if beside else set()
        assert outcome.error_name in refused | {"TACTILE_STALE"}, outcome
        assert outcome.error_name != "TACTILE_STALE" or "confirmed" in outcome.error_message
