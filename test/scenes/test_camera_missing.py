# SPDX-License-Identifier: Apache-2.0
"""A charger without a camera, or without the camera's libraries, still docks to coordinates."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from deltacharger_docking.codes import Code
from deltacharger_ros.client import ChargerClient
from deltacharger_ros.outcomes import DockRequest, Pose
from deltacharger_scenes.scene import parse_scene

from ..chargers import DEADLINE, Process, Spin, dock_at_last, wait_until
from ..nodes import options
from .test_processes import arguments

pytestmark = pytest.mark.ros

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
Start = Callable[..., Process]
Shadow = Callable[[str, str], None]


@pytest.fixture
def shadow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Shadow:
    """Put a module with the given text before the installed one, for processes started from now on."""
    folder = tmp_path / "shadow"
    folder.mkdir()
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=":")
    return lambda name, text: (folder / f"{name}.py").write_text(text.format(name), encoding="utf-8") and None


@pytest.fixture
def seen(context: Any, spin: Spin) -> list[DiagnosticStatus]:
    heard: list[DiagnosticStatus] = []
    node: Node = spin(Node("listener", **options(context)))
    node.create_subscription(DiagnosticArray, "/diagnostics", lambda message: heard.extend(message.status), 10)
    return heard


def await_status(seen: list[DiagnosticStatus], name: str, level: bytes, text: str) -> DiagnosticStatus:
    """Wait for a status, and return it."""
    found: list[DiagnosticStatus] = []

    def came() -> bool:
        found[:] = [each for each in list(seen) if (each.name, each.level) == (name, level) and text in each.message]
        return bool(found)

    wait_until(came, f"'{text}' from {name}")
    return found[0]


def test_camera_node_runs_without_depthai_and_finds_it_once_installed(
    start: Start, shadow: Shadow, seen: list[DiagnosticStatus], namespace: str
) -> None:
    shadow("depthai", ABSENT)
    scene = parse_scene({"nodes": ["camera_node"]}, "alone")
    process, part = start(*arguments(scene, "camera_node", namespace)), f"{namespace}/camera_node: camera"
    for text in ("depthai is not installed: install it with pip install 'deltacharger[oak]'",) * 2:
        assert await_status(seen, part, DiagnosticStatus.ERROR, text).hardware_id == "OAK-D"
        seen.clear()
    shadow("depthai", INSTALLED)
    await_status(seen, part, DiagnosticStatus.ERROR, "USB: no access")
    await_status(seen, part, DiagnosticStatus.ERROR, "no OAK camera found: plug it in")
    assert process.end(signal.SIGINT) == 0
    assert sum("depthai is not installed" in line for line in process.err) == 1, process.err


@pytest.mark.parametrize(
    ("nodes", "missing", "part", "why"),
    [
        (["camera_node"], "depthai", "camera_node: camera", "depthai is not installed"),
        (["camera_node"], "cv2", "electrode_detector_node: detector", "OpenCV is not installed"),
        ([], "", "electrode_detector_node: detector", "no publisher"),
    ],
    ids=["depthai", "opencv", "no driver"],
)
def test_a_charger_without_its_camera_docks_to_coordinates(
    start: Start,
    shadow: Shadow,
    seen: list[DiagnosticStatus],
    deltacharger: tuple[str, ...],
    quick_file: Path,
    tmp_path: Path,
    context: Any,
    namespace: str,
    nodes: list[str],
    missing: str,
    part: str,
    why: str,
) -> None:
    if missing:
        shadow(missing, ABSENT)
    scene = yaml.safe_load(quick_file.read_text(encoding="utf-8"))
    at = scene["nodes"].index("mock_detector_node")
    scene["nodes"][at : at + 1] = [*nodes, "electrode_detector_node"]
    (tmp_path / "blind.yaml").write_text(yaml.safe_dump(scene), encoding="utf-8")
    process = start(*deltacharger, "up", "--scene", str(tmp_path / "blind.yaml"), "--namespace", namespace)
    with ChargerClient(namespace, context) as client:
        assert client.wait_until_ready(DEADLINE), process.err
        await_status(seen, f"{namespace}/{part}", DiagnosticStatus.ERROR if missing else DiagnosticStatus.WARN, why)
        blind = client.dock(DockRequest(None), deadline=DEADLINE)
        assert blind.error_code == Code.ELECTRODES_NOT_FOUND, blind
        assert why in blind.error_message, blind
        dock_at_last(client, DockRequest(Pose(0.0, 0.0, 0.080)))
    assert process.end(signal.SIGTERM) == 0, process.err
