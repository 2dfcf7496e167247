# SPDX-License-Identifier: Apache-2.0
"""A charging charger, ended by each signal that people, containers and systemd send, without launch.

Started by `deltacharger up`, and as nodes in separate processes. Each time, the contactor is open within 350 ms and the
arm ends without torque. Under launch: test_charger_launch_stops.py.
"""

from __future__ import annotations

import os
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from deltacharger_scenes.scene import load_scene

from ..chargers import Process, wait_until
from .stopping import ALARM, CONTAINER, OPEN, Stopped, first, lives, needs_containers
from .test_processes import arguments

pytestmark = pytest.mark.ros

INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
Start = Callable[..., Process]


def send_all(process: Process, signals: Sequence[int]) -> None:
    for number in signals:
        process.process.send_signal(number)


@pytest.fixture
def stopped(tmp_path: Path, namespace: str, context: Any) -> Iterator[Stopped]:
    rig = Stopped(tmp_path, namespace, context)
    yield rig
    rig.charger.stop()


@pytest.mark.parametrize(
    ("signals", "code"),
    [
        pytest.param((INT, INT), 130, id="Ctrl-C_twice"),
        pytest.param((TERM,), 0, id="docker_stop", marks=pytest.mark.rest),
        pytest.param((HUP, TERM), 0, id="closed_terminal", marks=pytest.mark.rest),
    ],
)
def test_up_makes_a_charging_charger_safe(
    stopped: Stopped, start: Start, deltacharger: tuple[str, ...], namespace: str, signals: tuple[int, ...], code: int
) -> None:
    process = start(*deltacharger, "up", "--scene", str(stopped.scene), "--namespace", namespace)
    stopped.charge(process)
    before = len(process.err)
    assert stopped.stop(lambda: send_all(process, signals)) < OPEN
    assert process.end() == code, process.err
    stopped.assert_safe()
    assert not [line for line in process.err[before:] if ALARM.search(line)], process.err


def test_nodes_that_get_signals_until_they_end_make_a_charging_charger_safe(
    stopped: Stopped, start: Start, namespace: str
) -> None:
    scene = load_scene(stopped.scene)
    processes = [start(*arguments(scene, name, namespace)) for name in scene.start_order()]
    stopped.charge(processes[-1])
    before = [len(each.err) for each in processes]
    assert stopped.stop(lambda: [send_all(each, (INT,)) for each in processes]) < OPEN
    for each in processes:
        while each.process.poll() is None:  # as an impatient person or a supervisor does
            each.process.send_signal(INT)
            time.sleep(0.001)
    assert [each.end() for each in processes] == [0] * len(processes), [each.err for each in processes]
    stopped.assert_safe()
    lines = [line for each, count in zip(processes, before, strict=True) for line in each.err[count:]]
    assert not [line for line in lines if ALARM.search(line)], lines


@needs_containers
@pytest.mark.parametrize(("number", "code"), [(TERM, 0), pytest.param(INT, 130, marks=pytest.mark.rest)])
def test_docker_stop_of_up_makes_a_charging_charger_safe(
    stopped: Stopped, start: Start, deltacharger: tuple[str, ...], namespace: str, number: int, code: int
) -> None:
    process = start(*CONTAINER, *deltacharger, "up", "--scene", str(stopped.scene), "--namespace", namespace)
    stopped.charge(process)
    assert stopped.stop(lambda: os.kill(first(process), number)) < OPEN
    assert process.end() == code, process.err
    stopped.assert_safe()


def test_a_signal_while_a_node_is_being_imported_ends_it_with_0(start: Start) -> None:
    code = "import sys; from deltacharger_scenes.executables import docking_node; sys.exit(docking_node())"
    process = start(sys.executable, "-c", code)
    folder = Path(f"/proc/{process.process.pid}")

    def handles_signals() -> bool:
        caught = int(re.findall(r"SigCgt:\s(\w+)", (folder / "status").read_text())[0], 16)
        return bool(caught >> (TERM - 1) & 1)

    wait_until(handles_signals, "a handler")
    assert "rclpy" not in (folder / "maps").read_text(), "it handles signals only after its import"
    assert process.end(INT) == 0
    assert (process.out, process.err) == ([], [])


@pytest.mark.parametrize("what", ["kinematics_node", "simulate"])
def test_a_process_ends_with_its_starter(
    what: str, start: Start, deltacharger: tuple[str, ...], namespace: str, tmp_path: Path
) -> None:
    if what == "simulate":
        words = [*deltacharger, "simulate", "--directory", str(tmp_path), "--namespace", namespace]
    else:
        words = arguments(load_scene("mocks"), what, namespace)
    code = (
        "import os, subprocess, sys, time\n"
        "from deltacharger_core import signals\n"
        "child = subprocess.Popen(sys.argv[1:], env={**os.environ, **signals.end_with(os.getpid())})\n"
        "print(child.pid, flush=True)\n"
        "child.wait()\n"
    )
    starter = start(words[0], "-c", code, *words)
    wait_until(lambda: starter.out, "its process")
    node = int(starter.out[0])
    starter.process.kill()
    wait_until(lambda: not lives(node), f"the end of {what}")
