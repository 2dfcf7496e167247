# SPDX-License-Identifier: Apache-2.0
"""Common to all commands: their result, exit codes and errors, and signals as events."""

from __future__ import annotations

import argparse
import contextlib
import errno
import json
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import FrameType
from typing import Any

from deltacharger_core import signals, streams
from deltacharger_core.ros.outcomes import json_ready

DONE, FAILED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130

_WRONG_PATH = (errno.ENAMETOOLONG, errno.ELOOP, errno.EINVAL, errno.EROFS, errno.ENXIO, errno.ENODEV)


@dataclass(frozen=True)
class Result:
    """What a command did or found. Printed as text, or with --json as one object.

    Attributes:
        text: for stdout.
        details: keys of the object, beside `success`, which is true with exit code 0.
        code: exit code.
        remarks: lines for stderr.
    """

    text: str = ""
    details: Mapping[str, Any] = field(default_factory=dict)
    code: int = DONE
    remarks: Sequence[str] = ()


class CommandError(Exception):
    """A command ends with a message and an exit code.

    Args:
        message: what is wrong and what to do.
        exit_code: of the process; one of the codes above.
        details: further keys of the JSON object.
    """

    def __init__(self, message: str, exit_code: int = FAILED, **details: Any) -> None:
        self.exit_code = exit_code
        self.details = details
        super().__init__(message)

    def result(self) -> Result:
        """Return the result of the command."""
        text = streams.shortened(str(self))
        return Result("", {"error": text, **self.details}, self.exit_code, (text,))


class WrongInput(CommandError):
    """Usage or input is wrong; exit code 2."""

    def __init__(self, message: str, **details: Any) -> None:
        super().__init__(message, WRONG_INPUT, **details)


def is_wrong_path(error: OSError) -> bool:
    """Whether another path would help; False if disk, quota, memory or a device is the cause."""
    kinds = FileNotFoundError | FileExistsError | PermissionError | IsADirectoryError | NotADirectoryError
    return isinstance(error, kinds) or error.errno in _WRONG_PATH


def from_os_error(error: OSError, before: str = "") -> CommandError:
    """Return an error of the operating system as a CommandError; `before` begins the message."""
    code = WRONG_INPUT if is_wrong_path(error) else FAILED
    if isinstance(error, FileNotFoundError):
        return CommandError(f"{before}{error.filename or error}: there is no such file", code)
    return CommandError(f"{before}{error}", code)


@contextlib.contextmanager
def wrong_input(*kinds: type[Exception], before: str = "", **details: Any) -> Iterator[None]:
    """Turn errors about a given file or value into a CommandError.

    Args:
        kinds: classes of the errors; their attributes `file`, `key` and `lines` become details.
        before: begins the message.
        details: as in `CommandError`.

    Raises:
        CommandError: instead of them; exit code 2, or 1 if a disk or a device failed.
    """
    try:
        yield
    except kinds as error:
        if isinstance(error, OSError):
            raise from_os_error(error, before) from error
        details |= {name: getattr(error, name) for name in ("file", "key", "lines") if hasattr(error, name)}
        raise WrongInput(f"{before}{error}", **details) from error


def log_line(text: str) -> None:
    """Write a line for people to stderr."""
    streams.write(text, sys.stderr)


class Tenths:
    """Print the progress of a job, at most at every tenth.

    Args:
        share: that was done before.
    """

    def __init__(self, share: float = 0.0) -> None:
        self._tenth = int(10 * share)

    def __call__(self, share: float, text: str = "") -> None:
        """Print `share` with a text, if another tenth is done."""
        if int(10 * share) > self._tenth:
            self._tenth = int(10 * share)
            log_line(f"{100 * share:3.0f} %  {text}".rstrip())


def print_text(text: str) -> None:
    """Write lines of a command's result to stdout."""
    streams.write(text, sys.stdout)


def show(result: Result, as_json: bool) -> int:
    """Print a result as text or as one JSON object, in which NaN and infinity are null; return its exit code."""
    if as_json:
        value = json_ready({"success": result.code == DONE, **result.details})
        print_text(json.dumps(value, ensure_ascii=not streams.takes_unicode()))
    elif result.text:
        print_text(result.text)
    for remark in result.remarks:
        log_line(remark)
    return result.code


def answer(options: argparse.Namespace, result: Result) -> None:
    """Print a result before the command ends; later errors are written to stderr only."""
    show(result, options.json)
    options.json = False


def conclude(
    options: argparse.Namespace,
    refused: bool,
    save: Callable[[str], None],
    text: str,
    details: dict[str, Any],
    remarks: Sequence[str],
) -> Result:
    """Write a calibration to --out, unless it is doubtful without --force, and return it as a result.

    Args:
        options: of the command, with `out` and `force`.
        refused: whether it should not be used.
        save: writes it to a file.
        text, details, remarks: as in `Result`.
    """
    written = options.out if options.out is not None and (options.force or not refused) else None
    if written is not None:
        save(written)
        remarks = [*remarks, f"wrote {written}"]
    elif options.out is not None:
        remarks = [*remarks, f"{options.out} was not written; --force writes it anyway"]
    return Result(text, {**details, "written": written}, FAILED if refused and written is None else DONE, remarks)


class Interrupts:
    """SIGINT, SIGTERM and SIGHUP as an event, so that a command ends in order.

    A second signal ends all waits at once. A closed terminal (SIGHUP) has the effect of SIGTERM.

    Attributes:
        event: set by the first signal.
        impatient: set by the second.
        number: the first signal; 0 = none.
    """

    def __init__(self) -> None:
        self.event = threading.Event()
        self.impatient = threading.Event()
        self.number = 0
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Interrupts:
        for number in signals.ending_signals():
            self._before[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._before.items():
            # After an interruption the process is ending; a third signal must not stop that.
            signal.signal(number, signal.SIG_IGN if self.number else handler)

    @property
    def failure(self) -> int:
        """Exit code of a job that ended early: 130 after a signal, else 1."""
        return INTERRUPTED if self.number else FAILED

    def exit_code(self, otherwise: int) -> int:
        """Return the exit code of a server after a signal: 130 after SIGINT, 0 after others."""
        if self.number == signal.SIGINT:
            return INTERRUPTED
        return DONE if self.number else otherwise

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        signals.set_event(self.impatient if self.number else self.event)
        self.number = self.number or number
