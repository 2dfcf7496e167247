# SPDX-License-Identifier: Apache-2.0
"""All messages of a complete charger, before and during a goal: frames in every header, diagnostics as in REP 107."""

from __future__ import annotations

import importlib
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Header

from deltacharger_records.recording.mcap_recording import TOPICS
from deltacharger_ros.outcomes import DockRequest

from ..chargers import Spin, wait_until
from ..nodes import options
from ..quick import quick_simulation
from ..running_charger import RunningCharger

pytestmark = [pytest.mark.ros, pytest.mark.rest]

NAME = re.compile(r"(\w+/)*\w+: \S.*")
NOT_KNOWN = re.compile(r"\b(None|nan|NaN|inf)\b")
HARDWARE = {
    "servo_node": r"/.+",
    "tactile_node": r"/.+",
    "camera_node": r".+",
}
"""hardware_id by node: ports, and the expected camera."""
QUIET = {"/rosout", "/parameter_events", "/diagnostics"}  # no data with a frame
OF_A_GOAL = {"joint_trajectory", "docking_state", "docking_decision", "end_effector_pose", "electrode_detection"}
"""Published during a goal; the detection once, at its very beginning."""


def type_of(name: str) -> Any:
    """Return the class of a type by its name in the graph."""
    package, kind, rest = name.split("/")
    module = importlib.import_module(f"{package}.{kind}")
    if kind == "action":
        return getattr(module, rest.removesuffix("_FeedbackMessage")).Impl.FeedbackMessage
    return getattr(module, rest)


def headers(message: Any) -> Iterator[Header]:
    """Yield every header in a message."""
    if isinstance(message, Header):
        yield message
        return
    for field in getattr(message, "get_fields_and_field_types", dict)():
        for each in value if isinstance(value := getattr(message, field), list) else [value]:
            if hasattr(each, "get_fields_and_field_types"):
                yield from headers(each)


class Listener(Node):
    """Receives every topic of a namespace, and diagnostics.

    Attributes:
        frames: frame_ids of every header so far, by topic.
        statuses: so far, of this namespace.
        heard: names of the subscribed topics.
        offered: quality of service of the first publisher of each.
    """

    def __init__(self, context: Any, namespace: str) -> None:
        super().__init__("listener", **options(context, namespace))
        self.frames: dict[str, set[str]] = defaultdict(set)
        self.statuses: list[DiagnosticStatus] = []
        self.heard: set[str] = set(QUIET)
        self.offered: dict[str, QoSProfile] = {}
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)
        self.create_timer(0.2, self._look)

    def _look(self) -> None:
        for name, (kind, *_) in self.get_topic_names_and_types():
            ours = name.startswith(f"{self.get_namespace()}/") and not name.endswith("/_action/status")
            offered = [end.qos_profile for end in self.get_publishers_info_by_topic(name)]
            if not ours or name in self.heard or not offered:
                continue
            quality = QoSProfile(depth=100, reliability=offered[0].reliability, durability=offered[0].durability)
            self.create_subscription(type_of(kind), name, self._receiver(name), quality)
            self.heard.add(name)
            self.offered[name.removeprefix(f"{self.get_namespace()}/")] = quality

    def _receiver(self, topic: str) -> Callable[[Any], None]:
        return lambda message: self.frames[topic].update(each.frame_id for each in headers(message))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        ours = self.get_namespace().lstrip("/")
        self.statuses += [each for each in message.status if each.name.lstrip("/").startswith(f"{ours}/")]


@pytest.fixture
def listener(context: Any, namespace: str, spin: Spin, tmp_path: Path) -> Listener:
    """A charger of all nodes but the mission's, with all its messages from the first to the end of a goal."""
    pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")
    scene = quick_simulation("camera")
    recorder = {"docking_recorder_node": {"folder": str(tmp_path)}}
    nodes = (*scene.nodes, "camera_node", "docking_recorder_node")
    scene = replace(scene, nodes=nodes, parameters={**scene.parameters, **recorder})
    heard: Listener = spin(Listener(context, namespace))
    silent = ("simulated_camera", "kinematics", "misalignment")
    told = {name for name in nodes if not name.startswith(silent)}
    apart = [name for name in nodes if name.startswith(("camera", "simulated_camera", "electrode"))]
    with RunningCharger(scene, context, apart, namespace=namespace) as charger:
        wait_until(lambda: diagnosed(heard) >= told, "diagnostics of every node before a goal")
        wait_until(lambda: names(heard.heard) >= OF_A_GOAL, "a subscription to every topic of a goal")
        assert charger.dock(DockRequest(None)).success
        assert charger.undock().success
    return heard


def names(topics: Iterable[str]) -> set[str]:
    return {topic.rpartition("/")[2] for topic in topics}


def diagnosed(listener: Listener) -> set[str]:
    return {each.name.partition(":")[0].rpartition("/")[2] for each in listener.statuses}


def test_every_header_has_a_frame_and_every_diagnostic_known_values_only(listener: Listener) -> None:
    frames = {topic: found for topic, found in listener.frames.items() if found}
    assert {topic: found for topic, found in frames.items() if "" in found} == {}
    assert names(frames) >= OF_A_GOAL | {"servo_state", "joint_states", "tactile_frame", "charger_power"}
    wrong = [each.name for each in listener.statuses if not NAME.fullmatch(each.name)]
    wrong += [f"{each.name}: {each.message}" for each in listener.statuses if NOT_KNOWN.search(each.message)]
    for status in listener.statuses:
        wrong += [f"{status.name} {each.key}={each.value}" for each in status.values if NOT_KNOWN.search(each.value)]
        node = status.name.partition(":")[0].rpartition("/")[2]
        if not re.fullmatch(HARDWARE.get(node, ".*"), status.hardware_id):
            wrong.append(f"{status.name}: hardware_id '{status.hardware_id}'")
    assert sorted(set(wrong)) == []
    recorded = {topic.name: topic.qos for topic in TOPICS if topic.name in listener.offered}
    assert set(recorded) > OF_A_GOAL, "a recording tells what their publishers offer"
    for name, told in recorded.items():
        offered = listener.offered[name]
        assert (name, told.reliability, told.durability) == (name, offered.reliability, offered.durability)
