# SPDX-License-Identifier: Apache-2.0
"""Disturbances of a docking: taxels that read too high, a robot parked askew, a target nudged while charging."""

import math
import random
import statistics
from dataclasses import dataclass
from typing import Any

import numpy as np

from deltacharger_core import arrays, machine
from deltacharger_core.parameters import number
from deltacharger_docking import charging, energy
from deltacharger_docking.observation import Observation
from deltacharger_sim.virtual.virtual_charger import VirtualCharger
from deltacharger_sim.world import World

LASTS = 0.2  # s of a nudge: a person bumps into the target
_LOOK = 0.5  # s that an estimate and its consequences take at most


@dataclass(frozen=True)
class Taxels:
    """Errors of taxels that no tare removes."""

    high_row: float = number(0.0, 0.0, 5.0, "N", "excess reading of one row of ten taxels of one pad, after each tare")


@dataclass(frozen=True)
class Parked:
    """Orientation of the robot before the target."""

    heading: float = number(
        0.0, -0.1, 0.1, "rad", "turn of the robot about +y, from +z to +x; the target's faces appear turned back by it"
    )


@dataclass(frozen=True)
class Nudge:
    """Movement of the target while it is charged."""

    x: float = number(0.0, -0.02, 0.02, "m", "movement of the target during charging, along x of charger_base")
    y: float = number(0.0, -0.02, 0.02, "m", "movement along y")
    roll: float = number(0.0, -0.2, 0.2, "rad", "turn of the target during charging about z, from +x to +y")
    after: float = number(2.0, 0.0, 60.0, "s", "time from the closing of the contactor to the nudge")

    @property
    def moves(self) -> bool:
        """Whether there is a nudge."""
        return (self.x, self.y, self.roll) != (0.0, 0.0, 0.0)


def high_row(excess: float, seed: int) -> arrays.Array:
    """Return the excess reading of each taxel (2, 10, 10) N: `excess` in one row of one pad, both drawn by `seed`."""
    source = random.Random(f"{seed} taxels.high_row")
    found = np.zeros((machine.PADS, machine.ROWS, machine.COLUMNS))
    found[source.randrange(machine.PADS), source.randrange(machine.ROWS)] = excess
    return found


class Nudging:
    """Nudges the target of a charger once, and records when the contactor opens.

    Args:
        nudge: the movement.
        world: of the target.

    Attributes:
        opened: s from the start of the nudge to the opening of the contactor; NaN = not nudged, or still closed.
    """

    def __init__(self, nudge: Nudge, world: World) -> None:
        self._nudge, self._world = nudge, world
        self._closed_at = self._began = math.nan  # s, time of closing; s, start of the nudge
        self._done = False
        self.opened = math.nan

    def look(self) -> None:
        """Start the nudge when it is due, and record when the contactor opens; call after each tick."""
        if self._done:
            return
        live, closed = self._world.record.energised, self._world.circuit.closed
        if math.isnan(self._began):
            if closed and live >= self._nudge.after:
                self._began = live
                self._world.move_target(self._nudge.x, self._nudge.y, self._nudge.roll, LASTS)
        elif not closed:
            self.opened, self._done = live - self._began, True


def watched_after() -> float:
    """Return how long (s) to watch charging after a nudge, so that docking can detect it.

    Docking ends charging after this many bad estimates, one period apart; one more may have begun before the nudge.
    """
    looks = 1 + max(charging.UNSAFE_MAX, charging.BLIND_MAX)
    return LASTS + looks * (charging.CLEARANCE_PERIOD + _LOOK)


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
        until = charger.now + energy.OPEN_TIMEOUT
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
