# SPDX-License-Identifier: Apache-2.0
"""Composition: a failed start leaves nothing running, and the simulated charger closes last."""

import threading
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.scenes.composition import Composition
from deltacharger_bringup.scenes.scene import parse_scene
from deltacharger_core.ros.node_support import StartupError

pytestmark = pytest.mark.ros


def spinning() -> set[str]:
    return {thread.name for thread in threading.enumerate() if thread.name.startswith("spin ")}


def test_a_node_that_rejects_its_parameters_ends_the_running_ones(context: Any, namespace: str) -> None:
    before = spinning()
    nodes = ["mock_servo_node", "mock_detector_node", "docking_node"]
    scene = parse_scene({"nodes": nodes, "parameters": {"docking_node": {"standof": 0.01}}}, "broken")
    composition = Composition(scene, context, namespace)
    with pytest.raises(StartupError, match="did you mean 'standoff'"):
        composition.start()
    assert composition.nodes == {}
    assert spinning() == before


@pytest.mark.version
def test_they_close_in_the_reverse_order_even_if_one_fails(
    context: Any, namespace: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed: list[str] = []
    scene = parse_scene({"nodes": ["mock_servo_node", "kinematics_node", "mock_detector_node"]}, "three")
    composition = Composition(scene, context, namespace).start()
    for name, spinner in composition.nodes.items():
        monkeypatch.setattr(spinner.node, "close", noting(spinner.node, name, closed), raising=False)
    with pytest.raises(RuntimeError, match="kinematics_node does not close"):
        composition.close()
    assert list(dict.fromkeys(closed)) == list(reversed(scene.start_order()))
    assert composition.nodes == {}


def noting(node: Any, name: str, closed: list[str]) -> Any:
    close = getattr(node, "close", lambda: None)

    def note_and_close() -> None:
        closed.append(name)
        close()
        if name == "kinematics_node":
            raise RuntimeError("kinematics_node does not close")

    return note_and_close


@pytest.mark.version
def test_a_simulated_charger_serves_its_own_nodes_and_removes_its_ports(context: Any, namespace: str) -> None:
    scene = parse_scene({"nodes": ["servo_node", "tactile_node"], "simulation": {}}, "x")
    with Composition(scene, context, namespace) as composition:
        ports = composition.ports()
        assert composition.node("servo_node").get_parameter("port").value == ports["servo"]
        assert composition.node("tactile_node").get_parameter("port").value == ports["board"]
    assert not any(Path(port).exists() for port in ports.values())
    assert composition.charger is None
