# SPDX-License-Identifier: Apache-2.0
"""Robust standard output and error: full disks, closed streams, readers that left, limited encodings.

Output errors never stop a process: an arm must not stop half-way because of a pipe. A failure of standard output is
remembered, so that a command can report it at its end.
"""

import io
import os
import sys
from typing import TextIO

_LONGEST = 2000  # characters of a message that quotes input
_CONTROLS = {
    code: f"\\u{code:04x}"
    for code in (*range(0x20), *range(0x7F, 0xA0), 0x2028, 0x2029, *range(0x202A, 0x202F), *range(0x2066, 0x206A))
}
_OF_LINES = {code: text for code, text in _CONTROLS.items() if chr(code) not in "\n\t"}
_lost: list[str] = []  # why output to standard output was lost


def secure() -> None:
    """Make both streams accept any text, and replace streams that were closed when this process started.

    Otherwise a file opened later would get the descriptor of a closed stream.
    """
    _open_closed(0, os.O_RDONLY)
    if _open_closed(1, os.O_RDONLY):  # writing to it fails and is reported
        sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
    if _open_closed(2, os.O_WRONLY):
        sys.stderr = os.fdopen(2, "w", encoding="utf-8", closefd=False)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def plain(text: str) -> str:
    """Return text for one line: line breaks and terminal control characters are escaped."""
    return text.translate(_CONTROLS)


def shortened(text: str) -> str:
    """Return a message; the middle of a very long one is cut out."""
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST // 2]} … {text[-_LONGEST // 2 :]}"


def write(text: str, stream: TextIO | None, end: str = "\n") -> None:
    """Write lines; terminal control characters are escaped.

    Args:
        text: the lines.
        stream: sys.stdout or sys.stderr; None = nowhere.
        end: text after the lines.
    """
    if stream is None:
        return
    try:
        alphabet = stream.encoding or "utf-8"
        text = text.translate(_OF_LINES).encode(alphabet, "backslashreplace").decode(alphabet)
        print(text, file=stream, end=end, flush=True)
    except (OSError, ValueError) as error:
        _give_up(stream, error)


def takes_unicode() -> bool:
    """Whether standard output is UTF-8."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    return encoding.lower().replace("-", "").replace("_", "") == "utf8"


def settle() -> str:
    """Flush both streams, so that the end of the process cannot fail on them.

    Returns:
        Why output to standard output was lost since the last call; '' = none was, or its reader has left.
    """
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            try:
                stream.flush()
            except (OSError, ValueError) as error:
                _give_up(stream, error)
    why = _lost[0] if _lost else ""
    _lost.clear()
    return why


def ended(code: int) -> int:
    """Return the exit code; if output to standard output was lost, report it and return at least 1."""
    lost = settle()
    if lost:
        write(f"cannot write to standard output: {lost}", sys.stderr)
        settle()
    return code or int(bool(lost))


def _give_up(stream: TextIO, error: Exception) -> None:
    """Redirect a stream to /dev/null, because Python writes its buffer once more at exit."""
    if stream is sys.stdout and not isinstance(error, BrokenPipeError):
        _lost.append((error.strerror if isinstance(error, OSError) else None) or str(error))
    try:
        number = stream.fileno()
    except (OSError, ValueError):  # not a system file
        return
    _open_nowhere(number, os.O_WRONLY)


def _open_closed(number: int, how: int) -> bool:
    """Return whether a descriptor was closed; if so, redirect it to /dev/null."""
    try:
        os.fstat(number)
    except OSError:
        _open_nowhere(number, how)
        return True
    return False


def _open_nowhere(number: int, how: int) -> None:
    nowhere = os.open(os.devnull, how)
    if nowhere != number:
        os.dup2(nowhere, number)
        os.close(nowhere)
