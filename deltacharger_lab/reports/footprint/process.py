# SPDX-License-Identifier: Apache-2.0
"""What processes use, read from outside, as Linux tells it in /proc: processor time, memory, threads, libraries."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

_PROC = Path("/proc")
_TICKS = 100 if sys.platform == "win32" else os.sysconf("SC_CLK_TCK")

LIBRARIES = {
    "torch": r"/torch/",
    "sklearn": r"/sklearn/",
    "xgboost": r"/xgboost/",
    "cv2": r"/cv2/",
    "depthai": r"/depthai[./]",
    "mujoco": r"/mujoco/",
    "matplotlib": r"/matplotlib/",
    "scipy": r"/scipy[./]",
    "pandas": r"/pandas/",
    "pyarrow": r"/pyarrow/",
    "casadi": r"/casadi/",
    "mcap": r"/mcap/",
    "zstandard": r"/zstandard/",
    "rerun": r"/rerun[_/]",
    "PIL": r"/PIL/",
}
"""Heavy libraries by the module's name, and what the path of a file of theirs contains."""


@dataclass(frozen=True)
class Usage:
    """What some processes use together.

    Attributes:
        processes: how many.
        threads: of all.
        cpu: s of processor time so far, ended children included.
        pss: bytes; memory that several processes share counts once, in parts.
        rss: bytes; memory that several processes share counts in each.
    """

    processes: int
    threads: int
    cpu: float
    pss: int
    rss: int


def unsupported() -> str:
    """Return why nothing can be measured on this computer; '' where it can."""
    try:
        usage([os.getpid()])
    except OSError as error:
        return f"only Linux tells what a process uses ({error.filename or error} cannot be read)"
    return ""


def family(roots: Iterable[int]) -> list[int]:
    """Return the processes `roots` and all that they have started and that still run."""
    parents: dict[int, list[int]] = {}
    for entry in _PROC.iterdir():
        if entry.name.isdigit():
            try:
                parents.setdefault(int(_stat(int(entry.name))[1]), []).append(int(entry.name))
            except (OSError, IndexError):  # ended meanwhile
                continue
    found, left = [], list(roots)
    while left:
        process = left.pop()
        if process not in found:
            found.append(process)
            left += parents.get(process, [])
    return found


def usage(roots: Iterable[int]) -> Usage:
    """Return what the processes `roots` and those that they have started use.

    Raises:
        OSError: one of `roots` has ended, or this is not Linux.
    """
    roots = list(roots)
    each = [_one(process) for process in roots]
    for process in set(family(roots)) - set(roots):
        try:
            each.append(_one(process))
        except OSError:  # ended meanwhile; its parent has its processor time
            continue
    threads, cpu, pss, rss = (sum(values) for values in zip(*each, strict=True))
    return Usage(len(each), int(threads), cpu, int(pss), int(rss))


def _one(process: int) -> tuple[int, float, int, int]:
    """Return threads, processor time (s), PSS and RSS (bytes) of one process."""
    fields = _stat(process)
    if fields[0] == "Z":
        raise ProcessLookupError(2, "has ended", f"/proc/{process}")
    memory = dict(re.findall(r"^(\w+): +(\d+) kB$", (_PROC / str(process) / "smaps_rollup").read_text("ascii"), re.M))
    cpu = sum(int(ticks) for ticks in fields[11:15]) / _TICKS
    return int(fields[17]), cpu, 1024 * int(memory["Pss"]), 1024 * int(memory["Rss"])


def _stat(process: int) -> list[str]:
    """Return the fields of /proc/PID/stat behind the name, from the state on."""
    return (_PROC / str(process) / "stat").read_text("utf-8", "replace").rpartition(")")[2].split()


def mapped(roots: Iterable[int]) -> set[str]:
    """Return those of `LIBRARIES` of which a process of these has a file in its memory: nothing that is there hides."""
    text = ""
    for process in family(roots):
        try:
            text += (_PROC / str(process) / "maps").read_text("utf-8", "replace")
        except OSError:
            continue
    return {name for name, pattern in LIBRARIES.items() if re.search(pattern, text)}


def imported(modules: Iterable[str]) -> set[str]:
    """Return those of `LIBRARIES` that stand among the names of a process's modules."""
    return {module.partition(".")[0] for module in modules} & set(LIBRARIES)
