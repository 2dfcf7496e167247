# SPDX-License-Identifier: Apache-2.0
"""Recognise records of docking_recorder_node: the head names the writer, and the file's name agrees with the head.

A name alone proves nothing: a person's recording may have a similar one. A renamed record belongs to the person.
"""

from __future__ import annotations

import fcntl
import io
import os
import re
import stat
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from deltacharger_core.bounded_file import kind_text
from deltacharger_core.mcap_file import require_mcap

SUFFIX = ".mcap"
PARTIAL = ".mcap.partial"
LIBRARY = "deltacharger"
"""Writer named in a file's header."""
ABOUT = "deltacharger"
"""Name of the metadata after the header: version, scene, namespace, request id, time of beginning."""
_STAMP = "%Y%m%dT%H%M%SZ"
_LIKE = re.compile(r"\d{8}T\d{6}Z(-[^/]+)?\.mcap|\.?\d{8}T\d{6}Z(-[^/]+)?\.mcap\.partial", re.DOTALL)
_ENDING = re.compile(r"(-\d+)?(-[A-Z_]+|-\d+)?(-\d+)?\.mcap(\.partial)?")
_UNSAFE = re.compile(r"[^A-Za-z0-9_.]+")
_ID_MAX = 60  # characters of a request id in a name
_VALUE_MAX = 1000  # characters of one metadata value
_HEAD = 32_768  # bytes read to recognise a file; more than the longest head


def safe_id(request_id: str) -> str:
    """Return a request id as part of a file name: letters, digits, points and underscores, bounded length."""
    return _UNSAFE.sub("_", request_id[:_VALUE_MAX]).strip("._")[:_ID_MAX]


def base_name(began: int, request_id: str) -> str:
    """Return the beginning of a record's name.

    Args:
        began: of its docking, ns since 1970.
        request_id: of its goal.

    Raises:
        ValueError, OverflowError, OSError: the time is out of range.
    """
    return "-".join(filter(None, (time.strftime(_STAMP, time.gmtime(began // 10**9)), safe_id(request_id))))


def head(about: Mapping[str, str], began: int, request_id: str) -> dict[str, str]:
    """Return the metadata at the head of a record, each value cut to the length that `look` reads.

    Args:
        about: version, scene and namespace.
        began, request_id: as in `base_name`.
    """
    metadata = {**about, "request_id": request_id, "began": str(began)}
    return {name: word[:_VALUE_MAX] for name, word in metadata.items()}


@dataclass(frozen=True)
class Look:
    """Result of examining a file.

    Attributes:
        problem: why it is not our record; '' = it is.
        size: bytes.
        identity: changes with its location and content.
        under_way: whether a recorder has it open; a killed recorder's lock is gone.
    """

    problem: str
    size: int = 0
    identity: tuple[int, ...] = ()
    under_way: bool = False


def is_named_like_one(name: str) -> bool:
    """Whether a file's name looks like a record's: in progress, complete, or being packed."""
    return _LIKE.fullmatch(name) is not None


def look(path: Path, known: Look | None = None) -> Look:
    """Examine whether a file is our record. Opens regular files only, and reads only the head.

    Args:
        path: of the file.
        known: result of an earlier call; if the file is unchanged, its head is not read again.

    Raises:
        FileNotFoundError: the file is gone.
        RecordingError: mcap is not installed.
    """
    try:
        mode = path.lstat().st_mode
        if not stat.S_ISREG(mode):  # opening a pipe would wait for its other end
            return Look(f"it is {kind_text(mode)}")
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NOCTTY)
    except FileNotFoundError:
        raise
    except OSError as error:
        return Look(f"cannot be read: {error.strerror}")
    with open(descriptor, "rb", buffering=0) as file:
        found = os.fstat(descriptor)
        identity = (found.st_dev, found.st_ino, found.st_ctime_ns)
        if known is not None and known.identity == identity:
            problem = known.problem
        else:
            try:
                problem = _problem(path.name, file.read(_HEAD) if stat.S_ISREG(found.st_mode) else b"")
            except OSError as error:
                return Look(f"cannot be read: {error.strerror}")
        return Look(problem, found.st_size, identity, _is_open_elsewhere(path, descriptor))


def _problem(name: str, content: bytes) -> str:
    about = _about(content)
    if about is None:
        return "docking_recorder_node did not write it"
    try:
        base = base_name(int(about["began"]), about["request_id"])
    except (KeyError, ValueError, OverflowError, OSError):
        return "it does not name its docking"
    own = name.removeprefix(".")
    if not (own.startswith(base) and _ENDING.fullmatch(own.removeprefix(base))):
        return "it was renamed"
    return ""


def _about(content: bytes) -> dict[str, str] | None:
    """Return the metadata at the head of a record; None for another head."""
    require_mcap()
    from mcap.records import Header, Metadata
    from mcap.stream_reader import StreamReader

    try:
        # Chunks stay compressed: a few bytes may unpack to gigabytes.
        records = StreamReader(io.BytesIO(content), emit_chunks=True, record_size_limit=_HEAD).records
        header, about = next(records), next(records)
    except Exception:  # mcap's errors for foreign or too few bytes
        return None
    if not (isinstance(header, Header) and header.library == LIBRARY):
        return None
    return dict(about.metadata) if isinstance(about, Metadata) and about.name == ABOUT else None


def _is_open_elsewhere(path: Path, descriptor: int) -> bool:
    if not path.name.endswith(PARTIAL):
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:  # locked, or no locks on this file system: rather keep one file too many
        return True
    return False
