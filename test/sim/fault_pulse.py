# SPDX-License-Identifier: Apache-2.0
"""Detect whether this process was starved of processor time, which can explain a failure."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from deltacharger_driver.servos.port import REPLY_MARGIN

_EVERY = 0.01  # s
_STARVED = REPLY_MARGIN  # s without the processor after which servos appear silent
_ATTEMPTS = 3


class Pulse:
    """A thread that should run every 10 ms and records its delays."""

    def __init__(self) -> None:
        self._late: list[tuple[float, float]] = []  # instant, delay (s); only long ones
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="pulse", daemon=True)
        self._thread.start()

    def starved(self, instant: float) -> float:
        """Return the longest delay (s) of the thread since an instant (s, monotonic)."""
        return max((late for when, late in list(self._late) if when > instant), default=0.0)

    def attempt(self, act: Callable[[], None], restore: Callable[[], None]) -> None:
        """Run `act`; after a failure run `restore`, and repeat `act` if the computer was too busy."""
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
