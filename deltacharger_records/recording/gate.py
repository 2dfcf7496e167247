# SPDX-License-Identifier: Apache-2.0
"""Select the messages of a docking to keep: all around events, few during hours of charging.

The caller passes the time (s, monotonic), so that tests cover hours in a moment.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection

from deltacharger_core.mcap_file import Raw

_HELD_MAX = 16 * 2**20  # bytes kept in memory, at any rates
_STRETCH = 3600  # messages of a topic after which a quiet stretch is thinned more and more


class Gate:
    """Takes every message and returns those to write, in order.

    Closed, it holds the last seconds. Open, it passes all messages. In a quiet stretch it holds the last seconds and
    passes few older messages: `rate` a second of each topic, and after an hour's worth fewer and fewer, so that their
    number grows with the logarithm of time. At an event it passes everything that it holds.

    Args:
        before: s to hold.
        rate: messages of each topic per second in a quiet stretch.
        budget: bytes of one record; beyond it only the topics in `always` pass.
        always: topics of which every message passes.

    Attributes:
        dropped: messages of each topic dropped since `open`.
    """

    def __init__(self, before: float, rate: float, budget: int, always: Collection[str]) -> None:
        self._before = before
        self._period = 1.0 / rate
        self._budget = budget
        self._always = frozenset(always)
        self._held: deque[tuple[float, Raw]] = deque()
        self._bytes = 0
        self._waiting = 0  # number of the newest held messages, neither passed nor dropped yet
        self._open = False
        self._quiet_since: float | None = None
        self._all_until = 0.0
        self._last: dict[str, float] = {}
        self._passed = 0
        self.dropped: Counter[str] = Counter()

    def open(self) -> list[Raw]:
        """Begin a record; return the held messages."""
        self._open, self._quiet_since, self._passed = True, None, 0
        self.dropped = Counter()
        self._waiting = len(self._held)
        return self._all()

    def close(self) -> list[Raw]:
        """End the record; return the waiting messages. The last seconds stay held for the next record."""
        rest = self._all() if self._open else []
        self._open = False
        return rest

    def rest(self, now: float) -> None:
        """Begin a quiet stretch: no event has occurred for the held seconds. No effect during one."""
        if self._quiet_since is None:
            self._quiet_since, self._all_until = now, now + self._before
            self._last = {}

    def wake(self) -> None:
        """End the quiet stretch."""
        self._quiet_since = None

    def stir(self, now: float) -> None:
        """Report an event: everything held and what follows is kept."""
        self._all_until = now + self._before

    def offer(self, now: float, message: Raw) -> list[Raw]:
        """Take a message received at `now`; return the messages to write."""
        self._held.append((now, message))
        self._bytes += len(message.data)
        self._waiting += 1
        if not self._open:
            self._waiting = 0
            written: list[Raw] = []
        elif self._quiet_since is None or now < self._all_until:
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
