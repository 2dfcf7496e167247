# SPDX-License-Identifier: Apache-2.0
"""Periodic work at a rate that may be set while its node runs."""

from __future__ import annotations

import threading
from collections.abc import Callable

_LAST = 2.0  # s for running work to end when its node closes


class Regularly:
    """A thread that works at a rate; no thread at rate 0.

    Args:
        work: called with its period (s) and an event; it must return when the event is set.
        name: name of the thread.
    """

    def __init__(self, work: Callable[[float, threading.Event], None], name: str) -> None:
        self._work = work
        self._name = name
        self._lock = threading.Lock()
        self._stopped = False
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, rate: float) -> None:
        """Work at a new rate (Hz), unless stopped; does not wait for running work."""
        with self._lock:
            if self._stopped:
                return
            self._stopping.set()
            self._stopping, self._thread = threading.Event(), None
            if rate > 0.0:
                arguments = (1.0 / rate, self._stopping)
                self._thread = threading.Thread(target=self._work, args=arguments, name=self._name, daemon=True)
                self._thread.start()

    def stop(self) -> None:
        """Stop, and wait for running work. Safe to call twice."""
        with self._lock:
            self._stopped = True
            self._stopping.set()
            thread, self._thread = self._thread, None
        if thread is not None:
            thread.join(_LAST)
