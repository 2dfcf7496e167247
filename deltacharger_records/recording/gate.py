# SPDX-License-Identifier: Apache-2.0
"""Which messages of a docking are kept: all while something happens, few of them during hours of charging.

Time is passed in (s, monotonic), so that hours can be tried in a moment.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection

from deltacharger_core.mcap_file import Raw

_HELD_MAX = 16 * 2**20  # bytes kept in memory, whatever the rates are
_STRETCH = 3600  # messages of a topic after which a quiet stretch is kept ever more thinly


class Gate:
    """Takes every message and returns those to write, in their order.

    Closed, it holds the last seconds. Open, it lets all pass. In a quiet stretch it holds the last seconds and lets few
    of what grows older pass: `rate` a second of each topic, and beyond an hour's worth ever fewer, so that their number
    grows only with the logarithm of time. When something happens, what it holds passes whole.

    Args:
        before: s that are held.
        rate: messages of each topic per second in a quiet stretch.
        budget: bytes of one record beyond which only the topics in `always` pass.
        always: topics of which every message passes.

    Attributes:
        dropped: how many messages of each topic did not pass since it was opened.
    """

    def __init__(self, before: float, rate: float, budget: int, always: Collection[str]) -> None:
        self._before = before
        self._period = 1.0 / rate
        self._budget = budget
        self._always = frozenset(always)
        self._held: deque[tuple[float, Raw]] = deque()
        self._bytes = 0
        self._waiting = 0  # messages at the end of what is held that were neither passed nor dropped
        self._open = False
        self._quiet_since: float | None = None
        self._whole_until = 0.0
        self._last: dict[str, float] = {}
        self._passed = 0
        self.dropped: Counter[str] = Counter()

    def open(self) -> list[Raw]:
        """Begin a record; return what was held."""
        self._open, self._quiet_since, self._passed = True, None, 0
        self.dropped = Counter()
        self._waiting = len(self._held)
        return self._all()

    def close(self) -> list[Raw]:
        """End the record; return what it still has to hold. The last seconds stay held, for the next one."""
        rest = self._all() if self._open else []
        self._open = False
        return rest

    def rest(self, now: float) -> None:
        """A quiet stretch begins, once the last event is as long ago as is held; does nothing during one."""
        if self._quiet_since is None:
            self._quiet_since, self._whole_until = now, now + self._before
            self._last = {}

    def wake(self) -> None:
        """The quiet stretch is over."""
        self._quiet_since = None

    def stir(self, now: float) -> None:
        """Something happens: what is held and what comes next is kept whole."""
        self._whole_until = now + self._before

    def offer(self, now: float, message: Raw) -> list[Raw]:
        """Take a message that came at `now`; return what is to be written."""
        self._held.append((now, message))
        self._bytes += len(message.data)
        self._waiting += 1
        if not self._open:
            self._waiting = 0
            written: list[Raw] = []
        elif self._quiet_since is None or now < self._whole_until:
            written = self._all()
        else:
            written = self._few(now, self._quiet_since)
        self._forget(now)
        return written

    def _all(self) -> list[Raw]:
        start = len(self._held) - self._waiting
        self._waiting = 0
        return [message for _, message in list(self._held)[start:] if self._affords(message)]

    def _few(self, now: float, since: float) -> list[Raw]:
        written = []
        while self._waiting and self._held[-self._waiting][0] <= now - self._before:
            time, message = self._held[-self._waiting]
            self._waiting -= 1
            period = max(self._period, (time - since) / _STRETCH)
            if message.topic in self._always or time - self._last.get(message.topic, -float("inf")) >= period:
                self._last[message.topic] = time
                if self._affords(message):
                    written.append(message)
            else:
                self.dropped[message.topic] += 1
        return written

    def _affords(self, message: Raw) -> bool:
        if self._passed > self._budget and message.topic not in self._always:
            self.dropped[message.topic] += 1
            return False
        self._passed += len(message.data)
        return True

    def _forget(self, now: float) -> None:
        while self._held:
            old = self._held[0][0] < now - self._before and len(self._held) > self._waiting
            if not old and self._bytes <= _HELD_MAX:
                return
            _, message = self._held.popleft()
            self._bytes -= len(message.data)
            if self._waiting > len(self._held):
                self._waiting = len(self._held)
                self.dropped[message.topic] += 1
