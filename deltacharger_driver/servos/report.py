# SPDX-License-Identifier: Apache-2.0
"""State of the servos after a cycle: measurements (held for two cycles), heat of the windings, faults."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from typing import NamedTuple

from deltacharger_driver.servos.bus import UNKNOWN, UNKNOWN_AFTER
from deltacharger_driver.servos.mx64 import describe_hardware_error
from deltacharger_driver.servos.snapshot import BusSnapshot
from deltacharger_driver.servos.thermal import ThermalModel


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
    """The last known state of `count` servos."""

    def __init__(self, count: int) -> None:
        self._time = math.nan
        self._thermal = [ThermalModel() for _ in range(count)]
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
