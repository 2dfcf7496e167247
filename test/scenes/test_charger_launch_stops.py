# SPDX-License-Identifier: Apache-2.0
"""`ros2 launch` of a charging charger, ended by each signal that people, containers and systemd send.

Each time, the contactor is open within 350 ms, the arm ends without torque, and no process is left. Without launch:
test_stops.py.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ..chargers import Process, wait_until
from .launched import need_the_package
from .stopping import (
    ALARM,
    CONTAINER,
    LEADER,
    OPEN,
    ROOT,
    TERMINAL,
    Stopped,
    first,
    kill_what_is_left,
    left,
    needs_containers,
)
from .test_charger_launch_ends import COMMAND, finished_cleanly, output

pytestmark = pytest.mark.ros

NODES = 5
UNIT = dict(
    line.split("=", 1)
    for line in (ROOT / "config" / "systemd" / "deltacharger.service").read_text(encoding="utf-8").splitlines()
    if "=" in line and line[0] != "#"
)
INT, TERM, HUP, KILL = signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL


@pytest.fixture
def stopped(tmp_path: Path, namespace: str, context: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Stopped]:
    need_the_package()
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    rig = Stopped(tmp_path, namespace, context)
    yield rig
    rig.charger.stop()


@pytest.mark.parametrize(
    ("before", "signals", "group", "code"),
    [
        pytest.param((), (INT,), False, 0, id="SIGINT"),
        pytest.param(TERMINAL, (INT,), False, 0, id="SIGINT_to_launch_alone_in_a_terminal"),
        pytest.param(TERMINAL, (INT, INT), True, 0, id="Ctrl-C_twice_in_a_terminal"),
        pytest.param((), (INT, INT), True, 0, id="SIGINT_twice_without_terminal"),
        pytest.param(
            (), (signal.Signals[UNIT["KillSignal"]],), UNIT["KillMode"] == "control-group", 0, id="systemctl_stop"
        ),
        pytest.param((), (TERM,), False, -TERM, id="SIGTERM"),
        pytest.param((), (HUP,), True, -HUP, id="closed_terminal"),
        pytest.param((), (KILL,), False, -KILL, id="SIGKILL"),
    ],
)
def test_a_signal_to_launch_makes_a_charging_charger_safe(
    stopped: Stopped,
    start: Callable[..., Process],
    namespace: str,
    before: tuple[str, ...],
    signals: tuple[int, ...],
    group: bool,
    code: int,
) -> None:
    process = start(*LEADER, *before, *COMMAND, f"scene:={stopped.scene}", f"namespace:={namespace}")
    pid = process.process.pid
    try:
        stopped.charge(process)
        before = len(process.out)
        kill = os.killpg if group else os.kill
        assert stopped.stop(lambda: [kill(pid, number) for number in signals]) < OPEN
        assert process.end() == code, output(process)
        stopped.assert_safe()
        wait_until(lambda: not left(pid), "the end of all processes", 10.0)
    finally:
        kill_what_is_left(pid)
    if code == 0:
        assert finished_cleanly(process) == NODES, output(process)
        assert not [line for line in process.out[before:] if "_node-" in line and ALARM.search(line)], output(process)


@needs_containers
def test_docker_stop_of_launch_makes_a_charging_charger_safe(
    stopped: Stopped, start: Callable[..., Process], namespace: str
) -> None:
    process = start(*CONTAINER, *COMMAND, f"scene:={stopped.scene}", f"namespace:={namespace}")
    stopped.charge(process)
    assert stopped.stop(lambda: os.kill(first(process), INT)) < OPEN  # STOPSIGNAL SIGINT
    assert process.end() == 0, output(process)
    stopped.assert_safe()
    assert finished_cleanly(process) == NODES, output(process)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_accepts_the_unit() -> None:
    file = ROOT / "config" / "systemd" / "deltacharger.service"
    checked = subprocess.run(["systemd-analyze", "verify", str(file)], capture_output=True, text=True, check=False)
    assert (checked.returncode, checked.stdout, checked.stderr) == (0, "", "")
