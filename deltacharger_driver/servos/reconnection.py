# SPDX-License-Identifier: Apache-2.0
"""Reopens a vanished servo port with increasing pauses, and logs each reason once."""

from __future__ import annotations

from collections.abc import Callable

from deltacharger_driver.errors import DriverError
from deltacharger_driver.servos.bus import ServoBus

_FIRST, _LONGEST = 0.25, 0.5  # s between two attempts


class Reconnection:
    """Reopens a bus.

    Args:
        bus: to open.
        notify: called with (severity, message) when the reason changes.

    Attributes:
        fault: why it is not connected.
        count: number of successful reopenings.
    """

    def __init__(self, bus: ServoBus, notify: Callable[[str, str], None]) -> None:
        self._bus = bus
        self._notify = notify
        self._pause = _FIRST
        self._next = 0.0
        self.fault = "not connected"
        self.count = 0

    def lost(self, error: Exception) -> None:
        """Restart the attempts: the port has just vanished."""
        self.fault = str(error)
        self._pause = _FIRST
        self._next = self._bus.clock.now() + self._pause

    def attempt(self) -> bool:
        """Open the bus if the next attempt is due; return whether it is open now."""
        if self._bus.clock.now() < self._next:
            return False
        try:
            self._bus.open(scan=False)
        except DriverError as error:
            self._pause = min(2.0 * self._pause, _LONGEST)
            self._next = self._bus.clock.now() + self._pause
            if str(error) != self.fault:
                self.fault = str(error)
                self._notify("error", self.fault)
            return False
        self._pause = _FIRST
        self.count += 1
        return True
