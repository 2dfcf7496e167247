# SPDX-License-Identifier: Apache-2.0
"""How people, shells and containers start a charger's processes, and what is left of them."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from ..chargers import Process, wait_until

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
