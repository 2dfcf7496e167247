# SPDX-License-Identifier: Apache-2.0
"""Ends a process after a time limit, even if a library blocks for ever while it holds Python's GIL."""

from __future__ import annotations

import contextlib
import ctypes
import math
import time

_CALL = 2  # SIGEV_THREAD of Linux: a thread of the C library calls a function


class _Event(ctypes.Structure):
    """`struct sigevent` of Linux, 64 bytes."""

    _fields_ = [
        ("value", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("_rest", ctypes.c_byte * 40),
    ]


class _Times(ctypes.Structure):
    """`struct itimerspec`: interval and first time, each in s and ns."""

    _fields_ = [(name, ctypes.c_long) for name in ("interval_s", "interval_ns", "first_s", "first_ns")]


def exit_within(limit: float, code: int) -> None:
    """End this process with `code` after at most `limit` s.

    When time is up, the process ends without flushing or clean-up: call this only when nothing but leaving the network
    remains. Does nothing on systems without such timers.

    Args:
        limit: s, above 0.
        code: exit code if the process has not ended by itself.
    """
    with contextlib.suppress(OSError, AttributeError):
        library = ctypes.CDLL(None)
        event = _Event(value=code, notify=_CALL, function=ctypes.cast(library._exit, ctypes.c_void_p))
        timer = ctypes.c_void_p()
        if library.timer_create(time.CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)) == 0:
            rest, seconds = math.modf(limit)
            times = _Times(first_s=int(seconds), first_ns=int(rest * 1e9))
            library.timer_settime(timer, 0, ctypes.byref(times), None)
