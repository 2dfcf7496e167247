# SPDX-License-Identifier: Apache-2.0
"""Files that a person, a robot or another program gives us: opened, read and told apart within bounds.

A path may name anything: a device without end, a pipe that nobody writes to, a folder, 10 GB of nothing. Every reader
of such files begins here, so that none of them waits, fills the memory or takes long to say no.
"""

from __future__ import annotations

import errno
import os
import reprlib
import stat
import sys
from collections import Counter
from pathlib import Path
from typing import Any, BinaryIO

MEGABYTE = 2**20
LARGEST_TEXT = MEGABYTE
"""Bytes of a file that people write, and of JSON."""
_DEEPEST, _LONGEST_KEY = 50, 300
_BLOCK = MEGABYTE
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFLNK: "a link",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
_brief = reprlib.Repr()
_brief.maxstring = _brief.maxother = 80
_brief.maxlong = 40
_brief.maxlist = _brief.maxtuple = _brief.maxdict = 8


class FileRefused(OSError):
    """A file is not read at all. Example: /dev/zero where a calibration belongs.

    Attributes:
        filename: its path.
        strerror: what is wrong and what to do.
    """

    def __init__(self, path: str | Path, problem: str) -> None:
        super().__init__(errno.EINVAL, problem, str(path))

    def __str__(self) -> str:
        return f"{self.filename}: {self.strerror}"

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.filename, self.strerror)


def given_path(text: str) -> Path:
    """Return the path that a person gave; a `~user` whom this computer does not know stays as it is."""
    return Path(os.path.expanduser(text))


def open_file(path: str | Path, largest: int) -> BinaryIO:
    """Open a regular file for reading, without waiting for anybody.

    Args:
        path: of the file; links are followed.
        largest: bytes that it may have.

    Raises:
        FileRefused: it is a folder, pipe, socket or device, or larger.
        OSError: there is no such file, or it may not be read.
    """
    _check(path, os.stat(path), largest)  # before it is opened: opening a serial port resets what is behind it
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    try:
        _check(path, os.fstat(descriptor), largest)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def _check(path: str | Path, found: os.stat_result, largest: int) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise FileRefused(path, f"it is {kind_text(found.st_mode)}; give the path of a file")
    if found.st_size > largest:
        raise FileRefused(path, f"its {size_text(found.st_size)} are more than the {size_text(largest)} of its kind")


def kind_text(mode: int) -> str:
    """Return what a path leads to by its mode, where that is no regular file, for a message."""
    return _KINDS.get(stat.S_IFMT(mode), "no file")


def size_text(count: int) -> str:
    """Return a number of bytes for a message."""
    return f"{count / MEGABYTE:.0f} MB" if count >= MEGABYTE else f"{count / 2**10:.0f} kB"


def read_bytes(path: str | Path, largest: int) -> bytes:
    """Return what a regular file holds; arguments and errors as of `open_file`."""
    with open_file(path, largest) as file:
        try:
            content = file.read(largest + 1)
        except OSError as error:  # which does not name the file
            raise FileRefused(path, f"cannot be read: {error.strerror}") from error
    if len(content) > largest:  # it grew while it was read, or says 0, as files of /proc do
        raise FileRefused(path, f"it holds more than the {size_text(largest)} of its kind")
    return content


def read_text(path: str | Path, largest: int = LARGEST_TEXT) -> str:
    """Return the UTF-8 text of a regular file; arguments and errors as of `open_file`, and FileRefused for others."""
    try:
        return read_bytes(path, largest).decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileRefused(path, f"byte {error.start} is not UTF-8; save the file as UTF-8") from error


def sha256(path: str | Path) -> str:
    """Return the digest of a regular file of any size in hexadecimal digits; errors as of `open_file`."""
    import hashlib

    digest = hashlib.sha256()
    with open_file(path, sys.maxsize) as file:
        while block := file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def parse_json(text: str, largest: int = LARGEST_TEXT) -> Any:
    """Return what JSON tells that somebody else may have written.

    Args:
        text: the JSON.
        largest: characters that it may have.

    Raises:
        ValueError: it is not JSON, larger, nested deeper than 50 levels, or gives a key twice, one of more than 300
            characters, or a number of more than 64 bits.
    """
    import json

    if len(text) > largest:
        raise ValueError(f"its JSON has {len(text)} characters, more than {largest}")
    try:
        found = json.loads(text, object_pairs_hook=_once, parse_int=_whole)
    except RecursionError as error:
        raise ValueError("its JSON is nested too deep") from error
    if _deeper(found, _DEEPEST):
        raise ValueError(f"its JSON is nested deeper than {_DEEPEST} levels")
    return found


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if any(len(name) > _LONGEST_KEY for name in found):
        raise ValueError(f"its JSON gives a key of more than {_LONGEST_KEY} characters")
    if len(found) != len(pairs):
        twice = Counter(name for name, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"its JSON gives the key {brief(twice)} twice")
    return found


def _whole(digits: str) -> int:
    if len(digits) > 20 or not -(2**63) <= int(digits) < 2**63:
        raise ValueError(f"its JSON holds the number {brief(digits)} of more than 64 bits")
    return int(digits)


def _deeper(value: Any, levels: int) -> bool:
    inside = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return levels < 0 or any(_deeper(each, levels - 1) for each in inside)


def brief(value: Any) -> str:
    """Return repr(value) for a message, cut where it is long."""
    return _brief.repr(value)
