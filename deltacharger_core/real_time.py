# SPDX-License-Identifier: Apache-2.0
"""Time on this computer: age of stamps although its clock was set, rates, priority, and a limit on an exit.

The clock is compared with the monotonic clock, which nobody sets.
Stamps of messages and orders show the computer's clock. A stamp from before a step of this clock is judged by the clock
that it shows, so a step makes no data older or younger. Stamps of another computer, which did not step, then count as
of the time of the step, or as from the future.
"""

import contextlib
import ctypes
import math
import os
import threading
import time
from collections.abc import Callable

from deltacharger_core.machine import ORDER_AGE_MAX

AHEAD = 0.1
"""s, how far a stamp may be ahead of this computer's clock. A message stamped ahead looks that much younger than it
is, so this is no more than the age at which docking stops its arm (PRESS_AGE_MAX). Clocks of two computers with NTP
differ by less than a tenth of it."""

COMPARE_CLOCKS = "if it comes from another computer, compare the clocks of both"
"""What to do about a stamp that is too old or in the future."""

_MEASURED = 100_000_000  # ns between measurements of the lead; slewing changes it by 8 ms at most meanwhile
_READINGS = 3  # per measurement; the fastest counts, since one in a hundred is interrupted between the clocks
_STEP = 50_000_000  # ns, smallest step that is noticed; smaller ones change ages by less than `AHEAD`
_SLEW = 0.1  # largest rate of a clock that is not set; chrony slews by 0.083 at most
_TOLD = 10.0  # s that a step is told


class HostClock:
    """The clock of this computer; thread-safe. It notices a step at the next call, so call it regularly.

    Args:
        system: returns the clock that stamps show, ns.
        monotonic: returns ns.

    Attributes:
        steps: how often the clock was set.
    """

    def __init__(
        self, system: Callable[[], int] = time.time_ns, monotonic: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._system, self._monotonic = system, monotonic
        self._lock = threading.Lock()
        self._looked = self._measured = monotonic()
        self._lead = self._lead_before = self._read()[1]  # now, and before the last step, ns
        self._begin = self._end = -math.inf  # the last step lies between these, s
        self.steps = 0

    def now(self) -> float:
        """Return the monotonic time, s."""
        return 1e-9 * self._monotonic()

    def lead(self) -> int:
        """Return by how much this computer's clock is ahead of the monotonic clock, ns."""
        with self._lock:
            return self._look()

    def age(self, stamp: float) -> float:
        """Return how long ago (s) this computer's clock showed `stamp` (s); negative = it has yet to."""
        with self._lock:
            lead, now = 1e-9 * self._look(), self.now()
            instant, before = stamp - lead, stamp - 1e-9 * self._lead_before
            if instant < self._begin:  # shown before the step, or never
                instant = min(before, self._begin)
            elif instant > now + AHEAD and before <= self._end:
                instant = before
            return now - instant

    def problem(self) -> str:
        """Return that the clock was set in the last ten seconds; '' = it was not."""
        with self._lock:
            self._look()
            if self.now() - self._end > _TOLD:
                return ""
            by = 1e-9 * (self._lead - self._lead_before)
            return (
                f"this computer's clock was set {'forward' if by > 0.0 else 'back'} by {abs(by):.1f} s: set it before "
                "the charger starts, and let NTP slew it (docs/dock-goals.md)"
            )

    def _look(self) -> int:
        """Notice a step, measure when due, and return the lead."""
        now, (_, lead) = self._monotonic(), self._read()
        allowed = _STEP + _SLEW * (now - self._measured)
        if now - self._measured > _MEASURED or abs(lead - self._lead) > allowed:
            took, lead = min(self._read() for _ in range(_READINGS))
            if abs(lead - self._lead) > allowed + took:
                self._lead_before, self._begin, self._end = self._lead, 1e-9 * self._looked, self.now()
                self.steps += 1
            self._lead, self._measured = lead, now
        self._looked = now
        return self._lead

    def _read(self) -> tuple[int, int]:
        """Return the duration of one reading of both clocks, and the lead, ns."""
        before = self._monotonic()
        there = self._system()
        after = self._monotonic()
        return after - before, there - (before + after) // 2


HOST = HostClock()
"""The clock of this process's computer."""


def late(age: float) -> str:
    """Return why an order of this age (s) is not carried out; '' = it is.

    One that waited too long, as for a suspended node, would fall into another goal.
    """
    if age <= ORDER_AGE_MAX:
        return ""
    return (
        f"the order was sent {age:.1f} s ago, more than {ORDER_AGE_MAX:g} s, and is not carried out: if it is still "
        f"wanted, give it again; check whether this computer is too busy; {COMPARE_CLOCKS}"
    )


_PRIORITY = 1  # the lowest of real time: above all ordinary processes, below the kernel's own threads


def take_priority() -> str:
    """Give the calling thread and all that it starts from now on real-time priority (SCHED_FIFO), if permitted.

    Call it before any thread starts: threads of one interpreter wait for each other, so one of ordinary priority would
    delay the others.

    Returns:
        '' = done, else why not and what to permit.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except (AttributeError, OSError) as error:
        why = getattr(error, "strerror", None) or "this is not Linux"
        return (
            f"ordinary priority ({why}): programs beside it may end a charge; to permit real time, set LimitRTPRIO=1 "
            "in a systemd unit, 'USER - rtprio 1' in /etc/security/limits.d/, or docker run --ulimit rtprio=1"
        )
    return ""


def priority() -> str:
    """Return the calling thread's priority in words."""
    try:
        return "real time" if os.sched_getscheduler(0) == os.SCHED_FIFO else "ordinary"
    except AttributeError:
        return "ordinary"


class RateMeter:
    """Counts events and returns their rate; one thread counts, another may read.

    Attributes:
        total: events since the start.
        late: how many of them were late.

    Args:
        clock: s, monotonic.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self.total = self.late = 0
        self._clock = clock
        self._last_count, self._last_time = 0, clock()

    def count(self, late: bool = False) -> None:
        """Count one event."""
        self.total += 1
        self.late += late

    def rate(self) -> float:
        """Return the events per second, Hz, since the last call; NaN if no time has passed."""
        count, now = self.total, self._clock()
        events, elapsed = count - self._last_count, now - self._last_time
        self._last_count, self._last_time = count, now
        return events / elapsed if elapsed > 0.0 else math.nan


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
