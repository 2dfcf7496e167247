# SPDX-License-Identifier: Apache-2.0
"""Handles SIGINT, SIGTERM and SIGHUP for the lifetime of a process, and the end of the process that started it.

The first signal sets an event at any moment; later ones have no effect. So neither a second Ctrl-C nor one that arrives
from both a terminal and `ros2 launch` interrupts the shutdown.

A program's first module imports this one before any other, so that it ends in order also while it is imported: what
takes long to import is imported where it is used.
"""

from __future__ import annotations

import _thread
import os
import signal
from collections.abc import Callable, Iterable
from types import FrameType

TYPE_CHECKING = False  # not typing's, which takes as long to import as all the rest
if TYPE_CHECKING:
    import threading

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_STARTER = "DELTACHARGER_STARTER"  # id of the process whose end also ends this one
_SET_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of Linux
_event: threading.Event | None = None


def listen() -> threading.Event:
    """Install the handlers and return the event that they set, the same event until `ignore`.

    Call only in the main thread. An ignored SIGHUP stays ignored: nohup started the process.
    """
    import threading

    global _event
    if _event is None:
        _event = threading.Event()
        for number in ending_signals():
            signal.signal(number, _on_signal)
        follow_starter()
    return _event


def end_at_once(code: Callable[[int], int], numbers: Iterable[int] = ENDING) -> None:
    """End the process at these signals without an exception, until other handlers are installed.

    For a program that is still being imported, so that nothing needs to be cleaned up.

    Args:
        code: returns the exit code for the number of a signal; may write to file descriptors.
        numbers: of the signals.
    """
    for number in set(numbers).intersection(ending_signals()):
        signal.signal(number, lambda number, frame: os._exit(code(number)))


def ignore() -> None:
    """Ignore further signals while the process ends."""
    global _event
    _event = None
    for number in ending_signals():
        signal.signal(number, signal.SIG_IGN)  # at exit the interpreter would restore a Python handler


def ending_signals() -> list[signal.Signals]:
    """Return the signals that end this process."""
    return [each for each in ENDING if each != signal.SIGHUP or signal.getsignal(each) != signal.SIG_IGN]


def set_event(event: threading.Event) -> None:
    """Set an event from a signal handler.

    `Event.set` takes a lock that the interrupted code may hold, so another thread sets the event.
    """
    _thread.start_new_thread(event.set, ())


def end_with(starter: int) -> dict[str, str]:
    """Return the environment variable that makes a listening child end with its parent `starter`."""
    return {_STARTER: str(starter)}


def follow_starter() -> None:
    """Treat the end of the starting process as SIGTERM, if that process asked for it."""
    starter = os.environ.pop(_STARTER, "")  # our own children get another one
    if not starter.isdecimal():
        return
    import contextlib
    import ctypes

    with contextlib.suppress(OSError, AttributeError):  # not Linux
        ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGTERM)
    if os.getppid() != int(starter) and _has_ended(int(starter)):  # already gone; a debugger may be in between
        os.kill(os.getpid(), signal.SIGTERM)


def _on_signal(number: int, frame: FrameType | None) -> None:
    if _event is not None:
        set_event(_event)


def _has_ended(process: int) -> bool:
    """Return whether a process has ended, including zombies."""
    import select

    try:
        handle = os.pidfd_open(process)
    except ProcessLookupError:
        return True
    except (OSError, AttributeError):  # not Linux, or an old one
        return False
    try:
        return bool(select.select([handle], [], [], 0.0)[0])
    finally:
        os.close(handle)
