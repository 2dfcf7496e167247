# SPDX-License-Identifier: Apache-2.0
"""Load of the servos at rest while a docking charges."""

from __future__ import annotations

import statistics
from typing import Any

from deltacharger_docking.energy import OPEN_TIMEOUT
from deltacharger_docking.observation import Observation
from deltacharger_lab.campaigns.disturbances import Nudging
from deltacharger_sim.virtual.virtual_charger import VirtualCharger

SECONDS = 3.0  # of charging after the outcome, in which docking may still shift load between servos
_LAST = 1.0  # s at the end that count


class Rest:
    """Continues a charging docking, and records the load at rest in its last second.

    Args:
        charger: right after its outcome.
        seconds: time to watch it.
        nudging: nudges its target in this time; None = nothing.
    """

    def __init__(self, charger: VirtualCharger, seconds: float = SECONDS, nudging: Nudging | None = None) -> None:
        self._charger = charger
        self._until = charger.now + seconds
        self._from = self._until - _LAST
        self._nudging = nudging
        self._servos: tuple[list[float], list[float], list[float]] = ([], [], [])
        self._contact: list[float] = []
        self._push: list[float] = []

    def watch(self) -> dict[str, Any]:
        """Advance and return the result columns; currents are NaN if charging ended."""
        charger = self._charger
        distort, charger.distort = charger.distort, self._listen
        while charger.now < self._until and charger.machine.status.charging:
            charger.tick()
            if self._nudging is not None:
                self._nudging.look()
        charger.distort = distort
        if self._nudging is not None and not charger.machine.status.charging:
            self._see_open(self._nudging)
        if not charger.machine.status.charging:
            return {"ended": charger.machine.status.code.name}
        medians = [statistics.median(map(abs, currents)) for currents in self._servos]
        return {
            "rest_current": statistics.median(self._contact),
            "rest_push": statistics.median(self._push),
            **{f"servo_current_{index}": value for index, value in enumerate(medians, 1)},
            "servo_current_hottest": max(medians),
        }

    def _see_open(self, nudging: Nudging) -> None:
        """Advance until the commanded contactor is open; a welded one stays closed."""
        charger = self._charger
        until = charger.now + OPEN_TIMEOUT
        while charger.world.circuit.closed and charger.now < until:
            charger.tick()
            nudging.look()

    def _listen(self, observation: Observation) -> Observation:
        if observation.time > self._from:
            for values, current in zip(self._servos, observation.currents, strict=True):
                values.append(current)
            self._contact.append(self._charger.machine.status.contact_current)
            self._push.append(self._charger.world.push())
        return observation
