# SPDX-License-Identifier: Apache-2.0
"""Battery, power stage and contactor, between the board's orders and the target's port."""

from __future__ import annotations

import math

from deltacharger_core.charge_port import LIVE_VOLTAGE
from deltacharger_driver.emulators.power import Outputs, PortParameters, StageParameters, StageReading, TargetPort
from deltacharger_sim.bars import Bars
from deltacharger_sim.clearance import Overlap
from deltacharger_sim.parameters import CircuitParameters

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
        port: PortParameters | None = None,
        stage: StageParameters | None = None,
    ) -> None:
        self._parameters, self._stage = parameters, stage or StageParameters()
        self.port = TargetPort(port or PortParameters())
        self.wired = parameters.wired
        self._outputs = Outputs()
        self._precharged = self._pulled = math.inf  # s until output and contacts reach their state
        self._stuck = self.closed = False
        self._overlap: Overlap | None = None
        self._bars = Bars.flat(0.0)
        self._known_contacts: tuple[float, float] | None = None  # Ω of the upper and the lower bar, computed on demand
        self._shown = math.nan  # V at the charger's electrodes
        self.current = 0.0
        self.broken_current = 0.0

    def drive(self, outputs: Outputs) -> None:
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
        power = 0.0 if self._shorted or not self.closed else max(self.current * self._shown / _EFFICIENCY, 0.0)
        return parameters.battery_voltage - parameters.battery_resistance * power / parameters.battery_voltage

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
        loop = parameters.battery_resistance + self._resistance + port.resistance
        return (parameters.battery_voltage - self.port.voltage) / loop

    def read_power(self) -> StageReading:
        """Return what the board measures; NaN where nothing is connected, or without a power stage."""
        if self.wired:
            return StageReading(math.nan, math.nan, math.nan, math.nan, False)
        target = self._target()
        output = target if self.closed or self._precharged <= 0.0 else 0.0
        return StageReading(self._battery, target, 0.0 if math.isnan(output) else output, self.current, self.closed)

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
        return self._shorted and abs(self.port.undriven) >= LIVE_VOLTAGE

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
