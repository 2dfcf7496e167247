# SPDX-License-Identifier: Apache-2.0
"""Files: opened and read within bounds, written atomically.

Opens and reads files given by users, robots or other programs, within bounds.
A path may name an endless device, a pipe without a writer, a folder or a huge file. Every reader of such files uses
this module, so that none blocks, exhausts memory or takes long to refuse.
"""

import contextlib
import errno
import os
import reprlib
import stat
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, BinaryIO

MEGABYTE = 2**20
LARGEST_TEXT = MEGABYTE
"""Maximum bytes of a hand-written file and of JSON."""
_BLOCK = MEGABYTE
_brief = reprlib.Repr()
_brief.maxstring = _brief.maxother = 80
_brief.maxlong = 40
_brief.maxlist = _brief.maxtuple = _brief.maxdict = 8


class FileRefused(OSError):
    """A file is refused: it is no regular file, too large or not UTF-8. Example: /dev/zero given as a calibration.

    Attributes:
        filename: its path.
        strerror: what is wrong and what to do.
    """

    def __init__(self, path: str | Path, problem: str) -> None:
        super().__init__(errno.EINVAL, problem, str(path))

    def __str__(self) -> str:
        return f"{self.filename}: {self.strerror}"


def given_path(text: str) -> Path:
    """Return a path given by a user; expands `~`, but leaves an unknown `~user` unchanged."""
    return Path(os.path.expanduser(text))


def open_file(path: str | Path, largest: int) -> BinaryIO:
    """Open a regular file for reading, without blocking.

    Args:
        path: file; links are followed.
        largest: maximum size in bytes.

    Raises:
        FileRefused: it is a folder, pipe, socket or device, or too large.
        OSError: the file is missing or not readable.
    """
    _check(path, os.stat(path), largest)  # before opening: opening a serial port resets the connected device
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    try:
        _check(path, os.fstat(descriptor), largest)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def _check(path: str | Path, found: os.stat_result, largest: int) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise FileRefused(path, "it is a folder, pipe, socket or device; give the path of a file")
    if found.st_size > largest:
        raise FileRefused(path, f"it has {size_text(found.st_size)}, more than the {size_text(largest)} allowed")


def size_text(count: int) -> str:
    """Return a number of bytes as text for messages."""
    return f"{count / MEGABYTE:.0f} MB" if count >= MEGABYTE else f"{count / 2**10:.0f} kB"


def read_bytes(path: str | Path, largest: int) -> bytes:
    """Return the content of a regular file; arguments and errors as in `open_file`."""
    with open_file(path, largest) as file:
        try:
            content = file.read(largest + 1)
        except OSError as error:  # it does not name the file
            raise FileRefused(path, f"cannot be read: {error.strerror}") from error
    if len(content) > largest:  # it grew meanwhile, or reports size 0 like files in /proc
        raise FileRefused(path, f"it holds more than the {size_text(largest)} allowed")
    return content


def read_text(path: str | Path, largest: int = LARGEST_TEXT) -> str:
    """Return the text of a regular file; as `open_file`, with FileRefused if the file is not UTF-8."""
    try:
        return read_bytes(path, largest).decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileRefused(path, f"byte {error.start} is not UTF-8; save the file as UTF-8") from error


def sha256(path: str | Path) -> str:
    """Return the SHA-256 of a regular file of any size as hexadecimal digits; errors as in `open_file`."""
    import hashlib

    digest = hashlib.sha256()
    with open_file(path, sys.maxsize) as file:
        while block := file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def parse_json(text: str, largest: int = LARGEST_TEXT) -> Any:
    """Parse JSON from an untrusted source.

    Args:
        text: JSON.
        largest: maximum number of characters.

    Raises:
        ValueError: the text is not JSON, too long, nested too deep, or holds a repeated key.
    """
    import json

    if len(text) > largest:
        raise ValueError(f"its JSON has {len(text)} characters, more than {largest}")
    try:
        return json.loads(text, object_pairs_hook=_once)
    except RecursionError as error:
        raise ValueError("its JSON is nested too deep") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        twice = Counter(name for name, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"its JSON gives the key {brief(twice)} twice")
    return found


def brief(value: Any) -> str:
    """Return repr(value) for messages, shortened if long."""
    return _brief.repr(value)


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
