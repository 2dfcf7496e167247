# SPDX-License-Identifier: Apache-2.0
"""Standard output and error, whatever they lead to: a full disk, nothing, a reader that left, a small alphabet.

A process goes on whatever becomes of what it says: an arm must not stop half-way for a pipe. What standard output did
not take is remembered, so that a command can end with it.
"""

from __future__ import annotations

import io
import os
import sys
from typing import TextIO

_LONGEST = 2000  # characters of a message that names what somebody gave
_CONTROLS = {
    code: f"\\u{code:04x}"
    for code in (*range(0x20), *range(0x7F, 0xA0), 0x2028, 0x2029, *range(0x202A, 0x202F), *range(0x2066, 0x206A))
}
_OF_LINES = {code: text for code, text in _CONTROLS.items() if chr(code) not in "\n\t"}
_lost: list[str] = []  # why standard output did not take something


def secure() -> None:
    """Let both take any text, and let no file that is opened later be one that was closed by who started us."""
    _open_closed(0, os.O_RDONLY)
    if _open_closed(1, os.O_RDONLY):  # what is written to it fails, and is told
        sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
    if _open_closed(2, os.O_WRONLY):
        sys.stderr = os.fdopen(2, "w", encoding="utf-8", closefd=False)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def plain(text: str) -> str:
    """Return a name or value for a line of text: with what would control a terminal, or end the line, spelt out."""
    return text.translate(_CONTROLS)


def brief(text: str) -> str:
    """Return a message without its middle where it is very long."""
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST // 2]} … {text[-_LONGEST // 2 :]}"


def write(text: str, stream: TextIO | None, end: str = "\n") -> None:
    """Write lines, with what would control a terminal spelt out.

    Args:
        text: the lines.
        stream: sys.stdout or sys.stderr; None = nowhere.
        end: behind them.
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
    """Write what is left, so that the end of the process cannot fail for it.

    Returns:
        Why standard output did not take all since the last call; '' = it did, or its reader has left.
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
    """Return the exit code of a process that has said all, 1 where standard output did not take it, and tell so."""
    lost = settle()
    if lost:
        write(f"the answer was lost: standard output: {lost}", sys.stderr)
        settle()
    return code or int(bool(lost))


def _give_up(stream: TextIO, error: Exception) -> None:
    """Let a stream lead nowhere: what its buffer holds is written once more at exit."""
    if stream is sys.stdout and not isinstance(error, BrokenPipeError):
        _lost.append((error.strerror if isinstance(error, OSError) else None) or str(error))
    try:
        number = stream.fileno()
    except (OSError, ValueError):  # no file of the system
        return
    _open_nowhere(number, os.O_WRONLY)


def _open_closed(number: int, how: int) -> bool:
    """Whether a descriptor was closed; then it leads nowhere from now on."""
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
