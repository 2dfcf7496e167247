# SPDX-License-Identifier: Apache-2.0
"""How often something happens, and how late. No ROS."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

_LONGEST = 512  # latenesses kept between two looks; ten seconds of heartbeats


class RateMeter:
    """Counts events between two looks; one thread counts, another may look.

    Attributes:
        total: events since the start.
        late: those of them that came late.

    Args:
        clock: s, monotonic.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self.total = self.late = 0
        self._clock = clock
        self._looked_at_count, self._looked_at = 0, clock()

    def count(self, late: bool = False) -> None:
        """Count one event."""
        self.total += 1
        self.late += late

    def rate(self) -> float:
        """Return the events per second, Hz, since the last call; NaN where no time has passed."""
        count, now = self.total, self._clock()
        happened, elapsed = count - self._looked_at_count, now - self._looked_at
        self._looked_at_count, self._looked_at = count, now
        return happened / elapsed if elapsed > 0.0 else math.nan


class Lateness:
    """How much later than due something happened: the largest ever, and the last ones; one thread notes, any looks.

    Attributes:
        largest: s since the start; NaN before the first.
    """

    def __init__(self) -> None:
        self.largest = math.nan
        self._recent: deque[float] = deque(maxlen=_LONGEST)

    def note(self, lateness: float) -> None:
        """Note one lateness, s."""
        self._recent.append(lateness)
        if not lateness <= self.largest:
            self.largest = lateness

    def percentile(self, share: float) -> float:
        """Return the lateness, s, that a `share` (0–1) of the last 512 did not exceed; NaN before the first."""
        recent = sorted(self._recent.copy())
        return recent[min(math.ceil(share * len(recent)), len(recent)) - 1] if recent else math.nan
