# SPDX-License-Identifier: Apache-2.0
"""`ros2 launch` of charger.launch.py: it docks, keeps scopes apart, restarts nodes that may, and ends safely.

Its exit code is 0 after Ctrl-C; 1, with a reason, if a part has ended or refuses. Without launch: test_stops.py.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.scenes.scene import Scene, parse_scene
from deltacharger_core.ros.client import ChargerClient
from deltacharger_core.ros.outcomes import DockRequest

from ..chargers import DEADLINE, Process, wait_until
from ..quick import QUICK
from ..running_charger import RunningCharger
from .processes import ALARM, CONTAINER, LEADER, OPEN, ROOT, TERMINAL, first, left, needs_containers

pytestmark = [pytest.mark.ros, pytest.mark.night]

pytest.importorskip("ros2launch", reason="ros2 launch comes with a ROS installation, not from PyPI")
FILE = ROOT / "launch" / "charger.launch.py"
LAUNCH = (sys.executable, "-c", "import sys; from ros2cli.cli import main; sys.exit(main())", "launch")
PATIENCE = "60"  # s until launch forces a node to end, so that a loaded computer fails no test
MOCKS = Path(__file__).with_name("quick.yaml")
REAL_NODES = 5
INT, TERM, HUP, KILL = signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL
Launch = Callable[..., Process]


@pytest.fixture(autouse=True)
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip if ament does not find the executables; else give launch its own folders."""
    from ament_index_python.packages import PackageNotFoundError, get_package_prefix

    try:
        get_package_prefix("deltacharger")
    except PackageNotFoundError:
        pytest.skip("ament does not find deltacharger: launch needs it for the executables")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))


def command(file: Path | str = "", namespace: str = "", **more: Any) -> tuple[str, ...]:
    """Return the command line that launches a scene in a namespace."""
    given = {"sigterm_timeout": PATIENCE, "scene": file, "charger_namespace": namespace} | more
    return (*LAUNCH, str(FILE), *(f"{name}:={value}" for name, value in given.items() if value))


@pytest.fixture
def launched(start: Launch) -> Launch:
    return lambda *where, **more: start(*command(*where, **more))


def output(process: Process) -> str:
    return "\n".join([*process.out, *process.err])


def pid(process: Process, name: str) -> int:
    """Return the last process id of an executable in launch's output."""
    found = re.findall(rf"\[{name}-\d+\]: process started with pid \[(\d+)\]", output(process))
    return int(found[-1]) if found else 0


def finished_cleanly(process: Process) -> int:
    return output(process).count("process has finished cleanly")


def test_killed_nodes_that_move_nothing_restart_and_serve(quick_scene: Scene, context: Any) -> None:
    with RunningCharger(quick_scene, context, command=command) as charger:
        process = charger.processes["charger"]
        docking = pid(process, "docking_node")
        for name in ("mock_detector_node", "misalignment_node", "kinematics_node"):
            killed = pid(process, name)
            os.kill(killed, KILL)
            wait_until(lambda: pid(process, name) != killed, f"{name} again")  # noqa: B023
        charger.wait_until_ready()
        charger.wait_until_single()
        charger.charge(DockRequest(None))  # it asks detector and estimator
        charger.go_home()
        assert pid(process, "docking_node") == docking, "the others keep running"
        assert process.end(INT) == 0, output(process)


def test_a_killed_docking_node_ends_the_charger_with_1(launched: Launch, namespace: str) -> None:
    process = launched(MOCKS, namespace)
    with ChargerClient(namespace) as client:
        assert client.wait_until_ready(DEADLINE), output(process)
        os.kill(pid(process, "docking_node"), KILL)
        assert process.end() == 1, output(process)
    assert "docking_node ended with code -9" in output(process)


def test_a_wrong_part_ends_it_with_1(launched: Launch, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("{nodes: [misalignment_node], parameters: {misalignment_node: {rate: -1.0}}}", encoding="utf-8")
    process = launched(file)
    assert process.end() == 1
    assert "misalignment_node cannot start as configured" in output(process)


@pytest.mark.parametrize(
    ("prefix", "signals", "to_group", "code"),
    [
        pytest.param(TERMINAL, (INT, INT), True, 0, id="Ctrl-C_twice_in_a_terminal"),
        pytest.param((), (INT,), True, 0, id="systemctl_stop"),  # KillSignal SIGINT, KillMode control-group
        pytest.param((), (TERM,), False, -TERM, id="SIGTERM"),
        pytest.param((), (HUP,), True, -HUP, id="closed_terminal"),
        pytest.param((), (KILL,), False, -KILL, id="SIGKILL"),
        pytest.param(CONTAINER, (INT,), False, 0, id="docker_stop", marks=needs_containers),  # STOPSIGNAL SIGINT
    ],
)
def test_a_signal_to_launch_makes_a_charging_charger_safe(
    context: Any, prefix: tuple[str, ...], signals: tuple[int, ...], to_group: bool, code: int
) -> None:
    """The contactor is open within 350 ms, the arm ends without torque, and no process is left."""
    words = (*LEADER, *prefix) if prefix != CONTAINER else CONTAINER
    scene = parse_scene(QUICK, "launched")
    with RunningCharger(scene, context, command=lambda *where: (*words, *command(*where))) as charger:
        process = charger.processes["charger"]
        group = process.process.pid
        try:
            charger.charge()
            before, at = len(process.out), charger.world.time
            for number in signals:
                if to_group:
                    os.killpg(group, number)
                else:
                    os.kill(first(process) if prefix == CONTAINER else group, number)
            assert charger.opened(at) < OPEN
            assert process.end() == code, output(process)
            charger.assert_safe()
            wait_until(lambda: not left(group), "the end of all processes", 10.0)
        finally:
            for each in left(group):
                os.kill(each, KILL)
    if code == 0:
        assert finished_cleanly(process) == REAL_NODES, output(process)
        assert not [line for line in process.out[before:] if "_node-" in line and ALARM.search(line)], output(process)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_accepts_the_unit() -> None:
    file = ROOT / "config" / "systemd" / "deltacharger.service"
    checked = subprocess.run(["systemd-analyze", "verify", str(file)], capture_output=True, text=True, check=False)
    assert (checked.returncode, checked.stdout, checked.stderr) == (0, "", "")
