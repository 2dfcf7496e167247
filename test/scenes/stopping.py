# SPDX-License-Identifier: Apache-2.0
"""A charger of real processes on emulated ports of this process, which charges until signals stop it.

The emulators, the devices' side of the wires, show when the contactor opened and when the torque was lost.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from deltacharger_ros.client import ChargerClient
from deltacharger_ros.outcomes import DockRequest, Pose
from deltacharger_scenes.scene import parse_scene

from ..chargers import DEADLINE, Process, dock_at_last, wait_until
from ..quick import DAMPING, STEPS
from ..sim.fault_world import CONTACTOR, RecordedCharger

ROOT = Path(__file__).resolve().parents[2]
OPEN = 0.35  # s from the signal until the contactor is open
LEADER = ("setsid",)
"""Prefix of a command line: its processes form a separate process group, as a shell's job does."""
TERMINAL = (
    sys.executable,
    "-c",
    "import os, sys; outer, inner = os.openpty(); os.set_inheritable(outer, True); os.dup2(inner, 0); "
    "os.execvp(sys.argv[1], sys.argv[1:])",
)
"""Prefix of a command line: its program reads from a terminal."""
CONTAINER = ("unshare", "--pid", "--fork", "--kill-child", str(ROOT / "config" / "container" / "entrypoint.sh"))
"""Prefix of a command line: its program is process 1 of a container, whose end kills all others in it."""
ALARM = re.compile(r"\[(WARN|ERROR|FATAL)\]|Traceback")
"""Marks lines that must not appear if all is well."""
needs_containers = pytest.mark.skipif(
    subprocess.run(["unshare", "--pid", "--fork", "true"], capture_output=True, check=False).returncode != 0,
    reason="needs the right to create a process namespace, as root has",
)
_PATIENT = {"servo_age_max": 1.0, "tactile_age_max": 1.0, "power_age_max": 1.0}  # a busy computer is not a broken cable


class Stopped:
    """The emulators, with start and stop of a charger on their ports.

    Attributes:
        scene: file of the scene with these ports.
        charger: the emulators.
    """

    def __init__(self, folder: Path, namespace: str, context: Any) -> None:
        self._namespace = namespace
        self._context = context
        world = {"servo": {"damping": DAMPING}}
        self.charger = RecordedCharger.build(parse_scene({"simulation": {"world": world}}, "stopped"), "")
        self.charger.start()
        ports = {"servo": self.charger.servo_port, "board": self.charger.board_port}
        self.scene = folder / "stopped.yaml"
        content = {"ports": ports, "parameters": {"docking_node": {**STEPS, **_PATIENT}}}
        self.scene.write_text(json.dumps(content), encoding="utf-8")

    def charge(self, process: Process) -> None:
        """Wait for a started charger, and let it charge."""
        with ChargerClient(self._namespace, self._context) as client:
            assert client.wait_until_ready(DEADLINE), (process.out, process.err)
            dock_at_last(client, DockRequest(Pose(0.0, 0.0, 0.080)))
        assert self.charger.world.circuit.closed

    def stop(self, send: Callable[[], object]) -> float:
        """Send signals, and return s until the contactor was open."""
        begun = len(self.charger.world.events)
        at = self.charger.world.time
        send()
        opened = wait_until(lambda: self.charger.world.since(begun, CONTACTOR, False), "an open contactor")
        return opened[0].time - at

    def assert_safe(self) -> None:
        """Check that the torque is lost, and that nothing parted or moved while it was live."""
        wait_until(lambda: not any(self.charger.world.torque), "no torque", 10.0)
        assert not self.charger.world.circuit.closed
        record = self.charger.world.record
        assert (record.energised_shorts, record.energised_unsafe, record.parted_live) == (0, 0.0, 0)


def first(process: Process) -> int:
    """Return the id, in this namespace, of process 1 of a container."""
    pid = process.process.pid
    return int(wait_until(lambda: Path(f"/proc/{pid}/task/{pid}/children").read_text().split(), "process 1")[0])


def lives(process: int) -> bool:
    """Return whether a process still runs; a zombie does not."""
    return _status(process)[:1] not in ([], ["Z"])


def left(group: int) -> list[int]:
    """Return the running processes of a group."""
    every = [int(folder.name) for folder in Path("/proc").iterdir() if folder.name.isdecimal()]
    return [each for each in every if lives(each) and _status(each)[2:3] == [str(group)]]


def _status(process: int) -> list[str]:
    """Return state, parent, group and more of a process; empty if it does not exist."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def kill_what_is_left(group: int) -> None:
    for pid in left(group):
        os.kill(pid, signal.SIGKILL)
