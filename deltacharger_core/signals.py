# SPDX-License-Identifier: Apache-2.0
"""The signals that ask a process to end, from its first moment to its last, and the end of the process that started it.

The first of SIGINT, SIGTERM and SIGHUP sets an event, whatever the process does at that moment; further ones change
nothing, so that a second Ctrl-C, or one that comes both from a terminal and from `ros2 launch`, breaks off no closing.
"""

from __future__ import annotations

import _thread
import contextlib
import ctypes
import os
import select
import signal
import threading
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_STARTER = "DELTACHARGER_STARTER"  # id of the process with which this one ends
_SET_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of Linux
_event: threading.Event | None = None


def listen() -> threading.Event:
    """Let the signals set the event that is returned, the same one at each call until `ignore`.

    Only in the main thread. A SIGHUP that is ignored stays so: then the process was started by nohup.
    """
    global _event
    if _event is None:
        _event = threading.Event()
        for number in heard():
            signal.signal(number, _on_signal)
        follow_starter()
    return _event


def ignore() -> None:
    """Hear no more signals: what is under way is the end."""
    global _event
    _event = None
    for number in heard():
        signal.signal(number, signal.SIG_IGN)  # the interpreter's own end would restore a handler of Python's


def heard() -> list[signal.Signals]:
    """Return the signals that ask this process to end."""
    return [each for each in ENDING if each != signal.SIGHUP or signal.getsignal(each) != signal.SIG_IGN]


def set_event(event: threading.Event) -> None:
    """Set an event from the handler of a signal.

    `Event.set` takes a lock, which the code that the handler interrupts may hold; another thread can wait for it.
    """
    _thread.start_new_thread(event.set, ())


def end_with(starter: int) -> dict[str, str]:
    """Return the environment variable by which a child that listens ends when its parent of this id has ended."""
    return {_STARTER: str(starter)}


def follow_starter() -> None:
    """Take the end of the process that started this one, where it has asked for that, as SIGTERM."""
    starter = os.environ.pop(_STARTER, "")  # a child of our own has another one
    if not starter.isdecimal():
        return
    with contextlib.suppress(OSError, AttributeError):  # no Linux
        ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGTERM)
    if os.getppid() != int(starter) and _has_ended(int(starter)):  # gone already; a debugger may stand between
        os.kill(os.getpid(), signal.SIGTERM)


def _on_signal(number: int, frame: FrameType | None) -> None:
    if _event is not None:
        set_event(_event)


def _has_ended(process: int) -> bool:
    """Return whether a process has ended, also one that nobody has waited for."""
    try:
        handle = os.pidfd_open(process)
    except ProcessLookupError:
        return True
    except (OSError, AttributeError):  # no Linux, or an old one
        return False
    try:
        return bool(select.select([handle], [], [], 0.0)[0])
    finally:
        os.close(handle)
