# SPDX-License-Identifier: Apache-2.0
"""Foreign nodes that publish or serve the charger's inputs: they are named, and the contactor stays open."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from deltacharger.action import Dock, Undock
from deltacharger.msg import TactileFrame
from deltacharger.srv import DetectElectrodes, PredictMisalignment, Probe, SetContactor
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action.server import ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from deltacharger_ros.executor import Spinner
from deltacharger_ros.outcomes import DockRequest
from deltacharger_scenes.scene import Scene

from ..chargers import dock_at_last, wait_until
from ..marks import rest
from ..nodes import options
from .hostile import PLACE, TOPICS, Hostile
from .test_hostile_messages import POWER

pytestmark = pytest.mark.ros

SERVICES: dict[str, Any] = {
    "predict_misalignment": PredictMisalignment,
    "detect_electrodes": DetectElectrodes,
    "set_torque": SetBool,
    "tare": Trigger,
    "probe": Probe,
    "set_contactor": SetContactor,
}
ACTIONS: dict[str, Any] = {"dock": Dock, "undock": Undock}
_EARLY = 8  # frames sampled before the request that docking accepts: the false server can answer this much earlier
TILT = math.radians(9.0)  # past the clearance rule, before the angle at which the electrodes short


class Liar(Node):
    """Answers predict_misalignment first, with a target without tilt; names the frames it received, or none."""

    def __init__(self, context: Any, namespace: str, names_frames: bool) -> None:
        super().__init__("liar", **options(context, namespace))
        self.answers = 0
        self._heard: deque[int] = deque(maxlen=240)
        self._count = 0
        self._names_frames = names_frames
        self.create_subscription(TactileFrame, "tactile_frame", self._hear, qos_profile_sensor_data)
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
            end = self._count + request.frames - _EARLY
            wait_until(lambda: self._count >= end, "frames")
            response.sequences = list(self._heard)[-request.frames :]
        return response


@pytest.fixture(scope="module")
def hostile(quick_scene: Scene, context: Any) -> Iterator[Hostile]:
    hostile = Hostile(quick_scene, context)
    yield hostile
    hostile.close()


def named(hostile: Hostile) -> str:
    return str(hostile.states[-1].duplicate_sources)


def test_every_second_source_is_named_until_it_is_gone(hostile: Hostile) -> None:
    node = Node("stranger", **options(hostile.context, hostile.namespace))
    texts: list[str] = []
    hostile.client.node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda array: texts.extend(status.message for status in array.status), 10
    )
    for topic, (kind, qos) in TOPICS.items():
        node.create_publisher(kind, f"heard/{topic}", qos)
    node.create_publisher(JointTrajectory, "joint_trajectory", 1)
    for name, kind in SERVICES.items():
        node.create_service(kind, name, lambda request, response: response)
    servers = [ActionServer(node, kind, name, lambda handle: None) for name, kind in ACTIONS.items()]
    expected = [*TOPICS, "joint_trajectory", *SERVICES, *ACTIONS]
    wait_until(lambda: all(f"{name}" in named(hostile) for name in expected), "every source named")
    stranger, own = f"/{hostile.namespace}/stranger", f"/{hostile.namespace}/docking_node"
    assert named(hostile).count(stranger) == len(expected)
    assert named(hostile).count(own) == 1 + len(ACTIONS), "its own trajectories and goals"
    wait_until(lambda: any("stranger" in text for text in texts), "a warning in /diagnostics")
    for server in servers:
        server.destroy()
    node.destroy_node()
    wait_until(lambda: not named(hostile), "no second source")


def test_docking_waits_until_a_second_source_disappears_and_reports_a_later_one(hostile: Hostile) -> None:
    node = Node("stranger", **options(hostile.context, hostile.namespace))
    node.create_service(Probe, "probe", lambda request, response: response)
    wait_until(lambda: named(hostile), "a second source")
    closed_at: list[int] = []
    seen = len(hostile.states)

    def watch(message: Any) -> Any:
        if message.contactor_closed:
            closed_at.append(len(hostile.states))
        return message

    hostile.relay.distort[POWER] = watch
    waits = [False]

    def look(progress: Any) -> None:
        if progress.phase == "measure" and not waits[0]:
            waits[0] = True
            assert not closed_at
            node.destroy_node()

    outcome = hostile.dock(look)
    if not outcome.success:  # an estimate that a stalled mock spoilt
        dock_at_last(hostile.client, DockRequest(PLACE))
    assert waits[0]
    assert hostile.is_closed
    assert seen < closed_at[0]
    assert not named(hostile)
    second = Node("stranger", **options(hostile.context, hostile.namespace))
    second.create_publisher(TOPICS[POWER][0], f"heard/{POWER}", 1)
    wait_until(lambda: "stranger" in named(hostile), "a second source while charging")
    assert hostile.is_closed
    second.destroy_node()
    wait_until(lambda: not named(hostile), "no second source")
    assert hostile.is_closed
    hostile.heal()


@pytest.mark.parametrize("beside", [True, rest(False)])
def test_a_false_angle_estimate_never_closes_the_contactor(quick_scene: Scene, context: Any, beside: bool) -> None:
    """The target is tilted past the rule. Next to the true server it names frames; in its place it names none."""
    tilted = ("mock_servo_node", "mock_tactile_node")
    mocks = {name: {**quick_scene.parameters[name], "target_angle": TILT} for name in tilted}
    nodes = tuple(name for name in quick_scene.nodes if beside or name != "misalignment_node")
    scene = replace(quick_scene, nodes=nodes, parameters={**quick_scene.parameters, **mocks})
    hostile = Hostile(scene, context, duplicate_source_timeout=0.5)
    liar = Liar(context, hostile.namespace, names_frames=beside)
    spinner = Spinner(liar)
    closed: list[Any] = []
    try:
        hostile.relay.distort[POWER] = lambda message: (closed.append(message.contactor_closed), message)[1]
        service = f"/{hostile.namespace}/predict_misalignment"
        wait_until(lambda: hostile.docking.count_services(service) == 1 + beside, "the liar")
        outcome = hostile.dock()
        assert liar.answers
        assert not any(closed)
        refused = {"DUPLICATE_SOURCE", "CRITICAL_ANGLE", "MISALIGNED", "ESTIMATE_UNSURE"} if beside else set()
        assert outcome.error_name in refused | {"TACTILE_STALE"}, outcome
        assert outcome.error_name != "TACTILE_STALE" or "not confirmed" in outcome.error_message
    finally:
        spinner.close()
        hostile.close()
