# SPDX-License-Identifier: Apache-2.0
"""Files that appear whole or not at all, whatever happens while they are written."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

_UNFINISHED = ".unfinished-"


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Give a name beside `path` to write to; at the end, what stands there is on the disk and becomes `path`.

    Where the body raises, `path` stays as it was. A process killed meanwhile leaves only what `forget_unfinished` takes
    away.

    Raises:
        OSError: the disk does not take it.
    """
    beside = path.with_name(f"{_UNFINISHED}{path.name}")
    try:
        yield beside
        with beside.open("rb") as file:
            os.fsync(file.fileno())
        beside.replace(path)
        sync_folder(path.parent)
    finally:
        beside.unlink(missing_ok=True)


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
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
