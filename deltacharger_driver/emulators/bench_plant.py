# SPDX-License-Identifier: Apache-2.0
"""Pads and circuit without a simulated world: minimal physics for the board emulator.

It lets driver tests set forces and voltages directly: two pads with settable forces, offset and noise, and a power
stage that charges a target. It has no geometry; deltacharger_sim has.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from deltacharger_core.machine import COLUMNS, ROWS
from deltacharger_driver.board.protocol import BoardFault
from deltacharger_driver.emulators.stage import Outputs, StageReading
from deltacharger_driver.emulators.target_port import PortParameters, TargetPort

PRECHARGE_TIME, PULL_IN_TIME = 0.060, 0.005  # s until the output has the target's voltage; until the contactor closes
_STEP = 0.001  # s


class BenchPlant:
    """A `BoardPlant` with settable forces and circuit; thread-safe.

    Attributes:
        left, right: (10, 10) N of contact on each pad.
        battery: V. resistance: ohm of the electrodes' contacts, inf = not touching.
        port: the target.
        detected: a fault to report as detected, 0 = none.
        welded: contacts that have closed do not open. dropped: the coil has lost its supply.
        measured: readings that replace the true ones, by name of `StageReading`.

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
        self.port = TargetPort(PortParameters())
        self.resistance = 2.0
        self.detected = int(BoardFault.NONE)
        self.welded = self.dropped = False
        self.measured: dict[str, Any] = {}
        self._offset = offset
        self._noise = noise
        self._random = np.random.default_rng(seed)
        self._clock = clock
        self._lock = threading.RLock()
        self._updated = clock()
        self._outputs = Outputs()
        self._precharged = self._pulled = math.inf  # s, when output and contacts reach their state
        self._current, self._shown = 0.0, math.nan
        self._closed = False

    @property
    def target(self) -> float:
        """Voltage of the target's battery, negative = reversed, V."""
        return self.port.voltage

    @target.setter
    def target(self, voltage: float) -> None:
        self.port.voltage = voltage

    def press(self, force: float) -> None:
        """Press both pads with `force` N each on the four taxels in the middle."""
        for pad in (self.left, self.right):
            pad[:] = 0.0
            pad[4:6, 4:6] = force / 4.0

    def read_taxels(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """See PadPlant."""
        noise = self._random.normal(self._offset, self._noise, (2, ROWS, COLUMNS))
        return self.left + noise[0], self.right + noise[1]

    def read_power(self) -> StageReading:
        """See PowerPlant."""
        with self._lock:
            self._advance()
            touches = not math.isinf(self.resistance)
            undriven = self.port.undriven if touches else math.nan
            target = self._shown if self._closed and touches else undriven
            ready = self._closed or self._updated >= self._precharged
            output = target if ready else 0.0
            reading = StageReading(self.battery, target, output, self._current, self._closed, self.detected)
            return reading._replace(**self.measured)

    def drive(self, outputs: Outputs) -> None:
        """See PowerPlant."""
        with self._lock:
            self._advance()
            if outputs.precharge != self._outputs.precharge:
                self._precharged = self._updated + PRECHARGE_TIME if outputs.precharge else math.inf
            if outputs.contactor != self._outputs.contactor:
                self._pulled = self._updated + PULL_IN_TIME if outputs.contactor else math.inf
            self._outputs = outputs
            self._switch()

    def probe(self) -> tuple[float, float]:
        """See PowerPlant."""
        return (math.inf, 0.0) if math.isinf(self.resistance) else self.port.probe(self.resistance)

    def _switch(self) -> None:
        pulled = self._outputs.contactor and not self.dropped and self._updated >= self._pulled
        self._closed = pulled or (self._closed and self.welded)
        self._current = self._current if self._closed else 0.0

    def _advance(self) -> None:
        now = self._clock()
        while (left := now - self._updated) > 0.0:
            step = min(left, _STEP) if self._outputs.contactor else left
            self._updated = now if step == left else self._updated + step
            self._switch()
            contact, orders = self.resistance if self._closed else math.inf, self._outputs
            self._current, self._shown = self.port.step(step, orders.voltage, orders.current, contact)
