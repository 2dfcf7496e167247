# SPDX-License-Identifier: Apache-2.0
"""Resources of processes, read from outside: processor time, memory, threads, libraries."""

from __future__ import annotations

import contextlib
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import psutil

LIBRARIES = (
    *("torch", "sklearn", "xgboost", "cv2", "depthai", "mujoco", "matplotlib", "scipy", "pandas", "pyarrow", "casadi"),
    *("mcap", "zstandard", "rerun", "PIL"),
)
"""Heavy libraries by module name, which is a prefix of their folder or file names."""


@dataclass(frozen=True)
class Usage:
    """Total resources of some processes.

    Attributes:
        processes: their number.
        threads: of all.
        cpu: s of processor time so far, ended children included.
        pss: bytes; shared memory divided among its processes.
        rss: bytes; shared memory counted in each process.
    """

    processes: int
    threads: int
    cpu: float
    pss: int
    rss: int


def unsupported() -> str:
    """Return why nothing can be measured on this computer; '' if it can."""
    return "" if sys.platform == "linux" else "only Linux reports what a process uses; measure there"


def family(roots: Iterable[int]) -> list[psutil.Process]:
    """Return the processes `roots` and all running processes that they started.

    Raises:
        psutil.NoSuchProcess: one of `roots` has ended.
    """
    import psutil

    found: dict[int, psutil.Process] = {}
    for root in map(psutil.Process, roots):
        found |= {process.pid: process for process in (root, *root.children(recursive=True))}
    return list(found.values())


def usage(roots: Iterable[int]) -> Usage:
    """Return the resources of the processes `roots` and of those that they started.

    Raises:
        psutil.NoSuchProcess: one of `roots` has ended.
    """
    import psutil

    roots = list(roots)
    each = []
    for process in family(roots):
        try:
            with process.oneshot():
                if process.status() == psutil.STATUS_ZOMBIE:
                    raise psutil.ZombieProcess(process.pid)
                cpu, memory = sum(process.cpu_times()[:4]), process.memory_full_info()
                each.append((process.num_threads(), cpu, memory.pss, memory.rss))
        except psutil.NoSuchProcess:
            if process.pid in roots:
                raise  # for another process, its parent has the processor time
    threads, cpu, pss, rss = (sum(values) for values in zip(*each, strict=True))
    return Usage(len(each), threads, cpu, pss, rss)


def mapped(roots: Iterable[int]) -> set[str]:
    """Return those of `LIBRARIES` with a file in the memory of one of these processes."""
    import psutil

    text = ""
    for process in family(roots):
        with contextlib.suppress(psutil.NoSuchProcess):
            text += "\n".join(each.path for each in process.memory_maps())
    return {name for name in LIBRARIES if re.search(rf"/{name}[/._]", text)}
