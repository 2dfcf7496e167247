# SPDX-License-Identifier: Apache-2.0
"""The folder of records, with bounds on their number and size.

Above the bounds the oldest file is removed that carries our name and our writer's mark: its head names the writer and
the docking, and its name agrees. Nothing else is ever removed: a name alone proves nothing, because a person's
recording may have a similar one, and a renamed record belongs to the person.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import itertools
import os
import re
import stat
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO, NamedTuple

from deltacharger_core.files import flush, kind_text, sync_folder
from deltacharger_core.mcap_file import RecordingError, head_of

SUFFIX, PARTIAL = ".mcap", ".mcap.partial"
"""Ending of a record's name, and of one in progress."""
LIBRARY = "deltacharger"
"""Writer named in a file's header."""
ABOUT, PARAMETERS, RESULT, END = "deltacharger", "docking_parameters", "result", "end"
"""Names of a record's metadata: `head`, docking's parameters, each goal's result, the ending."""
_STAMP = "%Y%m%dT%H%M%SZ"
_LIKE_OURS = re.compile(r"\d{8}T\d{6}Z(-[^/]+)?\.mcap(\.partial)?", re.DOTALL)
_ENDING = re.compile(r"(-\d+)?(-[A-Z_]+|-\d+)?(-\d+)?\.mcap(\.partial)?")
_UNSAFE = re.compile(r"[^A-Za-z0-9_.]+")
_ID_MAX = 60  # characters of a request id in a name
_VALUE_MAX = 1000  # characters of one metadata value, so that `head_of` reads them


class Entry(NamedTuple):
    """A record in the folder: its file, size (bytes), and whether its docking is in progress."""

    path: Path
    size: int
    under_way: bool


class RecordFolder:
    """Creates, names and removes records.

    Args:
        path: of the folder; created if missing.
        max_files: records in it, including those in progress.
        max_bytes: of all records.

    Attributes:
        passed_by: files named like records but left alone because they are foreign or cannot be removed: the reason by
            name, as of the last check.
    """

    def __init__(self, path: Path, max_files: int, max_bytes: int) -> None:
        self.path = path
        self.max_bytes = max_bytes
        self.passed_by: dict[str, str] = {}
        self._max_files = max_files
        self._known: dict[str, tuple[tuple[int, ...], str]] = {}  # identity and problem by name

    def create(self, began: int, request_id: str) -> tuple[Path, BinaryIO]:
        """Make room and create the file of a docking that begins, locked while it is open.

        Args:
            began: ns since 1970.
            request_id: of the goal.

        Raises:
            OSError: the folder cannot be written.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        self.prune(coming=1)
        return self._open_new(_base_name(began, request_id))

    def finish(self, partial: Path, stream: BinaryIO, ending: str, pack: Callable[[BinaryIO], None]) -> Path:
        """Give a complete record its name; an existing file keeps that name.

        Args:
            partial, stream: its file.
            ending: of the name: how the docking ended.
            pack: writes the record once more, smaller; if that fails, it stays as it is.

        Raises:
            OSError: the folder cannot be written.
        """
        _require_same(partial, stream)
        base, source = partial.name.removesuffix(PARTIAL), partial
        packed, new = self._open_new(base)
        with new:
            try:
                pack(new)
                flush(new)
            except (OSError, RecordingError):
                packed.unlink()
            else:
                self.forget(partial, stream)
                source = packed
            path = next(path for path in self._numbered(f"{base}-{ending}", SUFFIX) if not os.path.lexists(path))
            source.rename(path)
        sync_folder(self.path)
        return path

    def forget(self, partial: Path, stream: BinaryIO) -> None:
        """Remove a record in progress.

        Raises:
            OSError: it cannot be removed, or another file has its name.
        """
        _require_same(partial, stream)
        partial.unlink()

    def entries(self) -> list[Entry]:
        """Return our records, oldest first.

        Raises:
            OSError: the folder cannot be read.
        """
        found, known = list[Entry](), dict[str, tuple[tuple[int, ...], str]]()
        self.passed_by = {}
        for path in sorted(path for path in self.path.iterdir() if _LIKE_OURS.fullmatch(path.name)):
            with contextlib.suppress(FileNotFoundError):  # another recorder removed or renamed it
                status = path.lstat()
                identity = (status.st_dev, status.st_ino, status.st_ctime_ns)  # changes with its place and content
                before = self._known.get(path.name)
                problem = before[1] if before is not None and before[0] == identity else problem_of(path)
                known[path.name] = identity, problem
                if problem:
                    self.passed_by[path.name] = problem
                else:
                    found.append(Entry(path, status.st_size, _is_under_way(path)))
        self._known = known
        return found

    def prune(self, coming: int = 0) -> list[Path]:
        """Remove the oldest records until the bounds hold, and return them; never one in progress.

        Args:
            coming: records about to be created.

        Raises:
            OSError: the folder cannot be read.
        """
        entries = self.entries()
        count, size = len(entries) + coming, sum(entry.size for entry in entries)
        removed = []
        for path, own, under_way in entries:
            if count <= self._max_files and size <= self.max_bytes:
                break
            if under_way:
                continue
            try:
                path.unlink(missing_ok=True)  # another recorder may have removed it first
            except OSError as error:
                self.passed_by[path.name] = f"cannot be removed: {error.strerror}"
                continue
            removed.append(path)
            count, size = count - 1, size - own
        return removed

    def _open_new(self, base: str) -> tuple[Path, BinaryIO]:
        paths = self._numbered(base, PARTIAL)
        while True:
            path = next(paths)
            with contextlib.suppress(FileExistsError):
                stream = path.open("xb")
                fcntl.flock(stream, fcntl.LOCK_EX)  # a recorder that checks whether it is in use holds it briefly
                return path, stream

    def _numbered(self, base: str, suffix: str) -> Iterator[Path]:
        """Yield `base`, `base`-2, `base`-3 …; the caller takes the first free one."""
        return (self.path / f"{base}{f'-{number}' if number > 1 else ''}{suffix}" for number in itertools.count(1))


def problem_of(path: Path) -> str:
    """Return why a file is none of our records; '' = it is one. Opens regular files only, and reads only the head.

    Raises:
        FileNotFoundError: the file is gone.
        RecordingError: mcap is not installed.
    """
    mode = path.lstat().st_mode
    if not stat.S_ISREG(mode):
        return f"it is {kind_text(mode)}"
    try:
        library, name, about = head_of(path)
        base = _base_name(int(about["began"]), about["request_id"])
    except FileNotFoundError:
        raise
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    except (KeyError, ValueError, OverflowError):
        library = name = base = ""
    if (library, name) != (LIBRARY, ABOUT):
        return "docking_recorder_node did not write it"
    if not (path.name.startswith(base) and _ENDING.fullmatch(path.name.removeprefix(base))):
        return "it was renamed"
    return ""


def head(about: Mapping[str, str], began: int, request_id: str) -> dict[str, str]:
    """Return the metadata at the head of a record, by which `problem_of` recognises it.

    Args:
        about: version, scene and namespace.
        began: of its docking, ns since 1970.
        request_id: of its goal.
    """
    return {name: word[:_VALUE_MAX] for name, word in {**about, "request_id": request_id, "began": str(began)}.items()}


def safe_id(request_id: str) -> str:
    """Return a request id as part of a file name: letters, digits, points and underscores, bounded length."""
    return _UNSAFE.sub("_", request_id[:_VALUE_MAX]).strip("._")[:_ID_MAX]


def _base_name(began: int, request_id: str) -> str:
    """Return the beginning of a record's name; ValueError, OverflowError or OSError if the time is out of range."""
    return "-".join(filter(None, (time.strftime(_STAMP, time.gmtime(began // 10**9)), safe_id(request_id))))


def _is_under_way(path: Path) -> bool:
    """Whether a recorder has it open; a killed recorder's lock is gone."""
    if not path.name.endswith(PARTIAL):
        return False
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:  # locked, or no locks on this file system: rather keep one file too many
            return True
    return False


def _require_same(path: Path, stream: BinaryIO) -> None:
    """Raise FileNotFoundError if another file has taken its name."""
    if not os.path.samestat(path.lstat(), os.fstat(stream.fileno())):
        raise FileNotFoundError(errno.ENOENT, "another program moved the record in progress", str(path))
