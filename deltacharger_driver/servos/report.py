# SPDX-License-Identifier: Apache-2.0
"""State of the servos after a cycle: measurements (held for two cycles), heat of the windings, faults."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from typing import NamedTuple

from deltacharger_core.servo_types import ServoType
from deltacharger_driver.servos.bus import UNKNOWN, UNKNOWN_AFTER, BusSnapshot
from deltacharger_driver.servos.registers import describe_hardware_error

REST_TEMPERATURE = 25.0  # °C, where the heat is 0


def reserve(heat: float, current: float, servo: ServoType) -> float:
    """Return the time for which `current` may flow until the limit, s; 0 at the limit, inf if never reached.

    h(t) = i²τ + (h − i²τ) e^(−t/τ) = H, solved for t. An unknown current or heat (NaN) gives NaN.

    Args:
        heat: present heat above rest, A²s.
        current: present current, A, of either sign.
        servo: its type, which has τ and H.
    """
    if math.isnan(heat) or math.isnan(current):
        return math.nan
    limit, constant = servo.heat_limit, servo.heat_constant
    if heat >= limit:
        return 0.0
    final = current * current * constant
    if final <= limit:
        return math.inf
    return constant * math.log((final - heat) / (final - limit))


class ThermalModel:
    """The heat of one servo: an I²t model with cooling, in addition to its temperature.

    The heat h (A²s) above rest follows dh/dt = i² − h/τ; its limit H is reached where the servo's own temperature limit
    is. The MX-64's two constants rest on three statements:
    - Several amperes overheat the servo in minutes: at 3 A the limit must be reached in 60–180 s; 120 s is assumed.
    - The real charger held 0.5 A for four hours: at 0.5 A the limit must never be reached, so τ · 0.5² < H.
    - About 0.8 A can be held for about 40 min.

    With τ = 4000 s, H = 3² · τ · (1 − e^(−120/τ)) = 1064 A²s. Then √(H/τ) = 0.516 A is allowed for ever, just above
    what was demonstrated; 0.8 A lasts 36 min. Change this calibration only after measurements of a real winding.

    An unknown current counts as the last known one, so that missing data never cool the model.

    Args:
        servo: its type.
        smoothing: time constant of the current in `reserve`, s; 0 = none. The heat uses the unsmoothed current.
    """

    def __init__(self, servo: ServoType, smoothing: float = 0.5) -> None:
        self.heat = 0.0
        self._servo = servo
        self._smoothing = smoothing
        self._square = math.nan
        self._mean_square = math.nan

    def start_at(self, temperature: float) -> None:
        """Set the heat from the servo's temperature, °C, so that a restart does not lose it."""
        if math.isnan(temperature):
            return
        share = (temperature - REST_TEMPERATURE) / (self._servo.temperature_limit - REST_TEMPERATURE)
        self.heat = min(max(share, 0.0), 1.0) * self._servo.heat_limit

    def update(self, current: float, elapsed: float) -> None:
        """Apply `current` (A, NaN = unknown) for `elapsed` s.

        Exact for a current that is constant over the step.
        """
        if not math.isnan(current):
            self._square = current * current
        if math.isnan(self._square):
            return
        constant = self._servo.heat_constant
        final = self._square * constant
        self.heat = final + (self.heat - final) * math.exp(-elapsed / constant)
        if math.isnan(self._mean_square) or self._smoothing <= 0.0:
            self._mean_square = self._square
        else:
            self._mean_square += (self._square - self._mean_square) * -math.expm1(-elapsed / self._smoothing)

    def reserve(self) -> float:
        """Return the time for which the present current may flow until the limit, s; inf if never reached.

        NaN before the first current is known.
        """
        return reserve(self.heat, math.sqrt(self._mean_square), self._servo)


class ServoPhase(enum.Enum):
    """Phase of the servos."""

    DISCONNECTED = "disconnected"
    OFF = "torque off"
    ON = "torque on"
    STOPPING = "stopping"


class ServoReport(NamedTuple):
    """The servos after one cycle, in the order of the ids.

    Attributes:
        time: arrival of the last replies, s, monotonic.
        phase: of the servos.
        valid: whether this cycle got a good reply.
        angle, velocity, current, voltage, temperature: rad, rad/s, A, V, °C; kept through two missed cycles, then NaN.
        hardware_error: latched error bits; the last known.
        torque_enabled: the last known.
        thermal_reserve: s until the winding's limit at the present current; inf = never, NaN = unknown.
        stray: why each joint stopped the arm, as in ServoState; 0 = it did not.
        faults: that forbid moving, one sentence each.
    """

    time: float
    phase: ServoPhase
    valid: tuple[bool, ...]
    angle: tuple[float, ...]
    velocity: tuple[float, ...]
    current: tuple[float, ...]
    voltage: tuple[float, ...]
    temperature: tuple[float, ...]
    hardware_error: tuple[int, ...]
    torque_enabled: tuple[bool, ...]
    thermal_reserve: tuple[float, ...]
    stray: tuple[int, ...]
    faults: tuple[str, ...]


class ServoMemory:
    """The last known state of `count` servos of a type."""

    def __init__(self, count: int, servo: ServoType) -> None:
        self._time = math.nan
        self._thermal = [ThermalModel(servo) for _ in range(count)]
        self._rows: list[tuple[float, ...]] = [UNKNOWN] * count
        self._valid = (False,) * count
        self._errors = (0,) * count
        self._torque = (False,) * count

    @property
    def angles(self) -> tuple[float, ...]:
        """Last known angle of each servo, rad; NaN if too old."""
        return tuple(row[0] for row in self._rows)

    def learn(self, snapshot: BusSnapshot) -> None:
        """Store a cycle's snapshot; a servo keeps its last values through two missed cycles."""
        elapsed = 0.0 if math.isnan(self._time) else snapshot.time - self._time
        first = math.isnan(self._time)
        self._time = snapshot.time
        self._valid = snapshot.valid
        self._errors = snapshot.hardware_error
        self._torque = snapshot.torque_enabled
        columns = (snapshot.angle, snapshot.velocity, snapshot.current, snapshot.voltage, snapshot.temperature)
        for index, row in enumerate(zip(*columns, strict=True)):
            if snapshot.valid[index]:
                self._rows[index] = row
            elif snapshot.missed[index] >= UNKNOWN_AFTER or snapshot.rebooted[index]:
                self._rows[index] = UNKNOWN
            if first:
                self._thermal[index].start_at(row[4])
            self._thermal[index].update(row[2], elapsed)

    def forget(self) -> None:
        """Discard all measurements; errors, torque and heat keep their last values."""
        self._rows = [UNKNOWN] * len(self._rows)
        self._valid = (False,) * len(self._rows)

    def report(self, now: float, phase: ServoPhase, faults: list[str], strays: Sequence[int]) -> ServoReport:
        """Return the state at `now` (s, monotonic)."""
        angle, velocity, current, voltage, temperature = zip(*self._rows, strict=True)
        return ServoReport(
            time=self._time if any(self._valid) else now,
            phase=phase,
            valid=self._valid,
            angle=angle,
            velocity=velocity,
            current=current,
            voltage=voltage,
            temperature=temperature,
            hardware_error=self._errors,
            torque_enabled=self._torque,
            thermal_reserve=tuple(model.reserve() for model in self._thermal),
            stray=tuple(strays),
            faults=tuple(faults),
        )


def find_faults(ids: tuple[int, ...], snapshot: BusSnapshot) -> list[str]:
    """Return the faults that forbid moving the servos `ids`, one sentence each."""
    found = []
    for index, servo in enumerate(ids):
        if snapshot.rebooted[index]:
            found.append(f"servo {servo} has restarted on its own")
        elif snapshot.missing[index]:
            found.append(f"servo {servo} does not answer; check its supply and its cable")
        if snapshot.hardware_error[index]:
            error = describe_hardware_error(snapshot.hardware_error[index])
            found.append(f"servo {servo} has latched: {error}; remove the cause, then call reboot_servos")
    return found
