# SPDX-License-Identifier: Apache-2.0
"""The host's heartbeat to the board: sent only until a deadline that its client keeps renewing."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from deltacharger_driver.board.protocol import HEARTBEAT_PERIOD
from deltacharger_driver.errors import PortGone
from deltacharger_driver.rate_meter import Lateness

_NEVER = float("-inf")


class Heartbeat:
    """A thread that sends every 20 ms until a deadline.

    It never extends the deadline itself: if the client dies or hangs, the heartbeat stops and the board opens the
    contactor.

    Attributes:
        lateness: of each heartbeat.

    Args:
        send: sends one heartbeat; may raise `PortGone`, which ends the thread.
        name: of the thread.
    """

    def __init__(self, send: Callable[[], None], name: str) -> None:
        self.lateness = Lateness()
        self._send = send
        self._changed = threading.Condition()
        self._until = _NEVER
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread; nothing is sent yet."""
        self._thread.start()

    def close(self) -> None:
        """Stop and join the thread."""
        with self._changed:
            self._closing = True
            self._until = _NEVER
            self._changed.notify_all()
        self._thread.join()

    def keep_alive(self, until: float) -> None:
        """Send until `until` (s). If none are being sent, the first is sent before this returns.

        Raises:
            PortGone: the port vanished.
        """
        with self._changed:
            idle = time.monotonic() >= self._until
            self._until = until
            self._changed.notify_all()
        if idle and time.monotonic() < until:
            self._send()

    def stop(self) -> None:
        """Send no more."""
        with self._changed:
            self._until = _NEVER

    def _run(self) -> None:
        due = time.monotonic()
        while True:
            with self._changed:
                if self._closing:
                    return
                now = time.monotonic()
                if now >= self._until:
                    self._changed.wait()
                    due = time.monotonic()
                    continue
                if now < due:
                    self._changed.wait(due - now)
                    continue
            self.lateness.note(now - due)
            due = max(due + HEARTBEAT_PERIOD, now)
            try:
                self._send()
            except PortGone:
                return
