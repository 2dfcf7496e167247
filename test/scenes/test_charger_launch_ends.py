# SPDX-License-Identifier: Apache-2.0
"""How `ros2 launch` of charger.launch.py ends: 0 after Ctrl-C; 1 and a reason if a part has ended or refuses.

Without launch: test_up_and_dock.py has the exit codes of `deltacharger up`, test_scene_overrides.py the refused
arguments, test_processes.py a node with a missing port, test_killed_nodes.py killed nodes.
"""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions

from deltacharger_ros.client import ChargerClient
from deltacharger_ros.outcomes import DockRequest, Pose

from ..chargers import DEADLINE, Process, dock_at_last, wait_until
from .launched import FILE, PATIENCE, QUICK, QUICK_NODES, domain, need_the_package

pytestmark = pytest.mark.ros

pytest.importorskip("ros2launch", reason="ros2 launch comes with a ROS installation, not from PyPI")
COMMAND = (sys.executable, "-c", "import sys; from ros2cli.cli import main; sys.exit(main())", "launch", str(FILE))
Launch = Callable[..., Process]


@pytest.fixture
def launched(start: Launch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Launch]:
    need_the_package()
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    with domain(4):
        options = {"sigterm_timeout": PATIENCE}
        yield lambda **more: start(*COMMAND, *(f"{name}:={value}" for name, value in (options | more).items()))


def output(process: Process) -> str:
    return "\n".join([*process.out, *process.err])


def pid(process: Process, name: str) -> int:
    """Return the process id of an executable in launch's output."""
    found = re.search(rf"\[{name}-\d+\]: process started with pid \[(\d+)\]", output(process))
    return int(found[1]) if found else 0


def finished_cleanly(process: Process) -> int:
    return output(process).count("process has finished cleanly")


def test_ctrl_c_ends_it_with_0_and_removes_the_emulators_folder(
    launched: Launch, namespace: str, tmp_path: Path
) -> None:
    process = launched(namespace=namespace)
    with ChargerClient(namespace) as client:
        assert client.wait_until_ready(DEADLINE), output(process)
        assert list(tmp_path.glob("deltacharger-*"))
    assert process.end(signal.SIGINT) == 0, output(process)
    assert finished_cleanly(process) == 6, output(process)  # five nodes, and the hardware
    assert not list(tmp_path.glob("deltacharger-*"))


def test_a_killed_docking_node_ends_the_charger_with_1(launched: Launch, namespace: str) -> None:
    process = launched(scene=QUICK, namespace=namespace)
    with ChargerClient(namespace) as client:
        assert client.wait_until_ready(DEADLINE), output(process)
        os.kill(pid(process, "docking_node"), signal.SIGKILL)
        assert process.end() == 1, output(process)
    assert "docking_node ended with code -9; ending the charger" in output(process)
    assert finished_cleanly(process) == QUICK_NODES - 1, output(process)


def test_a_missing_camera_does_not_end_it(
    launched: Launch, namespace: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shadow = tmp_path / "shadow"
    shadow.mkdir()
    for name in ("depthai", "cv2"):
        text = f"raise ModuleNotFoundError('No module named {name}', name='{name}')\n"
        (shadow / f"{name}.py").write_text(text, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(shadow), prepend=":")
    scene = tmp_path / "blind.yaml"
    nodes = "camera_node, electrode_detector_node"
    scene.write_text(QUICK.read_text(encoding="utf-8").replace("mock_detector_node", nodes), encoding="utf-8")
    process = launched(scene=scene, namespace=namespace)
    with ChargerClient(namespace) as client:
        assert client.wait_until_ready(DEADLINE), output(process)
        wait_until(lambda: "depthai is not installed" in output(process), "what camera_node lacks")
        wait_until(lambda: "OpenCV is not installed" in output(process), "what the detector lacks")
        dock_at_last(client, DockRequest(Pose(0.0, 0.0, 0.080)))
    assert process.end(signal.SIGINT) == 0, output(process)
    assert finished_cleanly(process) == QUICK_NODES + 1, output(process)


def test_missing_ports_end_it_with_1_and_are_named(launched: Launch, namespace: str, tmp_path: Path) -> None:
    scene = tmp_path / "mine.yaml"
    scene.write_text("ports: {servo: /dev/no_servo, board: /dev/no_board}\n", encoding="utf-8")
    process = launched(scene=scene, namespace=namespace)
    assert process.end() == 1
    assert re.search(r"/dev/no_(servo|board): there is no such port; plug the adapter in", output(process))
    assert re.search(r"(servo|tactile)_node cannot start as configured; ending the charger", output(process))


def test_mocks_launched_alone_use_the_domain_of_simulated_chargers_and_the_log_states_how_to_reach_them(
    launched: Launch, namespace: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
        monkeypatch.delenv(name)
    process = launched(scene=QUICK, namespace=namespace)
    context = Context()
    rclpy.init(context=context, args=[], domain_id=87, signal_handler_options=SignalHandlerOptions.NO)
    with ChargerClient(namespace, context) as client:
        assert client.wait_until_ready(DEADLINE), output(process)
    rclpy.try_shutdown(context=context)
    assert process.end(signal.SIGINT) == 0
    assert "export ROS_DOMAIN_ID=87 ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST" in output(process)


def test_included_mocks_use_the_domain_of_the_including_launch_file(
    launched: Launch, start: Launch, namespace: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID")
    file = tmp_path / "robot.launch.xml"
    arguments = {"scene": QUICK, "namespace": namespace}
    each = "".join(f'<arg name="{name}" value="{value}"/>' for name, value in arguments.items())
    file.write_text(f'<launch><include file="{FILE}">{each}</include></launch>', encoding="utf-8")
    process = start(*COMMAND[:-1], str(file))
    process.wait_for_line("in ROS domain 0,", process.out)
    assert process.end(signal.SIGINT) == 0, output(process)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"scene": "simulatd"}, "did you mean 'simulated'"),
        ({"scen": "mocks"}, "did you mean 'scene'"),
        ({"camera": "perhaps"}, "give oak, topics, none"),
        ({"log_level": "loud"}, "give one of debug"),
        ({"namespace": "9a-b"}, "not a ROS namespace"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_a_wrong_argument_ends_it_with_1_before_anything_starts(
    launched: Launch, arguments: dict[str, str], expected: str
) -> None:
    process = launched(**arguments)
    assert process.end() == 1
    assert expected in output(process)
    assert "process started" not in output(process)


def test_a_node_that_may_restart_but_refuses_its_parameters_ends_the_charger(
    launched: Launch, namespace: str, tmp_path: Path
) -> None:
    scene = tmp_path / "mine.yaml"
    text = QUICK.read_text(encoding="utf-8").replace("{max_age: 1.0}", "{frames: 0}")
    scene.write_text(text, encoding="utf-8")
    process = launched(scene=scene, namespace=namespace)
    assert process.end() == 1
    assert "misalignment_node cannot start as configured" in output(process)
