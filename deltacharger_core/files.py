# SPDX-License-Identifier: Apache-2.0
"""Writes files atomically: complete or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

_UNFINISHED = ".unfinished-"
_CANNOT = (errno.EINVAL, errno.ENOTSUP, errno.EROFS)  # file systems and devices without fsync


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; at the end sync that file to the disk and rename it to `path`.

    If the body raises, `path` stays unchanged. A killed process leaves only a file that `remove_unfinished` removes.
    A pipe or device such as /dev/stdout is written directly. Links are followed.

    Raises:
        OSError: writing fails.
    """
    if path.exists() and not path.is_file():
        yield path
        return
    path = path.resolve()
    beside = path.with_name(f"{_UNFINISHED}{path.name}")
    try:
        yield beside
        with beside.open("rb") as file:
            _sync(file.fileno())
        beside.replace(path)
        sync_folder(path.parent)
    finally:
        beside.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write UTF-8 text atomically.

    Raises:
        OSError: writing fails.
    """
    with atomic_write(Path(path)) as beside:
        beside.write_text(text, encoding="utf-8", newline="")


def append_text(path: Path, text: str) -> None:
    """Append UTF-8 text to a file and sync it to the disk.

    Raises:
        OSError: writing fails.
    """
    with path.open("a", encoding="utf-8", newline="") as file:
        file.write(text)
        flush(file)


def flush(file: IO[Any]) -> None:
    """Sync a file to the disk."""
    file.flush()
    _sync(file.fileno())


def make_folder(path: Path) -> None:
    """Create a folder if missing, safe against a power cut."""
    if not path.is_dir():
        path.mkdir()
        sync_folder(path.absolute().parent)


def remove_unfinished(folder: Path) -> None:
    """Remove unfinished files of killed processes from `folder`."""
    for path in folder.glob(f"{_UNFINISHED}*"):
        path.unlink(missing_ok=True)


def sync_folder(folder: Path) -> None:
    """Sync a folder's directory entries to the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        _sync(descriptor)
    finally:
        os.close(descriptor)


def _sync(descriptor: int) -> None:
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _CANNOT:
            raise
