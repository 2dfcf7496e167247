# SPDX-License-Identifier: Apache-2.0
"""Every node in a separate process, as `ros2 run` starts them: they find each other, dock, and end with 0."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from typing import Any

import pytest

from deltacharger_ros.client import ChargerClient
from deltacharger_ros.outcomes import DockRequest, Pose
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.scene import Scene, parse_scene

from ..chargers import DEADLINE, Process, dock_at_last
from ..marks import rest

pytestmark = pytest.mark.ros


def arguments(scene: Scene, name: str, namespace: str) -> list[str]:
    """Return the command line of one node of a scene."""
    words = [sys.executable, "-c", f"import sys; from {NODES[name].module} import main; sys.exit(main())"]
    words += ["--ros-args", "-r", f"__ns:=/{namespace}"]
    for key, value in scene.node_parameters(name, {}).items():
        words += ["-p", f"{key}:={value}"]
    return words


@pytest.mark.parametrize("number", [signal.SIGINT, rest(signal.SIGTERM)])
def test_nodes_in_processes_dock_and_end_with_0(
    start: Callable[..., Process], quick_scene: Scene, context: Any, namespace: str, number: int
) -> None:
    processes = {name: start(*arguments(quick_scene, name, namespace)) for name in quick_scene.start_order()}
    with ChargerClient(namespace, context) as client:
        assert client.wait_until_ready(DEADLINE), {name: each.err for name, each in processes.items()}
        if number == signal.SIGINT:
            dock_at_last(client, DockRequest(Pose(0.0, 0.0, 0.080)))  # a process that starts late can fail a goal
    for name in reversed(quick_scene.start_order()):
        assert processes[name].end(number) == 0, (name, processes[name].err)


@pytest.mark.parametrize(
    "name", ["mock_servo_node", *map(rest, ("mock_tactile_node", "mock_detector_node", "kinematics_node"))]
)
def test_an_unknown_parameter_ends_a_node_with_2_and_is_named(
    start: Callable[..., Process], quick_scene: Scene, namespace: str, name: str
) -> None:
    process = start(*arguments(quick_scene, name, namespace), "-p", "no_such_parameter:=1")
    assert process.end() == 2
    assert any("no_such_parameter" in line for line in process.err)


@pytest.mark.parametrize("name", ["servo_node", "tactile_node"])
def test_a_missing_port_ends_a_node_with_2_and_a_remedy(
    start: Callable[..., Process], namespace: str, name: str
) -> None:
    scene = parse_scene({"ports": {"servo": "/dev/no_servo", "board": "/dev/no_board"}}, "missing")
    process = start(*arguments(scene, name, namespace))
    assert process.end() == 2
    assert len(process.err) == 1
    assert "there is no such port; plug the adapter in" in process.err[0]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("-r", "__ns:=/bad name"), "ROS refuses"),
        (("--no-such-flag",), "no-such-flag"),
        (("-r", "__node:=bad-name"), "ROS refuses"),
    ],
)
def test_ros_arguments_refused_by_ros_end_a_node_with_2_and_one_line(
    start: Callable[..., Process], quick_scene: Scene, words: tuple[str, ...], expected: str
) -> None:
    process = start(*arguments(quick_scene, "kinematics_node", "x"), *words)
    assert process.end() == 2
    assert any(expected in line for line in process.err), process.err
    assert not any("Traceback" in line for line in process.err)


def test_an_invalid_ros_domain_ends_a_node_with_2(
    start: Callable[..., Process], quick_scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "233")
    process = start(*arguments(quick_scene, "kinematics_node", "x"))
    assert process.end() == 2
    assert len(process.err) == 1
    assert "0 to 232" in process.err[0]
