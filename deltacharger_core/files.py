# SPDX-License-Identifier: Apache-2.0
"""Files that appear whole or not at all, whatever happens while they are written."""

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
def whole(path: Path) -> Iterator[Path]:
    """Give a name beside `path` to write to; at the end, what stands there is on the disk and becomes `path`.

    Where the body raises, `path` stays as it was. A process killed meanwhile leaves only what `forget_unfinished` takes
    away. What is no file, such as a pipe or /dev/stdout, is written to directly; a link is followed.

    Raises:
        OSError: the disk does not take it.
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
    """Write UTF-8 text, whole or not at all.

    Raises:
        OSError: the disk does not take it.
    """
    with whole(Path(path)) as beside:
        beside.write_text(text, encoding="utf-8", newline="")


def append_text(path: Path, text: str) -> None:
    """Add UTF-8 text to a file and wait until it is on the disk.

    Raises:
        OSError: the disk does not take it.
    """
    with path.open("a", encoding="utf-8", newline="") as file:
        file.write(text)
        flush(file)


def flush(file: IO[Any]) -> None:
    """Wait until what was written to a file is on the disk."""
    file.flush()
    _sync(file.fileno())


def make_folder(path: Path) -> None:
    """Make a folder, where there is none, that outlives a power cut."""
    if not path.is_dir():
        path.mkdir()
        sync_folder(path.absolute().parent)


def forget_unfinished(folder: Path) -> None:
    """Remove what killed processes left half written in `folder`."""
    for path in folder.glob(f"{_UNFINISHED}*"):
        path.unlink(missing_ok=True)


def sync_folder(folder: Path) -> None:
    """Bring a folder's list of names to the disk."""
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
