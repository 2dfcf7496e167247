# SPDX-License-Identifier: Apache-2.0
"""One world behind several emulated devices that access it from their own threads, in real time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from deltacharger_core.arrays import Array
from deltacharger_driver.emulators.power import Outputs, StageReading, TargetPort
from deltacharger_sim.world import World

_CATCH_UP = 0.5  # s; a longer pause of the process is skipped, not computed


class SharedWorld:
    """Advances a world to `clock` at each access; computes nothing in between.

    It is the plant of the servo and board emulators, which use only these methods.

    Args:
        world: advanced in steps of its parameter `step`.
        clock: s, monotonic.
    """

    def __init__(self, world: World, clock: Callable[[], float] = time.monotonic) -> None:
        self.world = world
        self._clock = clock
        self._lock = threading.RLock()
        self._at = clock()

    def _advance(self) -> World:
        now = self._clock()
        step = self.world.parameters.step
        self._at = max(self._at, now - _CATCH_UP)
        while self._at + step <= now:
            self.world.step(step)
            self._at += step
        return self.world

    def command_servo(
        self,
        index: int,
        torque_enabled: bool,
        reference: float,
        current_limit: float,
        gain: float = 1.0,
        braking: float = 1.0,
    ) -> None:
        """Set torque, goal angle (rad), current bound (A) and gains of a servo, as shares of its parameters."""
        with self._lock:
            self._advance().command(index, torque_enabled, reference, current_limit, gain, braking)

    def read_servo(self, index: int) -> tuple[float, float, float, float, float]:
        """Return angle (rad), rate (rad/s), current (A), voltage (V) and temperature (°C) of a servo."""
        with self._lock:
            return self._advance().servo(index)

    def read_taxels(self) -> tuple[Array, Array]:
        """Return left and right (10, 10) N, raw; NaN = dead."""
        with self._lock:
            return self._advance().taxels()

    def read_power(self) -> StageReading:
        """Return what the board measures in the power stage."""
        with self._lock:
            return self._advance().circuit.read_power()

    def drive(self, outputs: Outputs) -> None:
        """Take the board's orders to the power stage."""
        with self._lock:
            self._advance().circuit.drive(outputs)

    def change_target(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Let the target's port behave by these `PortParameters`, at its present voltage unless that is among them.

        Returns:
            What they were.
        """
        with self._lock:
            circuit = self._advance().circuit
            before = circuit.port
            circuit.port = TargetPort(replace(before.parameters, **{"voltage": before.voltage, **values}))
            return {name: getattr(before.parameters, name) for name in values if name != "voltage"}

    def probe(self) -> tuple[float, float]:
        """Return the probe's measurement: Ω (inf = no current flows, NaN = a live port) and V."""
        with self._lock:
            return self._advance().circuit.probe()
