# SPDX-License-Identifier: Apache-2.0
"""All messages of a complete charger, before and during a goal: frames in headers, known values in diagnostics."""

from __future__ import annotations

import importlib
import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Header

from deltacharger_ros.outcomes import DockRequest

from ..chargers import Spin, wait_until
from ..nodes import options
from ..quick import quick_simulation
from ..running_charger import RunningCharger

pytestmark = [pytest.mark.ros, pytest.mark.rest]

NOT_KNOWN = re.compile(r"\b(None|nan|NaN|inf)\b")
OF_A_GOAL = {"joint_trajectory", "docking_state", "docking_decision", "end_effector_pose", "electrode_detection"}
"""Published during a goal; the detection once, at its very beginning."""


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
    """Receives every topic of messages in its namespace: frame_ids of all headers by topic, and diagnostics."""

    def __init__(self, context: Any, namespace: str) -> None:
        super().__init__("listener", **options(context, namespace))
        self.frames: dict[str, set[str]] = defaultdict(set)
        self.statuses: list[DiagnosticStatus] = []
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)
        self.create_timer(0.2, self._look)

    def _look(self) -> None:
        for name, (kind, *_) in self.get_topic_names_and_types():
            package, of, type_name = kind.split("/")
            topic = name.removeprefix(f"{self.get_namespace()}/")
            offered = self.get_publishers_info_by_topic(name)
            if "/" in topic or topic in self.frames or of != "msg" or not offered:
                continue
            quality = offered[0].qos_profile
            quality = QoSProfile(depth=100, reliability=quality.reliability, durability=quality.durability)
            found = self.frames[topic]
            self.create_subscription(
                getattr(importlib.import_module(f"{package}.msg"), type_name),
                name,
                lambda message, found=found: found.update(each.frame_id for each in headers(message)),
                quality,
            )

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        ours = self.get_namespace().lstrip("/")
        self.statuses += [each for each in message.status if each.name.lstrip("/").startswith(f"{ours}/")]


def test_every_header_has_a_frame_and_every_diagnostic_known_values_only(
    context: Any, namespace: str, spin: Spin, tmp_path: Path
) -> None:
    pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")
    scene = quick_simulation("camera")
    recorder = {"docking_recorder_node": {"folder": str(tmp_path)}}
    nodes = (*scene.nodes, "camera_node", "docking_recorder_node")
    scene = replace(scene, nodes=nodes, parameters={**scene.parameters, **recorder})
    heard: Listener = spin(Listener(context, namespace))
    apart = [name for name in nodes if name.startswith(("camera", "simulated_camera", "electrode"))]
    with RunningCharger(scene, context, apart, namespace=namespace) as charger:
        wait_until(lambda: set(heard.frames) >= OF_A_GOAL, "a subscription to every topic of a goal")
        assert charger.dock(DockRequest(None)).success
        assert charger.undock().success
    frames = {topic: found for topic, found in heard.frames.items() if found}
    assert {topic: found for topic, found in frames.items() if "" in found} == {}
    assert set(frames) >= OF_A_GOAL | {"servo_state", "joint_states", "tactile_frame", "charger_power"}
    texts = {text for each in heard.statuses for text in (each.message, *(value.value for value in each.values))}
    assert len(texts) > 10
    assert [text for text in texts if NOT_KNOWN.search(text)] == []
