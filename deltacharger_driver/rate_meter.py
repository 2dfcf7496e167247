# SPDX-License-Identifier: Apache-2.0
"""Rate of events and their lateness. No ROS."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

_LONGEST = 512  # values kept; ten seconds of heartbeats


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
