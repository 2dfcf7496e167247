# SPDX-License-Identifier: Apache-2.0
"""The folder of records: names in and of them, and a bound on how many there are and how much they take."""

from __future__ import annotations

import fcntl
import os
import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from deltacharger_core.files import sync_folder

SUFFIX = ".mcap"
PARTIAL = ".mcap.partial"
ABOUT, RESULT, PARAMETERS, END = "deltacharger", "result", "docking_parameters", "end"
"""Names of a record's metadata: what recorded it, how each goal ended, what docking decides by, how all ended."""
_STAMP = "%Y%m%dT%H%M%SZ"
_NAME = re.compile(r"^(?P<time>\d{8}T\d{6}Z)(?:-(?P<rest>[^/]+?))?\.mcap(?P<partial>\.partial)?$")
_UNSAFE = re.compile(r"[^A-Za-z0-9_.]+")
_ID_MAX = 60  # characters of a request id in a name


def safe_id(request_id: str) -> str:
    """Return a request id as part of a file's name: letters, digits, points and underscores, not too many."""
    return _UNSAFE.sub("_", request_id).strip("._")[:_ID_MAX]


def is_record(path: Path) -> bool:
    """Whether a file has a record's name, ended or not; anything else in the folder is somebody else's."""
    return _NAME.match(path.name) is not None


@dataclass(frozen=True)
class Entry:
    """A record in the folder: its file, size (bytes) and whether its docking is under way."""

    path: Path
    size: int
    under_way: bool


class RecordFolder:
    """Makes, names and forgets records.

    Args:
        path: of the folder; made where there is none.
        max_files: records in it, those under way among them.
        max_bytes: that they take.
    """

    def __init__(self, path: Path, max_files: int, max_bytes: int) -> None:
        self.path = path
        self._max_files = max_files
        self._max_bytes = max_bytes

    def create(self, wall: float, request_id: str) -> tuple[Path, BinaryIO]:
        """Make room and open the file of a docking that begins, locked for as long as it is open.

        Args:
            wall: when, s since 1970.
            request_id: of the goal.

        Raises:
            OSError: the folder cannot be written.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        self.prune(coming=1)
        base = "-".join(filter(None, (time.strftime(_STAMP, time.gmtime(wall)), safe_id(request_id))))
        number = 1
        while True:
            path = self.path / f"{base}{'' if number == 1 else f'-{number}'}{PARTIAL}"
            try:
                stream = path.open("xb")
            except FileExistsError:
                number += 1
                continue
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return path, stream

    def finish(self, partial: Path, code: str) -> Path:
        """Give a record that is complete its name.

        Args:
            partial: its file.
            code: by which the docking ended.

        Raises:
            OSError: the folder cannot be written.
        """
        base = f"{partial.name.removesuffix(PARTIAL)}-{code}"
        path, number = self.path / f"{base}{SUFFIX}", 1
        while path.exists():
            number += 1
            path = self.path / f"{base}-{number}{SUFFIX}"
        partial.rename(path)
        sync_folder(self.path)
        return path

    def entries(self) -> list[Entry]:
        """Return the records, oldest first.

        Raises:
            OSError: the folder cannot be read.
        """
        found = []
        for path in sorted(self.path.iterdir()):
            if not is_record(path):
                continue
            try:
                found.append(Entry(path, path.stat().st_size, _is_under_way(path)))
            except FileNotFoundError:  # another recorder forgot or renamed it meanwhile
                continue
        return found

    def prune(self, coming: int = 0) -> list[Path]:
        """Remove the oldest records until the bounds hold, and return them; one under way is never among them.

        Args:
            coming: records that are about to be made.

        Raises:
            OSError: the folder cannot be written.
        """
        entries = self.entries()
        count, size = len(entries) + coming, sum(entry.size for entry in entries)
        removed = []
        for entry in entries:
            if count <= self._max_files and size <= self._max_bytes:
                break
            if entry.under_way:
                continue
            entry.path.unlink(missing_ok=True)
            removed.append(entry.path)
            count, size = count - 1, size - entry.size
        return removed


def _is_under_way(path: Path) -> bool:
    """Whether a recorder has the file open; the lock of one that was killed is gone with it."""
    if not path.name.endswith(PARTIAL):
        return False
    descriptor = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return False
    except OSError:  # taken, or locks cannot be had here: then better one file too many
        return True
    finally:
        os.close(descriptor)
