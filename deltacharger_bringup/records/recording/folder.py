# SPDX-License-Identifier: Apache-2.0
"""The folder of records, with a bound on its size.

Above it the files not written for the longest time are removed, if name and header tell that a recorder of ours wrote
them: a name alone proves nothing, because a person's recording may have a similar one. Nothing else is ever removed.
"""

import contextlib
import itertools
import os
import re
import stat
import time
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from deltacharger_core import files, mcap_file, parameters
from deltacharger_core.parameters import number, words

SUFFIX, PARTIAL = ".mcap", ".mcap.partial"
"""Ending of a record's name, and of one in progress."""
LIBRARY = "deltacharger"
"""Writer named in a file's header."""
ABOUT, PARAMETERS, RESULT, END = "deltacharger", "docking_parameters", "result", "end"
"""Names of a record's metadata: version, scene, namespace, request and beginning, at its head; docking's parameters;
each goal's result; the ending."""
_STAMP = "%Y%m%dT%H%M%SZ"
_LIKE_OURS = re.compile(r"\d{8}T\d{6}Z(-[^/]+)?\.mcap(\.partial)?", re.DOTALL)
_UNSAFE = re.compile(r"[^A-Za-z0-9_.]+")
_ID_MAX = 60  # characters of a request id in a name


@dataclass(frozen=True)
class DockingRecorderNodeParameters(parameters.Bounded):
    """Folder of records, its limit, and the scene's name."""

    folder: str = words("~/deltacharger_records", "folder of the records")
    max_megabytes: int = number(500, 10, 1_000_000, "1e6 bytes", "total size of the records in {unit}")
    scene: str = words("", "written to each record")


class RecordFolder:
    """Creates, names and removes records.

    Args:
        path: of the folder; created if missing.
        max_bytes: of all records.
    """

    def __init__(self, path: Path, max_bytes: int) -> None:
        self.path = path
        self.max_bytes = max_bytes

    def create(self, began: int, request_id: str) -> tuple[Path, BinaryIO]:
        """Make room and create the file of a docking that begins.

        Args:
            began: ns since 1970.
            request_id: of the goal.

        Raises:
            OSError: the folder cannot be written.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        self.prune()
        base = "-".join(filter(None, (time.strftime(_STAMP, time.gmtime(began // 10**9)), safe_id(request_id))))
        while True:
            path = self._free(base, PARTIAL)
            with contextlib.suppress(FileExistsError):
                return path, path.open("xb")

    def finish(self, partial: Path, ending: str) -> Path:
        """Give a complete record its name, which ends in how the docking ended; an existing file keeps that name.

        Raises:
            OSError: the folder cannot be written.
        """
        path = self._free(f"{partial.name.removesuffix(PARTIAL)}-{ending}", SUFFIX)
        partial.rename(path)
        files.sync_folder(self.path)
        return path

    def prune(self) -> None:
        """Remove the oldest records until the bound holds.

        Raises:
            OSError: the folder cannot be read.
        """
        found = []
        for path in self.path.iterdir():
            with contextlib.suppress(OSError):  # another recorder removed it, or it cannot be read
                if _LIKE_OURS.fullmatch(path.name) and is_ours(path):
                    status = path.stat()
                    found.append((status.st_mtime_ns, status.st_size, path))
        excess = sum(size for _, size, _ in found) - self.max_bytes
        for _, size, path in sorted(found)[:-1]:  # the newest may be in progress
            if excess <= 0:
                return
            with contextlib.suppress(OSError):
                path.unlink()
                excess -= size

    def _free(self, base: str, suffix: str) -> Path:
        """Return the first free one of `base`, `base`-2, `base`-3 …"""
        names = (f"{base}{f'-{number}' if number > 1 else ''}{suffix}" for number in itertools.count(1))
        return next(self.path / name for name in names if not os.path.lexists(self.path / name))


def is_ours(path: Path) -> bool:
    """Whether a recorder of ours wrote a file. Opens regular files only, and reads only the head.

    Raises:
        OSError: it cannot be read.
        RecordingError: mcap is not installed.
    """
    if not stat.S_ISREG(path.lstat().st_mode):
        return False
    library, name, _ = mcap_file.head_of(path)
    return (library, name) == (LIBRARY, ABOUT)


def safe_id(request_id: str) -> str:
    """Return a request id as part of a file name: letters, digits, points and underscores, bounded length."""
    return _UNSAFE.sub("_", request_id).strip("._")[:_ID_MAX]
