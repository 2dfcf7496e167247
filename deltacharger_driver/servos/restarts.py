# SPDX-License-Identifier: Apache-2.0
"""Configures servos again after a restart, requested or not; torque stays off. No ROS."""

from __future__ import annotations

from collections.abc import Callable

from deltacharger_driver.errors import DriverError, PortGone
from deltacharger_driver.servos.bus import ServoBus
from deltacharger_driver.servos.requests import ServoRequest
from deltacharger_driver.servos.snapshot import BusSnapshot

_REBOOT_TIME = 3.0  # s until all servos must be back


class ServoRestarts:
    """Requested reboots, and the configuration of restarted servos. Used by the servos' thread.

    Args:
        bus: of the servos.
        notify: called with severity and message.
    """

    def __init__(self, bus: ServoBus, notify: Callable[[str, str], None]) -> None:
        self._bus = bus
        self._notify = notify
        self._request: ServoRequest | None = None
        self._deadline = 0.0
        self._away: set[int] = set()  # servos being rebooted that are not back
        self._last_error = ""

    @property
    def is_rebooting(self) -> bool:
        """Whether some of the servos being rebooted are not back yet."""
        return self._request is not None

    def reboot(self, request: ServoRequest, snapshot: BusSnapshot | None) -> None:
        """Restart the servos with a latched error, or all if none has one; finish `request` when they are back.

        Raises:
            NoAnswer, CorruptReply, ServoFault, PortGone: a servo did not accept the instruction.
        """
        if self._request is not None:
            request.finish(False, "the servos are already being rebooted")
            return
        faulty = [i for i, bits in enumerate(snapshot.hardware_error) if bits] if snapshot is not None else []
        self._away = set(faulty or range(len(self._bus.settings.ids)))
        for index in sorted(self._away):
            self._bus.reboot(index)
        self._request, self._deadline = request, self._bus.clock.now() + _REBOOT_TIME

    def restore(self, snapshot: BusSnapshot) -> list[int]:
        """Configure every restarted servo; return the ids of those that restarted without a request.

        Raises:
            PortGone: the port vanished.
        """
        unrequested = []
        for index, servo in enumerate(self._bus.settings.ids):
            if not snapshot.rebooted[index]:
                continue
            try:
                self._bus.configure(index)
            except PortGone:
                raise
            except DriverError as error:
                if str(error) != self._last_error:
                    self._last_error = str(error)
                    self._notify("warning", f"servo {servo} had restarted: {error}")
                continue
            self._notify("warning", f"servo {servo} had restarted; configured again, torque off")
            self._away.discard(index)
            if self._request is None:
                unrequested.append(servo)
        return unrequested

    def look(self, snapshot: BusSnapshot, faults: list[str]) -> None:
        """Finish the request if all servos are back or the time is over.

        Args:
            snapshot: of this cycle.
            faults: that forbid moving.
        """
        if self._request is None:
            return
        if not self._away and snapshot.complete:
            self._request.finish(not faults, "; ".join(faults) or "rebooted and configured; torque is off")
        elif self._bus.clock.now() >= self._deadline:
            self._request.finish(False, "; ".join(faults) or "the servos did not come back in time")
        else:
            return
        self._request = None

    def refuse(self, reason: str) -> None:
        """Finish a pending request without success."""
        if self._request is not None:
            self._request.finish(False, reason)
            self._request = None
