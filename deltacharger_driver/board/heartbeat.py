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
    """Sends every 20 ms until a deadline, by a thread of its own and by any other thread that calls `send_if_due`.

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
        self._due = 0.0
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
            now = time.monotonic()
            if now >= self._until:
                self._due = now
            self._until = until
            self._changed.notify_all()
        self.send_if_due()

    def stop(self) -> None:
        """Send no more."""
        with self._changed:
            self._until = _NEVER

    def send_if_due(self) -> None:
        """Send a heartbeat if one is due. Where other programs delay one thread, another may be in time.

        Raises:
            PortGone: the port vanished.
        """
        with self._changed:
            now = time.monotonic()
            if not self._due <= now < self._until:
                return
            self.lateness.note(now - self._due)
            self._due = max(self._due + HEARTBEAT_PERIOD, now)
        self._send()

    def _run(self) -> None:
        while True:
            with self._changed:
                if self._closing:
                    return
                now = time.monotonic()
                if now >= self._until:
                    self._changed.wait()
                elif now < self._due:
                    self._changed.wait(self._due - now)
            try:
                self.send_if_due()
            except PortGone:
                return
