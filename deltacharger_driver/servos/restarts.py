# SPDX-License-Identifier: Apache-2.0
"""Servos that restart, by order or by themselves: each is set up again, torque off. No ROS."""

from __future__ import annotations

import time
from collections.abc import Callable

from deltacharger_driver.errors import DriverError, PortGone
from deltacharger_driver.servos.bus import ServoBus
from deltacharger_driver.servos.requests import ServoRequest
from deltacharger_driver.servos.snapshot import BusSnapshot

_REBOOT_TIME = 3.0  # s until all servos must be back


class ServoRestarts:
    """Reboots that were asked for, and the set-up of whatever has lost it. Used by the servos' thread.

    Args:
        bus: of the servos.
        notify: told severity and sentence of what happens.
    """

    def __init__(self, bus: ServoBus, notify: Callable[[str, str], None]) -> None:
        self._bus = bus
        self._notify = notify
        self._asked: ServoRequest | None = None
        self._deadline = 0.0
        self._away: set[int] = set()  # servos that were told to restart and are not back
        self._complaint = ""

    @property
    def is_rebooting(self) -> bool:
        """Whether servos that were told to restart are not all back yet."""
        return self._asked is not None

    def reboot(self, request: ServoRequest, snapshot: BusSnapshot | None) -> None:
        """Restart the servos with a latched error, all where none has one; `request` is finished when they are back.

        Raises:
            NoAnswer, CorruptReply, ServoFault, PortGone: a servo did not take the instruction.
        """
        if self._asked is not None:
            request.finish(False, "the servos are being rebooted already")
            return
        faulty = [i for i, bits in enumerate(snapshot.hardware_error) if bits] if snapshot is not None else []
        self._away = set(faulty or range(len(self._bus.settings.ids)))
        for index in sorted(self._away):
            self._bus.reboot(index)
        self._asked, self._deadline = request, time.monotonic() + _REBOOT_TIME

    def restore(self, snapshot: BusSnapshot) -> list[int]:
        """Set up every servo that has restarted; return the ids of those that did so by themselves.

        Raises:
            PortGone: the port vanished.
        """
        by_themselves = []
        for index, servo in enumerate(self._bus.settings.ids):
            if not snapshot.rebooted[index]:
                continue
            try:
                self._bus.configure(index)
            except PortGone:
                raise
            except DriverError as error:
                if str(error) != self._complaint:
                    self._complaint = str(error)
                    self._notify("warning", f"servo {servo} had restarted: {error}")
                continue
            self._notify("warning", f"servo {servo} had restarted; set up again, torque off")
            self._away.discard(index)
            if self._asked is None:
                by_themselves.append(servo)
        return by_themselves

    def look(self, snapshot: BusSnapshot, faults: list[str]) -> None:
        """Finish the request where all servos are back, or their time is over.

        Args:
            snapshot: of this cycle.
            faults: what stands in the way of moving.
        """
        if self._asked is None:
            return
        if not self._away and snapshot.complete:
            self._asked.finish(not faults, "; ".join(faults) or "rebooted and set up; torque is off")
        elif time.monotonic() >= self._deadline:
            self._asked.finish(False, "; ".join(faults) or "the servos did not come back in time")
        else:
            return
        self._asked = None

    def refuse(self, reason: str) -> None:
        """Finish the request, if there is one: it cannot be carried out any more."""
        if self._asked is not None:
            self._asked.finish(False, reason)
            self._asked = None
