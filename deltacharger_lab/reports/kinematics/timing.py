# SPDX-License-Identifier: Apache-2.0
"""Process time of a call: what it costs this process, whatever else the machine does."""

from __future__ import annotations

import statistics
import time
import timeit
from collections.abc import Callable
from dataclasses import dataclass

_LARGEST_COUNT = 1 << 20


@dataclass(frozen=True)
class Cost:
    """Seconds per call over repeats.

    Attributes:
        median: of the repeats; what the tables show.
        best: the least disturbed repeat.
    """

    median: float
    best: float


@dataclass(frozen=True)
class Stopwatch:
    """How long and how often calls are timed.

    Attributes:
        repeats: number of timings of which median and best are kept.
        least: s, shortest timing; quicker calls are repeated within one.
    """

    repeats: int = 7
    least: float = 0.02

    def time(self, call: Callable[[], object]) -> Cost:
        """Return the cost of `call` after a first call that does not count."""
        call()
        count = 1
        while count < _LARGEST_COUNT:
            spent = _spent(call, count)
            if spent >= self.least:
                break
            count = max(2 * count, min(_LARGEST_COUNT, int(1.2 * count * self.least / max(spent, 1e-7))))
        each = [_spent(call, count) / count for _ in range(self.repeats)]
        return Cost(statistics.median(each), min(each))

    def ratio(self, slow: Callable[[], object], quick: Callable[[], object]) -> float:
        """Return how many times as long `slow` takes as `quick`: the median over turns of the two."""
        counts = []
        for call in (slow, quick):
            cost = Stopwatch(1, self.least).time(call)
            counts.append(max(1, round(self.least / max(cost.best, 1e-7))))
        quotients = []
        for _ in range(2 * self.repeats):
            first, second = (_spent(call, count) / count for call, count in zip((slow, quick), counts, strict=True))
            quotients.append(first / max(second, 1e-12))
        return statistics.median(quotients)


def _spent(call: Callable[[], object], count: int) -> float:
    return timeit.timeit(call, timer=time.process_time, number=count)
