# SPDX-License-Identifier: Apache-2.0
"""A charger without a camera, or without the camera's libraries, still docks to coordinates."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from deltacharger_ros.outcomes import DockRequest
from deltacharger_scenes.scene import Scene, parse_scene

from ..chargers import Process, Spin, wait_until
from ..nodes import options
from ..running_charger import RunningCharger, node_command, up

pytestmark = [pytest.mark.ros, pytest.mark.rest]

ABSENT = "raise ModuleNotFoundError('No module named {0}', name='{0}')\n"
INSTALLED = """
class Device:
    broken = True

    @classmethod
    def getAllAvailableDevices(cls):
        if cls.broken:
            cls.broken = False
            raise OSError("USB: no access")
        return []
"""
Shadow = Callable[[str, str], None]
Await = Callable[[str, str], DiagnosticStatus]


@pytest.fixture
def shadow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Shadow:
    """Put a module with the given text before the installed one, for processes started from now on."""
    folder = tmp_path / "shadow"
    folder.mkdir()
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=":")
    return lambda name, text: (folder / f"{name}.py").write_text(text.format(name), encoding="utf-8") and None


@pytest.fixture
def await_status(context: Any, spin: Spin) -> Await:
    """Wait for the next status of a part with a text, and return it."""
    heard: list[DiagnosticStatus] = []
    node: Node = spin(Node("listener", **options(context)))
    node.create_subscription(DiagnosticArray, "/diagnostics", lambda message: heard.extend(message.status), 10)

    def wait(part: str, text: str) -> DiagnosticStatus:
        found = wait_until(
            lambda: [each for each in list(heard) if each.name == part and text in each.message], f"'{text}' of {part}"
        )
        heard.clear()
        return found[0]

    return wait


def test_camera_node_runs_without_depthai_and_finds_it_once_installed(
    start: Callable[..., Process], shadow: Shadow, await_status: Await, namespace: str
) -> None:
    shadow("depthai", ABSENT)
    scene = parse_scene({"nodes": ["camera_node"]}, "alone")
    process, part = start(*node_command(scene, "camera_node", namespace)), f"{namespace}/camera_node: camera"
    for text in ("depthai is not installed",) * 2:
        status = await_status(part, text)
        assert (status.level, status.hardware_id) == (DiagnosticStatus.ERROR, "OAK-D")
    shadow("depthai", INSTALLED)
    await_status(part, "USB: no access")
    await_status(part, "no OAK camera found")
    assert process.end(signal.SIGINT) == 0
    assert sum("depthai is not installed" in line for line in process.err) == 1, process.err


@pytest.mark.parametrize(
    ("nodes", "missing", "part", "why"),
    [
        (("camera_node",), "depthai", "camera_node: camera", "depthai is not installed"),
        (("camera_node",), "cv2", "electrode_detector_node: detector", "OpenCV is not installed"),
    ],
)
def test_a_charger_without_its_camera_docks_to_coordinates(
    shadow: Shadow,
    await_status: Await,
    quick_scene: Scene,
    context: Any,
    namespace: str,
    nodes: tuple[str, ...],
    missing: str,
    part: str,
    why: str,
) -> None:
    shadow(missing, ABSENT)
    others = tuple(name for name in quick_scene.nodes if name != "mock_detector_node")
    blind = replace(quick_scene, nodes=(*others, *nodes, "electrode_detector_node"))
    with RunningCharger(blind, context, command=up, namespace=namespace) as charger:
        status = await_status(f"{namespace}/{part}", why)
        assert status.level == DiagnosticStatus.ERROR
        outcome = charger.dock(DockRequest(None))
        assert outcome.error_name == "ELECTRODES_NOT_FOUND", outcome
        assert why in outcome.error_message
        charger.charge()
        charger.signal(signal.SIGTERM)
        assert charger.processes["charger"].end() == 0
