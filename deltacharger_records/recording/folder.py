# SPDX-License-Identifier: Apache-2.0
"""The folder of records, with bounds on their number and size. Foreign files are never touched."""

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
"""Names of a record's metadata: each goal's result, docking's parameters, the ending."""


@dataclass(frozen=True)
class Entry:
    """A record in the folder: its file, size (bytes), whether its docking is in progress, and its identity."""

    path: Path
    size: int
    under_way: bool
    identity: tuple[int, ...]


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
        self.passed_by: dict[str, str] = {}
        self._max_files = max_files
        self._max_bytes = max_bytes
        self._known: dict[str, Look] = {}

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
        names = _numbered(base_name(began, request_id), PARTIAL)
        while True:
            path = self.path / next(names)
            with contextlib.suppress(FileExistsError):
                return path, _open_new(path)

    def finish(self, partial: Path, stream: BinaryIO, code: str) -> Path:
        """Give a complete record its name; an existing file with that name keeps it.

        Args:
            partial, stream: its file.
            code: name of the docking's result.

        Raises:
            OSError: the folder cannot be written.
        """
        _require_same(partial, stream)
        names = _numbered(f"{partial.name.removesuffix(PARTIAL)}-{code}", SUFFIX)
        while True:
            path = self.path / next(names)
            try:
                os.link(partial, path, follow_symlinks=False)  # a rename would replace an existing file
            except FileExistsError:
                continue
            except OSError:  # the file system has no links
                if os.path.lexists(path):
                    continue
                partial.rename(path)
            else:
                partial.unlink()
            sync_folder(self.path)
            return path

    def forget(self, partial: Path, stream: BinaryIO) -> None:
        """Remove a record in progress; arguments and errors as of `finish`."""
        _require_same(partial, stream)
        partial.unlink()

    @contextlib.contextmanager
    def rewriting(self, path: Path, stream: BinaryIO) -> Iterator[BinaryIO]:
        """Yield a file that replaces a record at the end of the block; if the block raises, nothing changes.

        Args:
            path, stream: of the record.

        Raises:
            OSError: the folder cannot be written, or a foreign file is in the way.
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
            except FileNotFoundError:  # another recorder removed or renamed it
                continue
            known[name] = seen
            if not seen.problem:
                found.append(Entry(self.path / name, seen.size, seen.under_way, seen.identity))
            elif not seen.under_way:  # else another recorder has just created it, without a head yet
                self.passed_by[name] = seen.problem
        self._known = known
        return found

    def prune(self, coming: int = 0) -> list[Path]:
        """Remove the oldest records until the bounds hold, and return them; never one in progress.

        It also removes the packed copy of a recorder killed while packing: the record itself still exists.

        Args:
            coming: records about to be created.

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
            if look(entry.path).identity != entry.identity:  # it was changed since
                return False
            entry.path.unlink()
        except FileNotFoundError:  # another recorder removed it first
            return True
        except OSError as error:
            self.passed_by[entry.path.name] = f"cannot be removed: {error.strerror}"
            return False
        return True


def _numbered(base: str, suffix: str) -> Iterator[str]:
    """Yield `base`, `base`-2, `base`-3 …; the caller takes the first free one."""
    yield base + suffix
    for number in itertools.count(2):
        yield f"{base}-{number}{suffix}"


def _open_new(path: Path) -> BinaryIO:
    """Return a new file, locked while it is open."""
    stream = path.open("xb")
    fcntl.flock(stream, fcntl.LOCK_EX)  # a recorder that checks whether it is in use holds it briefly
    return stream


def _require_same(path: Path, stream: BinaryIO) -> None:
    """Raise FileNotFoundError if another file has taken its name."""
    if not os.path.samestat(path.lstat(), os.fstat(stream.fileno())):
        raise FileNotFoundError(errno.ENOENT, "another program moved the record in progress", str(path))
