# SPDX-License-Identifier: Apache-2.0
"""Three servos without a simulated world: minimal physics for the servo emulator.

It lets driver tests set the loads directly. Each servo is a spring and a damper with a torque limit against a settable
load. The servos do not affect each other; deltacharger_sim has the arm's geometry.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from deltacharger_core.machine import NOMINAL_VOLTAGE, SERVO_DAMPING, SERVO_STIFFNESS, TORQUE_CONSTANT

_STEP = 1e-3  # s
_LONGEST = 1.0  # s; a longer pause is not simulated completely


class BenchArm:
    """A `ServoPlant` of servos that follow d · ω = clip(gain · k (reference − angle), ± Kt · limit) + load.

    Thread-safe. Without torque a servo keeps its angle, held by its gear.

    Attributes:
        load: N·m on each servo, toward +angle.
        voltage: V of each servo's supply without load.
        supply_resistance: Ω of regulator and cable, common to all servos.
        temperature: °C of each servo.
        commands: last (torque enabled, reference rad, current limit A, P and D gain) of each servo; None before it.

    Args:
        angles: initial angles, rad.
        clock: s, monotonic.
    """

    def __init__(
        self, angles: tuple[float, ...] = (-0.7, -0.7, -0.7), clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.load = [0.0] * len(angles)
        self.voltage = [NOMINAL_VOLTAGE] * len(angles)
        self.supply_resistance = 0.0
        self.temperature = [30.0] * len(angles)
        self.commands: list[tuple[bool, float, float, float, float] | None] = [None] * len(angles)
        self._angle = list(angles)
        self._velocity = [0.0] * len(angles)
        self._current = [0.0] * len(angles)
        self._clock = clock
        self._at = clock()
        self._lock = threading.RLock()

    @property
    def angles(self) -> tuple[float, ...]:
        """Angle of each servo now, rad."""
        with self._lock:
            self._advance()
            return tuple(self._angle)

    def torque_enabled(self) -> list[bool]:
        """Return whether each servo has torque."""
        with self._lock:
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
        """Make servo `index` hold `reference` (rad) with at most `current_limit` (A); its damping never changes."""
        with self._lock:
            self._advance()
            self.commands[index] = (torque_enabled, reference, current_limit, gain, braking)

    def read_servo(self, index: int) -> tuple[float, float, float, float, float]:
        """Return angle (rad), velocity (rad/s), current (A), voltage (V) and temperature (°C) of servo `index`."""
        with self._lock:
            self._advance()
            return (
                self._angle[index],
                self._velocity[index],
                self._current[index],
                self.voltage[index] - self.supply_resistance * sum(map(abs, self._current)),
                self.temperature[index],
            )

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
        limit, stiffness = TORQUE_CONSTANT * current_limit, SERVO_STIFFNESS * gain
        # Implicit in the angle: stable at any stiffness. If the torque is clipped, it is known.
        change = (stiffness * (reference - self._angle[index]) + self.load[index]) / (SERVO_DAMPING / _STEP + stiffness)
        torque = stiffness * (reference - self._angle[index] - change)
        if abs(torque) > limit:
            torque = math.copysign(limit, torque)
            change = (torque + self.load[index]) * _STEP / SERVO_DAMPING
        self._angle[index] += change
        self._velocity[index] = change / _STEP
        self._current[index] = torque / TORQUE_CONSTANT
