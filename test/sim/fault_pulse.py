# SPDX-License-Identifier: Apache-2.0
"""Whether this process was given the processor when it wanted it: what fails without it may be nobody's fault."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from deltacharger_driver.servos.port import REPLY_MARGIN

_EVERY = 0.01  # s
_STARVED = REPLY_MARGIN  # s without the processor after which servos seem not to have answered
_ATTEMPTS = 3


class Pulse:
    """A thread that wants to run every 10 ms and notes how late it comes to it."""

    def __init__(self) -> None:
        self._late: list[tuple[float, float]] = []  # instant, s late; only what is worth remembering
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="pulse", daemon=True)
        self._thread.start()

    def starved(self, instant: float) -> float:
        """Return the longest time, s, for which the thread had to wait since an instant (s, monotonic)."""
        return max((late for when, late in list(self._late) if when > instant), default=0.0)

    def attempt(self, act: Callable[[], None], restore: Callable[[], None]) -> None:
        """Do something; where it fails, put things right again, and repeat it where the machine was too busy."""
        for left in reversed(range(_ATTEMPTS)):
            begun = time.monotonic()
            try:
                act()
            except AssertionError:
                starved = self.starved(begun)
                restore()
                if not left or starved < _STARVED:
                    raise
            else:
                return

    def close(self) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        before = time.monotonic()
        while not self._over.wait(_EVERY):
            now = time.monotonic()
            late = now - before - _EVERY
            if late > 0.005:
                self._late.append((now, late))
            before = now
