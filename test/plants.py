# SPDX-License-Identifier: Apache-2.0
"""Scripted physics behind the emulators: tests of the driver set loads, forces and voltages directly."""

import math
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from deltacharger_core.machine import COLUMNS, NOMINAL_VOLTAGE, ROWS, SERVO_DAMPING, SERVO_STIFFNESS, TORQUE_CONSTANT
from deltacharger_driver.board.protocol import BoardFault
from deltacharger_sim.emulators.power import Outputs, PortParameters, StageReading, TargetPort

_STEP = 1e-3  # s
_LONGEST = 1.0  # s; a longer pause is not simulated completely
PRECHARGE_TIME, PULL_IN_TIME = 0.060, 0.005  # s until the output has the target's voltage; until the contactor closes


class BenchArm:
    """A `ServoPlant` of servos that follow d · ω = clip(gain · k (reference − angle), ± Kt · limit) + load.

    Without torque a servo keeps its angle. The servos do not affect each other.

    Attributes:
        load: N·m on each servo, toward +angle.
        voltage: V of each servo's supply.
        temperature: °C of each servo.
        commands: last (torque enabled, reference rad, current limit A, P and D gain) of each servo; None before it.
    """

    def __init__(
        self,
        angles: tuple[float, ...] = (-0.7, -0.7, -0.7),
        clock: Callable[[], float] = time.monotonic,
        torque_constant: float = TORQUE_CONSTANT,
    ) -> None:
        count = len(angles)
        self.load, self.temperature = [0.0] * count, [30.0] * count
        self.voltage = [NOMINAL_VOLTAGE] * count
        self.commands: list[tuple[bool, float, float, float, float] | None] = [None] * count
        self._angle, self._velocity, self._current = list(angles), [0.0] * count, [0.0] * count
        self._constant, self._clock, self._at = torque_constant, clock, clock()
        self._lock = threading.RLock()

    @property
    def angles(self) -> tuple[float, ...]:
        """Angle of each servo now, rad."""
        with self._lock:
            self._advance()
            return tuple(self._angle)

    def torque_enabled(self) -> list[bool]:
        """Return whether each servo has torque."""
        return [command is not None and command[0] for command in self.commands]

    def command_servo(
        self,
        index: int,
        torque_enabled: bool,
        reference: float,
        current_limit: float,
        gain: float = 1.0,
        braking: float = 1.0,
    ) -> None:
        """See ServoPlant."""
        with self._lock:
            self._advance()
            self.commands[index] = (torque_enabled, reference, current_limit, gain, braking)

    def read_servo(self, index: int) -> tuple[float, float, float, float, float]:
        """See ServoPlant."""
        with self._lock:
            self._advance()
            moved = self._angle[index], self._velocity[index], self._current[index]
            return *moved, self.voltage[index], self.temperature[index]

    def _advance(self) -> None:
        now = self._clock()
        self._at = max(self._at, now - _LONGEST)
        while self._at + _STEP <= now:
            self._at += _STEP
            for index in range(len(self._angle)):
                self._step(index)

    def _step(self, index: int) -> None:
        command = self.commands[index]
        if command is None or not command[0]:
            self._velocity[index] = self._current[index] = 0.0
            return
        _, reference, current_limit, gain, _ = command
        limit, stiffness = self._constant * current_limit, SERVO_STIFFNESS * gain
        # Implicit in the angle: stable at any stiffness. If the torque is clipped, it is known.
        change = (stiffness * (reference - self._angle[index]) + self.load[index]) / (SERVO_DAMPING / _STEP + stiffness)
        torque = stiffness * (reference - self._angle[index] - change)
        if abs(torque) > limit:
            torque = math.copysign(limit, torque)
            change = (torque + self.load[index]) * _STEP / SERVO_DAMPING
        self._angle[index] += change
        self._velocity[index] = change / _STEP
        self._current[index] = torque / self._constant


class BenchPlant:
    """A `BoardPlant` with settable forces and circuit.

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
        clock: s.
    """

    def __init__(self, offset: float = 0.12, noise: float = 0.02, clock: Callable[[], float] = time.monotonic) -> None:
        self.left, self.right = np.zeros((2, ROWS, COLUMNS))
        self.battery, self.resistance = 26.0, 2.0
        self.port = TargetPort(PortParameters())
        self.detected = int(BoardFault.NONE)
        self.welded = self.dropped = False
        self.measured: dict[str, Any] = {}
        self._offset, self._noise, self._random = offset, noise, np.random.default_rng(0)
        self._clock, self._updated = clock, clock()
        self._lock = threading.RLock()
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
            output = target if self._closed or self._updated >= self._precharged else 0.0
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
