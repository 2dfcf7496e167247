# SPDX-License-Identifier: Apache-2.0
"""The electrodes' exact contact, the circuit of battery, power stage and contactor, and kinds of charging ports."""

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any

from deltacharger_core import environment, machine, yaml_file
from deltacharger_sim.emulators import power
from deltacharger_sim.parameters import CircuitParameters
from deltacharger_sim.touch import Bars

Polygon = list[tuple[float, float]]


class Overlap:
    """Overlap of two terminals; attributes are computed when first used.

    Args:
        x: position of the target in end_effector, m.
        y: along y, m.
        angle: of the target, rad.
    """

    def __init__(self, x: float, y: float, angle: float) -> None:
        self._cosine, self._sine = math.cos(angle), math.sin(angle)
        # From one bar's centre to the wrong bar's; the target's bars are offset along its own turned y.
        pitch = 0.5 * (machine.BAR_GAP + machine.BAR_HEIGHT)
        across_x, across_y = self._sine * pitch, -pitch - self._cosine * pitch
        self._down, self._up = (x + across_x, y + across_y), (x - across_x, y - across_y)
        # From one bar's centre to its mate's: upper to upper, lower to lower.
        aside_x, aside_y = -self._sine * pitch, self._cosine * pitch - pitch
        self._mates = (x + aside_x, y + aside_y), (x - aside_x, y - aside_y)

    @cached_property
    def area(self) -> float:
        """Overlap of the matching pairs (upper on upper, lower on lower), m²."""
        return sum(self._common(mate) for mate in self._mates)

    @property
    def fraction(self) -> float:
        """The overlap relative to full overlap."""
        return self.area / (2.0 * machine.BAR_LENGTH * machine.BAR_HEIGHT)

    @cached_property
    def clearance(self) -> float:
        """Distance (m) of the nearest mismatched pair; negative = depth of overlap."""
        return min(self._separation(self._down), self._separation(self._up))

    @cached_property
    def short(self) -> bool:
        """Whether a bar of one terminal touches both bars of the other."""
        wrong = (self._down, self._up)
        return self.clearance < 0.0 < self.area and any(self._common(other) > 0.0 for other in wrong)

    def _common(self, place: tuple[float, float]) -> float:
        return _common(*place, self._cosine, self._sine)

    def _separation(self, place: tuple[float, float]) -> float:
        return _separation(*place, self._cosine, self._sine)


def _common(x: float, y: float, cosine: float, sine: float) -> float:
    """Return the common area (m²) of two bars, the second's centre at (x, y) m from the first's, turned.

    The second is clipped at the first's four sides (Sutherland–Hodgman).
    """
    if sine == 0.0 and cosine > 0.0:
        return max(machine.BAR_LENGTH - abs(x), 0.0) * max(machine.BAR_HEIGHT - abs(y), 0.0)
    half_x, half_y = 0.5 * machine.BAR_LENGTH, 0.5 * machine.BAR_HEIGHT
    along_x, along_y, across_x, across_y = half_x * cosine, half_x * sine, -half_y * sine, half_y * cosine
    polygon = [
        (x - along_x - across_x, y - along_y - across_y),
        (x + along_x - across_x, y + along_y - across_y),
        (x + along_x + across_x, y + along_y + across_y),
        (x - along_x + across_x, y - along_y + across_y),
    ]
    for axis, sign, most in ((0, 1.0, half_x), (0, -1.0, half_x), (1, 1.0, half_y), (1, -1.0, half_y)):
        inside = [most - sign * point[axis] for point in polygon]
        if min(inside) >= 0.0:
            continue
        if max(inside) <= 0.0:
            return 0.0
        polygon = _cut(polygon, inside)
    (before_x, before_y), total = polygon[-1], 0.0
    for corner_x, corner_y in polygon:
        total += before_x * corner_y - before_y * corner_x
        before_x, before_y = corner_x, corner_y
    return max(0.5 * total, 0.0)


def _cut(polygon: Polygon, inside: list[float]) -> Polygon:
    """Return the part of a convex polygon with non-negative distances (m) to the inside of a line."""
    kept = []
    (before_x, before_y), before = polygon[-1], inside[-1]
    for (corner_x, corner_y), here in zip(polygon, inside, strict=True):
        if (here >= 0.0) != (before >= 0.0):
            share = before / (before - here)
            kept.append((before_x + share * (corner_x - before_x), before_y + share * (corner_y - before_y)))
        if here >= 0.0:
            kept.append((corner_x, corner_y))
        before_x, before_y, before = corner_x, corner_y, here
    return kept


def _separation(x: float, y: float, cosine: float, sine: float) -> float:
    """Return the largest gap (m) along an edge normal of two bars, the second's centre at (x, y) m, turned; < 0
    overlap."""
    half_x, half_y = 0.5 * machine.BAR_LENGTH, 0.5 * machine.BAR_HEIGHT
    wide = half_x + half_x * abs(cosine) + half_y * abs(sine)
    high = half_y + half_x * abs(sine) + half_y * abs(cosine)
    along, across = cosine * x + sine * y, cosine * y - sine * x
    return max(abs(x) - wide, abs(y) - high, abs(along) - wide, abs(across) - high)


_NOMINAL_FORCE = 40.0  # N on one bar; magnets, and push at the middle of the band
_SHORT_CURRENT = 200.0  # A that a battery drives through shorted electrodes until the stage opens
_PULL_IN = 0.005  # s until the contactor's contacts follow its coil
_EFFICIENCY, _DROP = 0.93, 0.2  # of the stage; V that one which steps down loses at least
_FINEST = 0.01  # s, longest step of a port through which current may flow


class Circuit:
    """The electrical side, without the board that commands it.

    Args:
        parameters: of battery, contactor and contacts.
        port: the target.
        stage: the power stage.

    Attributes:
        port: the target.
        current: into the target, A.
        closed: whether the contactor's contacts are closed.
        broken_current: largest current interrupted by the contactor, or by the electrodes if there is none, A.
        wired: whether the electrodes are wired to the battery: no power stage opens, limits or measures.
    """

    def __init__(
        self,
        parameters: CircuitParameters,
        port: power.PortParameters | None = None,
        stage: power.StageParameters | None = None,
    ) -> None:
        self._parameters, self._stage = parameters, stage or power.StageParameters()
        self.port = power.TargetPort(port or power.PortParameters())
        self.wired = parameters.wired
        self._outputs = power.Outputs()
        self._precharged = self._pulled = math.inf  # s until output and contacts reach their state
        self._stuck = self.closed = False
        self._overlap: Overlap | None = None
        self._bars = Bars.flat(0.0)
        self._known_contacts: tuple[float, float] | None = None  # Ω of the upper and the lower bar, computed on demand
        self._shown = math.nan  # V at the charger's electrodes
        self.current = 0.0
        self.broken_current = 0.0

    def drive(self, outputs: power.Outputs) -> None:
        """Take the board's orders."""
        before, self._outputs = self._outputs, outputs
        if outputs.precharge != before.precharge:
            self._precharged = self._parameters.precharge_time if outputs.precharge else math.inf
        if outputs.contactor and not before.contactor:
            self._pulled = _PULL_IN
        elif before.contactor and not outputs.contactor:
            self._pulled = math.inf
            if self._stuck:
                self._outputs = before  # it cannot interrupt what flows
            elif self.closed:
                self._break()

    def _break(self) -> None:
        self.closed = False
        self.broken_current = max(self.broken_current, abs(self.current))
        self.current = 0.0

    def step(self, dt: float, overlap: Overlap | None, bars: Bars) -> None:
        """Advance by `dt` s; the terminals overlap as `overlap` (None = apart) and press as `bars`."""
        if bars is not self._bars or overlap is not self._overlap:
            self._overlap, self._bars, self._known_contacts = overlap, bars, None
        self._precharged -= dt
        self._pulled -= dt
        if self._outputs.contactor and self._pulled <= 0.0 and not self.wired:
            self.closed = True
            self._stuck = self._stuck or self._parameters.welded
        if self.wired:
            self._step_wired(dt)
        elif not self.closed or self._shorted or math.isinf(self._resistance):
            self.port.step(dt)
            self.current = _SHORT_CURRENT if self.closed and self._shorted else 0.0
        else:
            left, flowed = dt, 0.0
            while left > 1e-9:
                now = min(left, _FINEST)
                left -= now
                flow, self._shown = self.port.step(now, self._output, self._outputs.current, self._resistance)
                flowed += flow * now
            self.current = flowed / dt

    @property
    def _output(self) -> float:
        """V at which the stage stops to drive current."""
        voltage = self._stage.stage_voltage or self._outputs.voltage
        return voltage if self._stage.steps_up else min(voltage, self._battery - _DROP)

    @property
    def _battery(self) -> float:
        """V of the charger's battery under its load."""
        parameters = self._parameters
        if self.wired:
            return parameters.battery_voltage - parameters.battery_resistance * self.current
        drawn = 0.0 if self._shorted or not self.closed else max(self.current * self._shown / _EFFICIENCY, 0.0)
        return parameters.battery_voltage - parameters.battery_resistance * drawn / parameters.battery_voltage

    def _step_wired(self, dt: float) -> None:
        """Let the batteries drive the current, in either direction; parting electrodes interrupt it."""
        before, self.current = self.current, self._driven()
        port = self.port.parameters
        if port.capacity and not self._shorted:
            self.port.voltage += self.current * dt / port.capacity
        if math.isinf(self._resistance):
            self.broken_current = max(self.broken_current, abs(before))

    def _driven(self) -> float:
        parameters, port = self._parameters, self.port.parameters
        if self._shorted:
            return parameters.battery_voltage / parameters.battery_resistance
        if math.isinf(self._resistance) or not port.accepts:
            return 0.0
        loop = parameters.battery_resistance + self._resistance + power.BATTERY_RESISTANCE
        return (parameters.battery_voltage - self.port.voltage) / loop

    def read_power(self) -> power.StageReading:
        """Return what the board measures; NaN where nothing is connected, or without a power stage."""
        if self.wired:
            return power.StageReading(math.nan, math.nan, math.nan, math.nan, False)
        target = self._target()
        output = target if self.closed or self._precharged <= 0.0 else 0.0
        return power.StageReading(
            self._battery, target, 0.0 if math.isnan(output) else output, self.current, self.closed
        )

    def _target(self) -> float:
        if math.isinf(self._resistance):
            return self._parameters.battery_voltage if self.closed else math.nan
        if self._shorted:
            return 0.0
        return self._shown if self.closed else self.port.undriven

    def probe(self) -> tuple[float, float]:
        """Return Ω (inf = no current flows, NaN = a live port) and V that the probe measures; NaN without a probe."""
        if self.wired:
            return math.nan, math.nan
        if math.isinf(self._resistance):
            return math.inf, 0.0
        if self._shorted:
            return min(2.0 * self._resistance, 0.9), 0.0
        return self.port.probe(self._resistance)

    @property
    def power(self) -> float:
        """W into the target at the electrodes."""
        return self.current * self._shown if self.closed and not self._shorted else 0.0

    @property
    def port_shorted(self) -> bool:
        """Whether a bar bridges a live port, which shorts the target's battery whatever the contactor does."""
        return self._shorted and abs(self.port.undriven) >= machine.LIVE_VOLTAGE

    @property
    def _shorted(self) -> bool:
        return self._overlap is not None and self._overlap.short

    @property
    def heat(self) -> float:
        """Return the heat (W) in the hotter bar's contact; the heat of a short, which is elsewhere, is not modelled."""
        if self.current == 0.0 or self._shorted or math.isinf(self._resistance):
            return 0.0
        return self.current * self.current * (max(self._contacts) + self.port.film)

    @property
    def _resistance(self) -> float:
        """Of both contacts in series, Ω."""
        upper, lower = self._contacts
        return upper + lower

    @property
    def _contacts(self) -> tuple[float, float]:
        """Of each bar, Ω: falls with the pressed area and with the square root of force, as contact spots grow; inf if
        it does not press."""
        if self._known_contacts is None:
            bars = self._bars
            self._known_contacts = (
                self._contact(bars.upper, bars.upper_pressed),
                self._contact(bars.lower, bars.lower_pressed),
            )
        return self._known_contacts

    def _contact(self, force: float, pressed: float) -> float:
        lies = self._overlap
        if lies is None or not force > 0.0 or not pressed > 0.0 or not lies.area > 0.0:
            return math.inf
        spots = max(lies.fraction * pressed, 1e-3) * math.sqrt(force / _NOMINAL_FORCE)
        return 0.5 * (self._parameters.contact_resistance / spots)


TARGET_KINDS: Mapping[str, Mapping[str, Any]] = yaml_file.read_yaml(environment.config("target_kinds.yaml")[0])
"""Kinds of charging ports, by name."""


def usual_port(number: int) -> dict[str, float]:
    """Return the values of `PortParameters` of the kind with this number, from 1; a range gives its middle."""
    values = list(TARGET_KINDS.values())[number - 1].get("port", {})
    return {name: sum(value) / 2.0 if isinstance(value, list) else value for name, value in values.items()}
