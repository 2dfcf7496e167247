# SPDX-License-Identifier: Apache-2.0
"""A charger of real processes on the ports of emulators in this one, which charges until signals stop it.

When the contactor opened and the torque went is read off the emulators, from the devices' side of the wires.
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
OPEN = 0.35  # s from the signal to the open contactor
LEADER = ("setsid",)
"""Begins a command line whose processes are a process group of their own, as those of a shell's job are."""
TERMINAL = (
    sys.executable,
    "-c",
    "import os, sys; outer, inner = os.openpty(); os.set_inheritable(outer, True); os.dup2(inner, 0); "
    "os.execvp(sys.argv[1], sys.argv[1:])",
)
"""Begins a command line whose program reads from a terminal."""
CONTAINER = ("unshare", "--pid", "--fork", str(ROOT / "config" / "container" / "entrypoint.sh"))
"""Begins a command line whose program is process 1 of a container, with whose end all others in it are killed."""
ALARM = re.compile(r"\[(WARN|ERROR|FATAL)\]|Traceback")
"""In a line that nobody shall see when all is well."""
needs_containers = pytest.mark.skipif(
    subprocess.run(["unshare", "--pid", "--fork", "true"], capture_output=True, check=False).returncode != 0,
    reason="needs the right to make a namespace of processes, as root has",
)
_PATIENT = {"servo_age_max": 1.0, "tactile_age_max": 1.0, "power_age_max": 1.0}  # a busy computer is no broken cable


class Stopped:
    """The emulators, and what starts and stops a charger on their ports.

    Attributes:
        scene: file of the scene on these ports.
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
        """Wait for a charger that has been started, and let it charge."""
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
        """See that the torque goes, and that nothing parted or moved while it was live."""
        wait_until(lambda: not any(self.charger.world.torque), "no torque", 10.0)
        assert not self.charger.world.circuit.closed
        record = self.charger.world.record
        assert (record.energised_shorts, record.energised_unsafe, record.parted_live) == (0, 0.0, 0)


def first(process: Process) -> int:
    """Return the id, as seen from here, of process 1 of a container."""
    pid = process.process.pid
    return int(wait_until(lambda: Path(f"/proc/{pid}/task/{pid}/children").read_text().split(), "process 1")[0])


def lives(process: int) -> bool:
    """Return whether a process has not ended; one that nobody has waited for has."""
    return _status(process)[:1] not in ([], ["Z"])


def left(group: int) -> list[int]:
    """Return the processes of a group that have not ended."""
    every = [int(folder.name) for folder in Path("/proc").iterdir() if folder.name.isdecimal()]
    return [each for each in every if lives(each) and _status(each)[2:3] == [str(group)]]


def _status(process: int) -> list[str]:
    """Return state, parent, group and more of a process; empty where there is none."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def kill_what_is_left(group: int) -> None:
    for pid in left(group):
        os.kill(pid, signal.SIGKILL)
