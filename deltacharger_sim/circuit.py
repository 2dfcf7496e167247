# SPDX-License-Identifier: Apache-2.0
"""Battery, power stage, contactor and the target's battery."""

from __future__ import annotations

import math
from enum import Enum

from deltacharger_sim.bars import Bars
from deltacharger_sim.clearance import Overlap
from deltacharger_sim.parameters import CircuitParameters

NO_CHARGE_CURRENT, SHORT, REVERSE_POLARITY, VOLTAGE, REVERSE_CURRENT, WELDED, OVER_CURRENT = 1, 2, 4, 5, 6, 7, 9
_NOMINAL_FORCE = 40.0  # N on one bar; magnets, and push at the middle of the band
_SHORT_CURRENT = 200.0  # A that a battery drives through shorted electrodes until the stage opens
_DETECTION = 0.002  # s until the stage has measured a short and opened
_OVER_CURRENT = 20.0  # A
_OPEN_CURRENT = 1.0  # A, at which a ramped opening opens the contactor
_IDLE_TIME = 3.0  # s closed without any current until the stage reports it
_LOST_TIME = 0.05  # s without current until it reports that charging has stopped
_IDLE_CURRENT = 0.05  # A


class StagePhase(Enum):
    """Phase of the power stage."""

    OPEN = 0
    PRECHARGE = 1
    CLOSED = 2
    RAMP_DOWN = 3


# Looking up an enumeration's members is slow, and a step needs several.
_OPEN, _PRECHARGE, _CLOSED, _RAMP_DOWN = StagePhase.OPEN, StagePhase.PRECHARGE, StagePhase.CLOSED, StagePhase.RAMP_DOWN


class Circuit:
    """The electrical side. Detected faults stay until the next command to close or open, a weld for ever.

    Attributes:
        current: into the target, A.
        fault: code detected by the stage, 0 = none.
        broken_current: largest current interrupted by the contactor, or by the electrodes if there is none, A.
        wired: whether the electrodes are wired to the battery: no power stage opens, limits or measures.
    """

    def __init__(self, parameters: CircuitParameters) -> None:
        self._parameters = parameters
        self.wired = parameters.wired
        self._phase = _OPEN
        self._since = 0.0
        self._limit = 0.0
        self._stuck = False
        self._shorted_for = 0.0
        self._idle_for = 0.0
        self._flowed = False
        self._overlap: Overlap | None = None
        self._bars = Bars.flat(0.0)
        self._known_contacts: tuple[float, float] | None = None  # Ω of the upper and the lower bar, computed on demand
        self._voltage = parameters.target_voltage  # of the target's battery without load
        self.current = 0.0
        self.fault = 0
        self.broken_current = 0.0

    @property
    def closed(self) -> bool:
        """Whether the contactor is closed."""
        return self._stuck or self._phase is _CLOSED or self._phase is _RAMP_DOWN

    def close(self) -> None:
        """Begin pre-charge, then close and ramp up."""
        if self._phase is _OPEN and not self.wired and self.fault != WELDED:
            self.fault = 0
            self._enter(_PRECHARGE)

    def open(self, ramp: bool) -> None:
        """Open, after ramping down the current or at once."""
        if self.fault != WELDED:
            self.fault = 0
        if self._phase is _CLOSED and ramp:
            self._enter(_RAMP_DOWN)
        elif not ramp or self._phase is _PRECHARGE:
            self._break()

    def step(self, dt: float, overlap: Overlap | None, bars: Bars) -> None:
        """Advance by `dt` s; the terminals overlap as `overlap` (None = apart) and press as `bars`."""
        self._since += dt
        if bars is not self._bars or overlap is not self._overlap:
            self._overlap, self._bars, self._known_contacts = overlap, bars, None
        if self.wired:
            self._step_wired(dt)
            return
        if self._phase is _OPEN and not self._stuck:
            self.current = self._shorted_for = 0.0
            return
        # A short that existed when this step began has now lasted one step.
        self._shorted_for = self._shorted_for + dt if self.current >= _SHORT_CURRENT and self._shorted else 0.0
        if self._phase is _PRECHARGE and self._since >= self._parameters.precharge_time:
            self._leave_precharge()
        if not self.closed:
            self.current = 0.0
            return
        if self._phase is _CLOSED:
            self._limit = min(self._limit + self._parameters.ramp_up * dt, self._parameters.current_limit)
        elif self._phase is _RAMP_DOWN and not self._stuck:
            self._limit = max(self._limit - self._parameters.ramp_down * dt, 0.0)
        self.current = self._flow()
        if self._parameters.target_capacity and not self._shorted:
            self._voltage += self.current * dt / self._parameters.target_capacity
        idle = self.current < _IDLE_CURRENT
        self._idle_for = self._idle_for + dt if idle else 0.0
        self._flowed = self._flowed or not idle
        if self._phase is _RAMP_DOWN and (self._stuck or self.current < _OPEN_CURRENT):
            self._break()
        elif self._phase is not _OPEN:
            self._detect()

    def _step_wired(self, dt: float) -> None:
        """Let the batteries drive the current, in either direction; parting electrodes interrupt it."""
        before, self.current = self.current, self._driven()
        if self._parameters.target_capacity and not self._shorted:
            self._voltage += self.current * dt / self._parameters.target_capacity
        if math.isinf(self._resistance):
            self.broken_current = max(self.broken_current, abs(before))

    def _driven(self) -> float:
        parameters = self._parameters
        if self._shorted:
            return parameters.battery_voltage / parameters.battery_resistance
        if math.isinf(self._resistance) or not parameters.target_accepts:
            return 0.0
        loop = parameters.battery_resistance + self._resistance + parameters.target_resistance
        return (parameters.battery_voltage - self._voltage) / loop

    def measured(self) -> tuple[float, float, float, bool, int]:
        """Return battery and target voltage (V), current (A), contactor closed, and fault, as the board reports them.

        NaN if not measured.
        """
        if self.wired:
            return math.nan, math.nan, math.nan, False, 0
        battery, target = self.voltages()
        return battery, target, self.current, self.closed, self.fault

    def voltages(self) -> tuple[float, float]:
        """Return battery and target voltage (V), the latter at the electrodes; NaN where nothing is connected."""
        parameters = self._parameters
        battery = parameters.battery_voltage - parameters.battery_resistance * self.current
        if math.isinf(self._resistance):
            return battery, battery if self.closed else math.nan
        if self._shorted:
            return battery, 0.0
        return battery, self._voltage + self.current * parameters.target_resistance

    def probe(self) -> tuple[float, float]:
        """Return resistance (Ω; inf = open) and target voltage (V) at low voltage; NaN without a probe."""
        if self.wired:
            return math.nan, math.nan
        if math.isinf(self._resistance):
            return math.inf, math.nan
        if self._shorted:
            return min(2.0 * self._resistance, 0.9), 0.0
        return self._parameters.target_leakage + self._resistance, self._voltage

    def _enter(self, phase: StagePhase) -> None:
        self._phase = phase
        self._since = 0.0
        if phase is _CLOSED:
            self._limit = self._idle_for = 0.0
            self._flowed = False
            self._stuck = self._parameters.welded

    @property
    def _shorted(self) -> bool:
        return self._overlap is not None and self._overlap.short

    @property
    def heat(self) -> float:
        """Return the heat (W) in the hotter bar's contact; the heat of a short, which is elsewhere, is not modelled."""
        if self.current == 0.0 or self._shorted or math.isinf(self._resistance):
            return 0.0
        return self.current * self.current * max(self._contacts)

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

    def _leave_precharge(self) -> None:
        voltage = self._voltage
        if self._shorted:
            self._trip(SHORT)
        elif math.isinf(self._resistance):
            self._trip(NO_CHARGE_CURRENT)
        elif voltage < 0.0:
            self._trip(REVERSE_POLARITY)
        elif not self._parameters.voltage_min <= voltage <= self._parameters.voltage_max:
            self._trip(VOLTAGE)
        else:
            self._enter(_CLOSED)

    def _flow(self) -> float:
        parameters = self._parameters
        if self._shorted:
            return _SHORT_CURRENT
        if math.isinf(self._resistance) or not parameters.target_accepts:
            return 0.0
        driven = (parameters.voltage_limit - self._voltage) / (parameters.target_resistance + self._resistance)
        return min(driven, self._limit)

    def _detect(self) -> None:
        if self._shorted and self._shorted_for >= _DETECTION:
            self._trip(SHORT)
        elif self.current > _OVER_CURRENT and not self._shorted:
            self._trip(OVER_CURRENT)
        elif self.current < -0.5:
            self._trip(REVERSE_CURRENT)
        elif self._idle_for > (_LOST_TIME if self._flowed else _IDLE_TIME):
            self._trip(NO_CHARGE_CURRENT)

    def _trip(self, fault: int) -> None:
        self.fault = fault
        self._break()

    def _break(self) -> None:
        """Command the contactor to open; a welded one stays closed, which is detected before any other fault."""
        self._enter(_OPEN)
        if self._stuck:
            self.fault = WELDED
            return
        self.broken_current = max(self.broken_current, abs(self.current))
        self.current = 0.0
