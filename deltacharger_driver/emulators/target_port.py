# SPDX-License-Identifier: Apache-2.0
"""The target at the other end of the electrodes: its battery, and what lies between that and its port.

One model for the emulated board, virtual time and the firmware's bench. Real ports behave like this; docs/targets.md
and the rows of deltacharger_sim.target_rows have the sources.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from deltacharger_core.charge_port import LIVE_VOLTAGE
from deltacharger_core.parameters import Bounded, flag, number

_PROBE_VOLTAGE, _PROBE_RESISTANCE, _PROBE_TIME = 5.0, 100.0, 0.15  # V through Ω, s until it is judged
_PROBE_OPEN = 1e-4  # A; below it the circuit is open
_NEAR_FULL = 0.3  # V below its end in which a regulated input reduces its power
_SWING = 2.0 * math.pi * 7.0  # rad/s
_FALLS_ASLEEP = 0.6  # of its wake_voltage
_SECOND = 29.4  # V at which a second charger ends
_FLOWS = 0.02  # A
_FILM_MOST = 20.0  # Ω
_DERATES_FROM = 10.0  # A
_RELAXES = 0.02  # V, of a battery that its BMS has disconnected


@dataclass(frozen=True)
class PortParameters(Bounded):
    """The target's battery and port; by default a battery of 24 V whose voltage lies at the port."""

    voltage: float = number(24.0, -60.0, 60.0, "V", "voltage of the battery without load; negative = swapped")
    capacity: float = number(0.0, 0.0, 1e9, "C/V", "charge that raises that voltage by 1 V; 0 = it stays constant")
    resistance: float = number(0.15, 0.001, 100.0, "Ω", "inner resistance of the battery")
    accepts: bool = flag(True, "false = the target takes no current")
    diode: float = number(0.0, 0.0, 2.0, "V", "forward voltage of a diode that hides the battery; 0 = none")
    bleeder: float = number(0.0, 0.0, 1e6, "Ω", "resistor across the port, such as a detector's divider; 0 = none")
    capacitor: float = number(0.0, 0.0, 0.1, "F", "capacitor at the port; 0 = none")
    wake_voltage: float = number(0.0, 0.0, 60.0, "V", "voltage at which it connects its battery; 0 = always")
    wake_time: float = number(0.0, 0.0, 120.0, "s", "delay from there until the battery is connected")
    gap_time: float = number(0.0, 0.0, 60.0, "s", "duration of each gap in the current; 0 = none")
    gap_period: float = number(1.0, 0.001, 3600.0, "s", "time with current between two gaps")
    gaps: int = number(0, 0, 1000, "", "number of gaps after the battery was connected; 0 = without end")
    trickle: float = number(0.0, 0.0, 18.0, "A", "current into a deeply discharged battery; 0 = as any other")
    trickle_voltage: float = number(0.0, 0.0, 60.0, "V", "voltage from which it takes full current")
    derating_time: float = number(0.0, 0.0, 1e5, "s", "time constant of a cold battery that takes less; 0 = never")
    derated: float = number(0.3, 0.0, 18.0, "A", "current that it takes at last")
    cut_voltage: float = number(0.0, 0.0, 60.0, "V", "battery voltage at which its BMS disconnects it; 0 = never")
    cut_time: float = number(0.0, 0.0, 3600.0, "s", "time until it connects the battery again; 0 = never")
    load: float = number(0.0, 0.0, 500.0, "W", "power that the target uses while it is charged")
    load_period: float = number(0.0, 0.0, 3600.0, "s", "the load is on and off for this time each; 0 = always on")
    source: float = number(0.0, 0.0, 18.0, "A", "current of a second charger, which keeps 29.4 V")
    regeneration: float = number(0.0, 0.0, 18.0, "A", "current out of the target in each burst of braking; 0 = none")
    burst_time: float = number(0.002, 0.001, 1.0, "s", "duration of a burst")
    burst_period: float = number(5.0, 0.1, 3600.0, "s", "time between two bursts")
    power: float = number(0.0, 0.0, 500.0, "W", "power that a regulated input behind a capacitor takes; 0 = none")
    swing: float = number(0.0, 0.0, 1.0, "", "share by which that power oscillates at 7 Hz")
    off_after: float = number(0.0, 0.0, 1e5, "s", "time of charging after which it is switched off; 0 = never")
    film: float = number(0.0, 0.0, 20.0, "Ω", "resistance of dirt on the electrodes")
    film_rate: float = number(0.0, 0.0, 1.0, "Ω/s", "growth of that resistance while current flows, up to 20 Ω")


class TargetPort:
    """State of one target.

    Args:
        parameters: of the target.

    Attributes:
        voltage: of its battery without load, V.
        film: resistance of dirt, Ω.
        steady: whether nothing about it changes by itself.
    """

    def __init__(self, parameters: PortParameters) -> None:
        self.parameters = parameters
        plain = PortParameters(voltage=parameters.voltage, resistance=parameters.resistance, diode=parameters.diode)
        self.steady = parameters == plain
        self.voltage = parameters.voltage
        self.film = parameters.film
        self._time = 0.0
        self._stored = 0.0  # V of the capacitor
        self._woken = math.inf if parameters.wake_voltage else 0.0  # s, when the battery was or will be connected
        self._first = math.inf  # s, when current first flowed
        self._cut = -math.inf  # s, when the BMS last disconnected

    @property
    def undriven(self) -> float:
        """V at the port that nothing drives."""
        p = self.parameters
        hidden = p.diode or p.power or self._time < self._woken or self._is_off
        return self._stored if hidden or self._stored >= LIVE_VOLTAGE else self.voltage

    def probe(self, contact: float) -> tuple[float, float]:
        """Return Ω and V that a probe measures through contacts of `contact` Ω: not driven, then driven."""
        p, seen = self.parameters, self.undriven
        if abs(seen) >= LIVE_VOLTAGE:
            return math.nan, seen
        contact += self.film
        series, bleeder = _PROBE_RESISTANCE + contact, p.bleeder or math.inf
        share = 1.0 / (1.0 + series / bleeder)
        end = share * _PROBE_VOLTAGE
        if p.capacitor:
            end *= -math.expm1(-_PROBE_TIME / (share * series * p.capacitor))
            self._stored = end
        current = (_PROBE_VOLTAGE - end) / series
        return (math.inf, 0.0) if current < _PROBE_OPEN else (end / current + contact, end)

    def step(
        self, dt: float, voltage: float = 0.0, limit: float = 0.0, contact: float = math.inf
    ) -> tuple[float, float]:
        """Advance by `dt` s at a stage of `voltage` V and at most `limit` A; the contacts have `contact` Ω.

        Returns:
            A into the target, and V at the charger's electrodes.
        """
        p = self.parameters
        self._time += dt
        if math.isinf(contact):
            current, shown, into = 0.0, voltage, 0.0
            self._stored *= math.exp(-dt / (p.bleeder or 1e5) / p.capacitor) if p.capacitor else 1.0
        elif p.capacitor:
            current, shown, into = self._filled(dt, voltage, limit)
        else:
            current, shown = self._flow(voltage, limit, contact + self.film)
            into = current
        if current >= _FLOWS:
            self._first = min(self._first, self._time)
            self.film = min(self.film + p.film_rate * dt, _FILM_MOST)
        if self._woken == math.inf and shown >= p.wake_voltage and not math.isinf(contact):
            self._woken = self._time + p.wake_time
        self._charge(dt, into)
        return current, shown

    @property
    def _source(self) -> float:
        """A from a second charger now."""
        p = self.parameters
        return min(p.source, max(_SECOND - self.voltage, 0.0) / p.resistance)

    @property
    def _is_off(self) -> bool:
        return bool(self.parameters.off_after) and self._time - self._first >= self.parameters.off_after

    @property
    def _takes(self) -> bool:
        """Whether the battery takes current now."""
        p, cut = self.parameters, self._time - self._cut
        gone = not p.accepts or self._time < self._woken or self._is_off
        return not (gone or cut < (p.cut_time or math.inf) or self._in_gap())

    def _in_gap(self) -> bool:
        p, since = self.parameters, self._time - self._first
        if not p.gap_time or not since >= 0.0:
            return False
        number, phase = divmod(since, p.gap_period + p.gap_time)
        return phase >= p.gap_period and (not p.gaps or number < p.gaps)

    def _regulated(self, voltage: float) -> float:
        """Return the A that a regulated input takes from `voltage`: its power, less near the end of its battery."""
        p = self.parameters
        if not self._takes or not voltage > 0.0:
            return 0.0
        share = min(max((p.cut_voltage - self.voltage) / _NEAR_FULL, 0.0), 1.0) if p.cut_voltage else 1.0
        swing = 1.0 - p.swing * (0.5 - 0.5 * math.cos(_SWING * self._time))
        return p.power * share * swing / voltage

    def _filled(self, dt: float, voltage: float, limit: float) -> tuple[float, float, float]:
        """Return A into the port, V there, and A behind the capacitor."""
        p, before = self.parameters, self._stored
        out = self._regulated(before) if p.power else 0.0
        current = min(max(out + (voltage - before) * p.capacitor / dt, 0.0), limit)
        after, least = before + (current - out) * dt / p.capacitor, _FALLS_ASLEEP * p.wake_voltage
        if out and after < least:  # its input falls asleep within this step
            after, self._woken = min(least, before), math.inf
            out = current + (before - after) * p.capacitor / dt
        self._stored = max(after, 0.0)
        return current, self._stored, out

    def _flow(self, voltage: float, limit: float, contact: float) -> tuple[float, float]:
        """Return A into the port and V at the electrodes."""
        p = self.parameters
        if not self._takes:
            return (voltage / p.bleeder if p.bleeder else 0.0), voltage
        since = self._time - self._first
        if p.regeneration and since >= 0.0 and since % p.burst_period >= p.burst_period - p.burst_time:
            return -p.regeneration, voltage + p.regeneration * contact
        path, behind = contact + p.resistance, self.voltage + p.diode + self._source * p.resistance
        most = p.trickle if p.trickle and self.voltage < p.trickle_voltage else limit
        if p.derating_time and since >= 0.0:
            most = min(most, p.derated + _DERATES_FROM * math.exp(-since / p.derating_time))
        current = min((voltage - behind) / path, most, limit)
        if p.diode:
            current = max(current, 0.0)
        return current, behind + current * path if current == limit else voltage

    def _charge(self, dt: float, into: float) -> None:
        """Move the battery's voltage by the charge of `dt` s."""
        p = self.parameters
        if not p.capacity:
            return
        idle = bool(p.load_period) and (self._time // p.load_period) % 2 == 1
        load = 0.0 if idle else p.load / max(self.voltage, 1.0)
        self.voltage += (into + self._source - load) * dt / p.capacity
        if p.cut_voltage and not p.power and self._takes and self.voltage >= p.cut_voltage:
            self._cut = self._time
            self.voltage -= _RELAXES
