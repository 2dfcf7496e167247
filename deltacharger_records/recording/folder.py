# SPDX-License-Identifier: Apache-2.0
"""The folder of records: a bound on how many there are and how much they take. What is not ours is never touched."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import itertools
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from deltacharger_core.files import flush, sync_folder
from deltacharger_records.recording.own import PARTIAL, SUFFIX, Look, base_name, is_named_like_one, look

RESULT, PARAMETERS, END = "result", "docking_parameters", "end"
"""Names of a record's metadata: how each goal ended, what docking decides by, how all ended."""


@dataclass(frozen=True)
class Entry:
    """A record in the folder: its file, size (bytes), whether its docking is under way, and which file it is."""

    path: Path
    size: int
    under_way: bool
    identity: tuple[int, ...]


class RecordFolder:
    """Makes, names and forgets records.

    Args:
        path: of the folder; made where there is none.
        max_files: records in it, those under way among them.
        max_bytes: that they take.

    Attributes:
        passed_by: files named like records that are left alone, as they are none of ours or cannot be removed: their
            names, and why; of the last look.
    """

    def __init__(self, path: Path, max_files: int, max_bytes: int) -> None:
        self.path = path
        self.passed_by: dict[str, str] = {}
        self._max_files = max_files
        self._max_bytes = max_bytes
        self._known: dict[str, Look] = {}

    def create(self, began: int, request_id: str) -> tuple[Path, BinaryIO]:
        """Make room and open the file of a docking that begins, locked for as long as it is open.

        Args:
            began: when, ns since 1970.
            request_id: of the goal.

        Raises:
            OSError: the folder cannot be written.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        self.prune(coming=1)
        names = _numbered(base_name(began, request_id), PARTIAL)
        while True:
            path = self.path / next(names)
            with contextlib.suppress(FileExistsError):
                return path, _open_new(path)

    def finish(self, partial: Path, stream: BinaryIO, code: str) -> Path:
        """Give a record that is complete its name; what has that name already keeps it.

        Args:
            partial, stream: its file.
            code: by which the docking ended.

        Raises:
            OSError: the folder cannot be written.
        """
        _require_same(partial, stream)
        names = _numbered(f"{partial.name.removesuffix(PARTIAL)}-{code}", SUFFIX)
        while True:
            path = self.path / next(names)
            try:
                os.link(partial, path, follow_symlinks=False)  # a rename would take the place of what is there
            except FileExistsError:
                continue
            except OSError:  # a file system without links
                if os.path.lexists(path):
                    continue
                partial.rename(path)
            else:
                partial.unlink()
            sync_folder(self.path)
            return path

    def forget(self, partial: Path, stream: BinaryIO) -> None:
        """Remove a record that is being written; arguments and errors as of `finish`."""
        _require_same(partial, stream)
        partial.unlink()

    @contextlib.contextmanager
    def rewriting(self, path: Path, stream: BinaryIO) -> Iterator[BinaryIO]:
        """Yield a file that takes the place of a record at the end of the block; where that raises, nothing changes.

        Args:
            path, stream: of the record.

        Raises:
            OSError: the folder cannot be written, or something stands in the way.
        """
        beside = path.with_name(f".{path.name.removesuffix(SUFFIX)}{PARTIAL}")
        with _open_new(beside) as new:
            try:
                yield new
                flush(new)
                _require_same(path, stream)
                beside.replace(path)
            except BaseException:
                beside.unlink(missing_ok=True)
                raise
        sync_folder(self.path)

    def entries(self) -> list[Entry]:
        """Return our records, oldest first.

        Raises:
            OSError: the folder cannot be read.
        """
        found, known = list[Entry](), dict[str, Look]()
        self.passed_by = {}
        for name in sorted(os.listdir(self.path), key=lambda name: name.removeprefix(".")):
            if not is_named_like_one(name):
                continue
            try:
                seen = look(self.path / name, self._known.get(name))
            except FileNotFoundError:  # another recorder forgot or renamed it meanwhile
                continue
            known[name] = seen
            if not seen.problem:
                found.append(Entry(self.path / name, seen.size, seen.under_way, seen.identity))
            elif not seen.under_way:  # another recorder has opened it and not yet said what it is
                self.passed_by[name] = seen.problem
        self._known = known
        return found

    def prune(self, coming: int = 0) -> list[Path]:
        """Remove the oldest records until the bounds hold, and return them; one under way is never among them.

        What a recorder left that was killed while it packed goes too: the record itself is there.

        Args:
            coming: records that are about to be made.

        Raises:
            OSError: the folder cannot be read.
        """
        entries = self.entries()
        count, size = len(entries) + coming, sum(entry.size for entry in entries)
        removed = []
        for entry in entries:
            within = count <= self._max_files and size <= self._max_bytes
            if entry.under_way or (within and not entry.path.name.startswith(".")):
                continue
            if self._remove(entry):
                removed.append(entry.path)
                count, size = count - 1, size - entry.size
        return removed

    def _remove(self, entry: Entry) -> bool:
        try:
            if look(entry.path).identity != entry.identity:  # somebody changed it since
                return False
            entry.path.unlink()
        except FileNotFoundError:  # another recorder was quicker
            return True
        except OSError as error:
            self.passed_by[entry.path.name] = f"it cannot be removed: {error.strerror}"
            return False
        return True


def _numbered(base: str, suffix: str) -> Iterator[str]:
    """Yield names until one is free."""
    yield base + suffix
    for number in itertools.count(2):
        yield f"{base}-{number}{suffix}"


def _open_new(path: Path) -> BinaryIO:
    """Return a file that was not there, locked for as long as it is open."""
    stream = path.open("xb")
    fcntl.flock(stream, fcntl.LOCK_EX)  # who looks whether somebody has it open holds it for a moment
    return stream


def _require_same(path: Path, stream: BinaryIO) -> None:
    """Raise FileNotFoundError where another file than ours has its name."""
    if not os.path.samestat(path.lstat(), os.fstat(stream.fileno())):
        raise FileNotFoundError(errno.ENOENT, "somebody moved the record that was being written", str(path))
