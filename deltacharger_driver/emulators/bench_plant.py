# SPDX-License-Identifier: Apache-2.0
"""Pads and circuit without a simulated world: minimal physics for the board emulator.

It lets driver tests set forces and voltages directly: two pads with settable forces, offset and noise, and a battery
that charges a target through a resistor. It has no geometry; deltacharger_sim has.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from deltacharger_core.machine import COLUMNS, ROWS
from deltacharger_driver.board.protocol import BoardFault

PRECHARGE_TIME = 0.060  # s from the command to the contactor
RAMP = 100.0  # A/s
OPEN_CURRENT = 1.0  # A; below it a ramped opening opens the contactor
LARGEST_CURRENT = 18.0  # A


class BenchPlant:
    """A `BoardPlant` with settable forces and circuit; thread-safe.

    Attributes:
        left, right: (10, 10) N of contact on each pad.
        battery: V. target: V, negative = reversed. resistance: ohm of the loop, inf = not touching.
        detected: a fault to report as detected, 0 = none.
        welded: contacts that have closed do not open. dropped: the coil has lost its supply.
        measured: readings that replace the true ones, by name: battery, target, current.

    Args:
        offset: N added to every taxel, as before a tare.
        noise: N standard deviation.
        seed: of the noise.
        clock: s.
    """

    def __init__(
        self,
        offset: float = 0.12,
        noise: float = 0.02,
        seed: int = 0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.left = np.zeros((ROWS, COLUMNS))
        self.right = np.zeros((ROWS, COLUMNS))
        self.battery = 26.0
        self.target = 24.0
        self.resistance = 2.0
        self.detected = int(BoardFault.NONE)
        self.welded = self.dropped = False
        self.measured: dict[str, float] = {}
        self._offset = offset
        self._noise = noise
        self._random = np.random.default_rng(seed)
        self._clock = clock
        self._lock = threading.RLock()
        self._updated = clock()
        self._current = 0.0
        self._closed = self._driven = False  # contacts, coil
        self._closing_at = math.inf
        self._opening = False

    def press(self, force: float) -> None:
        """Press both pads with `force` N each on the four taxels in the middle."""
        for pad in (self.left, self.right):
            pad[:] = 0.0
            pad[4:6, 4:6] = force / 4.0

    def read_taxels(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """See PadPlant."""
        noise = self._random.normal(self._offset, self._noise, (2, ROWS, COLUMNS))
        return self.left + noise[0], self.right + noise[1]

    def read_power(self) -> tuple[float, float, float, bool, int]:
        """See PowerPlant."""
        with self._lock:
            self._advance()
            target = math.nan if math.isinf(self.resistance) else self.target
            shown = {"battery": self.battery, "target": target, "current": self._current} | self.measured
            return shown["battery"], shown["target"], shown["current"], self._closed, self.detected

    def close_contactor(self) -> None:
        """See PowerPlant."""
        with self._lock:
            self._advance()
            self._closing_at = self._updated + PRECHARGE_TIME
            self._opening = False

    def open_contactor(self, ramp: bool) -> None:
        """See PowerPlant."""
        with self._lock:
            self._advance()
            self._closing_at = math.inf
            self._opening = True
            if not ramp or self._current < OPEN_CURRENT:
                self._break()

    def probe(self) -> tuple[float, float]:
        """See PowerPlant."""
        return self.resistance, (0.0 if math.isinf(self.resistance) else self.target)

    def _break(self) -> None:
        self._driven = self._opening = False
        self._closed = self._closed and self.welded
        self._current = 0.0

    def _advance(self) -> None:
        now = self._clock()
        if now >= self._closing_at:
            self._driven = True
            self._updated = self._closing_at
            self._closing_at = math.inf
        elapsed, self._updated = now - self._updated, now
        pulled = self._driven and not self.dropped
        self._closed = pulled or (self._closed and self.welded)
        if not pulled:
            self._current = 0.0
            return
        if self._opening:
            self._current -= LARGEST_CURRENT / 0.05 * elapsed  # from full current below 1 A within 50 ms
            if self._current < OPEN_CURRENT:
                self._break()
            return
        wanted = min(max((self.battery - self.target) / self.resistance, 0.0), LARGEST_CURRENT)
        self._current = min(self._current + RAMP * elapsed, wanted)
