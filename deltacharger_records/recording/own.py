# SPDX-License-Identifier: Apache-2.0
"""What shows that a file is a record of docking_recorder_node: its head names its writer, and its name agrees with it.

A name alone shows nothing: a person's recording may be called alike. A record that a person renamed is theirs, too.
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
"""What a file's header names as its writer."""
ABOUT = "deltacharger"
"""Name of the metadata that stand behind the header: version, scene, namespace, request id, when it began."""
_STAMP = "%Y%m%dT%H%M%SZ"
_LIKE = re.compile(r"\d{8}T\d{6}Z(-[^/]+)?\.mcap|\.?\d{8}T\d{6}Z(-[^/]+)?\.mcap\.partial", re.DOTALL)
_ENDING = re.compile(r"(-\d+)?(-[A-Z_]+|-\d+)?(-\d+)?\.mcap(\.partial)?")
_UNSAFE = re.compile(r"[^A-Za-z0-9_.]+")
_ID_MAX = 60  # characters of a request id in a name
_TOLD_MAX = 1000  # characters of one word about a record
_HEAD = 32_768  # bytes that are read of a file to see whose it is; more than the longest head that is written


def safe_id(request_id: str) -> str:
    """Return a request id as part of a file's name: letters, digits, points and underscores, not too many."""
    return _UNSAFE.sub("_", request_id[:_TOLD_MAX]).strip("._")[:_ID_MAX]


def base_name(began: int, request_id: str) -> str:
    """Return how the name of a record begins.

    Args:
        began: when its docking did, ns since 1970.
        request_id: of its goal.

    Raises:
        ValueError, OverflowError, OSError: there is no such time.
    """
    return "-".join(filter(None, (time.strftime(_STAMP, time.gmtime(began // 10**9)), safe_id(request_id))))


def head(about: Mapping[str, str], began: int, request_id: str) -> dict[str, str]:
    """Return the metadata at the head of a record, each value cut to what `look` reads.

    Args:
        about: version, scene and namespace.
        began, request_id: as in `base_name`.
    """
    told = {**about, "request_id": request_id, "began": str(began)}
    return {name: word[:_TOLD_MAX] for name, word in told.items()}


@dataclass(frozen=True)
class Look:
    """What a file is.

    Attributes:
        problem: why it is no record of ours; '' = it is one.
        size: bytes.
        identity: changes with its place and its content.
        under_way: whether a recorder has it open; the lock of one that was killed is gone with it.
    """

    problem: str
    size: int = 0
    identity: tuple[int, ...] = ()
    under_way: bool = False


def is_named_like_one(name: str) -> bool:
    """Whether a file's name looks like a record's, ended or not, or like one that is being packed."""
    return _LIKE.fullmatch(name) is not None


def look(path: Path, known: Look | None = None) -> Look:
    """Say whether a file is a record of ours. Only regular files are opened, and of those only the head is read.

    Args:
        path: of the file.
        known: what an earlier look found; its head is not read again where it is the same file.

    Raises:
        FileNotFoundError: it is gone.
        RecordingError: mcap is not installed.
    """
    try:
        mode = path.lstat().st_mode
        if not stat.S_ISREG(mode):  # opening a pipe waits for its other end
            return Look(f"it is {kind_text(mode)}")
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NOCTTY)
    except FileNotFoundError:
        raise
    except OSError as error:
        return Look(f"it cannot be read: {error.strerror}")
    with open(descriptor, "rb", buffering=0) as file:
        found = os.fstat(descriptor)
        identity = (found.st_dev, found.st_ino, found.st_ctime_ns)
        if known is not None and known.identity == identity:
            problem = known.problem
        else:
            try:
                problem = _problem(path.name, file.read(_HEAD) if stat.S_ISREG(found.st_mode) else b"")
            except OSError as error:
                return Look(f"it cannot be read: {error.strerror}")
        return Look(problem, found.st_size, identity, _is_open_elsewhere(path, descriptor))


def _problem(name: str, content: bytes) -> str:
    about = _about(content)
    if about is None:
        return "docking_recorder_node did not write it"
    try:
        base = base_name(int(about["began"]), about["request_id"])
    except (KeyError, ValueError, OverflowError, OSError):
        return "it does not say which docking it is of"
    own = name.removeprefix(".")
    if not (own.startswith(base) and _ENDING.fullmatch(own.removeprefix(base))):
        return "somebody gave it this name"
    return ""


def _about(content: bytes) -> dict[str, str] | None:
    """Return what the head of a record tells; None where a file has another one."""
    require_mcap()
    from mcap.records import Header, Metadata
    from mcap.stream_reader import StreamReader

    try:
        # Chunks stay as they are: what is packed in a few bytes may be gigabytes.
        records = StreamReader(io.BytesIO(content), emit_chunks=True, record_size_limit=_HEAD).records
        header, about = next(records), next(records)
    except Exception:  # what mcap raises for bytes that are none of its own, and the end of few
        return None
    if not (isinstance(header, Header) and header.library == LIBRARY):
        return None
    return dict(about.metadata) if isinstance(about, Metadata) and about.name == ABOUT else None


def _is_open_elsewhere(path: Path, descriptor: int) -> bool:
    if not path.name.endswith(PARTIAL):
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:  # taken, or locks cannot be had here: then better one file too many
        return True
    return False
