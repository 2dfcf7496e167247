# SPDX-License-Identifier: Apache-2.0
"""Processes with deadlines, such as nodes that keep the contactor closed: their priority, and how late they are."""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Callable

_PRIORITY = 1  # the lowest of real time: above all ordinary processes, below the kernel's own threads
_LONGEST = 512  # values kept; ten seconds of heartbeats


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


class Lateness:
    """Lateness of periodic events: the maximum and the last values; one thread writes, any may read.

    Attributes:
        largest: s since the start; NaN before the first.
    """

    def __init__(self) -> None:
        self.largest = math.nan
        self._recent: deque[float] = deque(maxlen=_LONGEST)

    def note(self, lateness: float) -> None:
        """Record one lateness, s."""
        self._recent.append(lateness)
        if not lateness <= self.largest:
            self.largest = lateness

    def percentile(self, share: float) -> float:
        """Return the lateness, s, that a `share` (0–1) of the last 512 did not exceed; NaN before the first."""
        recent = sorted(self._recent.copy())
        return recent[min(math.ceil(share * len(recent)), len(recent)) - 1] if recent else math.nan
