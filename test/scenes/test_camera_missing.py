# SPDX-License-Identifier: Apache-2.0
"""A charger without its camera's libraries still docks to coordinates, and finds the camera's once it is installed."""

from __future__ import annotations

import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from deltacharger_ros.outcomes import DockRequest
from deltacharger_scenes.scene import Scene

from ..chargers import Spin, wait_until
from ..nodes import options
from ..running_charger import RunningCharger, up

pytestmark = [pytest.mark.ros, pytest.mark.rest]

ABSENT = "raise ModuleNotFoundError('No module named {0}', name='{0}')\n"
INSTALLED = "class Device:\n    getAllAvailableDevices = staticmethod(list)\n"


@pytest.mark.parametrize(
    ("missing", "part", "why"),
    [
        ("depthai", "camera_node: camera", "depthai is not installed"),
        ("cv2", "electrode_detector_node: detector", "OpenCV is not installed"),
    ],
)
def test_a_charger_without_its_camera_docks_to_coordinates(
    quick_scene: Scene,
    context: Any,
    namespace: str,
    spin: Spin,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    missing: str,
    part: str,
    why: str,
) -> None:
    heard: list[DiagnosticStatus] = []
    node: Node = spin(Node("listener", **options(context)))
    node.create_subscription(DiagnosticArray, "/diagnostics", lambda message: heard.extend(message.status), 10)

    def await_error(text: str) -> None:
        heard.clear()
        wait_until(
            lambda: any(
                (each.name, each.level) == (f"{namespace}/{part}", DiagnosticStatus.ERROR) and text in each.message
                for each in list(heard)
            ),
            f"'{text}'",
        )

    module = tmp_path / f"{missing}.py"
    module.write_text(ABSENT.format(missing))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    others = tuple(name for name in quick_scene.nodes if name != "mock_detector_node")
    blind = replace(quick_scene, nodes=(*others, "camera_node", "electrode_detector_node"))
    with RunningCharger(blind, context, command=up, namespace=namespace) as charger:
        await_error(why)
        outcome = charger.dock(DockRequest(None))
        assert outcome.error_name == "ELECTRODES_NOT_FOUND", outcome
        assert "no images" in outcome.error_message or why in outcome.error_message
        charger.charge()
        if missing == "depthai":
            module.write_text(INSTALLED)
            await_error("no OAK camera found")
        charger.signal(signal.SIGTERM)
        assert charger.processes["charger"].end() == 0
        source = f"[{namespace}.{part.split(':')[0]}]"
        logged = [line for line in charger.processes["charger"].err if why in line and source in line]
        assert len(logged) == 1, logged
