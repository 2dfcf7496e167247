# SPDX-License-Identifier: Apache-2.0
"""The power stage's sequence and what the board watches in its readings, as in the firmware (dc_stage.c).

Pre-charge, contactor, ramp up within the limits of the closing; ramp down, open, confirm. docs/board-link.md has the
source of each number.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from deltacharger_core.charge_port import LIVE_VOLTAGE, ChargeLimits
from deltacharger_core.machine import BATTERY_MAX, BATTERY_MIN, ZERO_CURRENT
from deltacharger_core.parameters import Bounded, flag, number
from deltacharger_driver.board.protocol import BoardFault

_PRECHARGE_TIMEOUT, _PRECHARGE_MATCH = 0.5, 1.0  # s; V between both sides of the contactor when it closes
_PULL_IN_TIMEOUT = 0.1  # s until the feedback shows closed
_RAMP_UP, _RAMP_DOWN, _RAMP_TIME = 40.0, 500.0, 0.05  # A/s, A/s, s that a commanded opening may take
_OPEN_CURRENT = 1.0  # A; below it a ramped opening opens the contactor
_ZERO_TIME = 0.05  # s from the opening until feedback and current must confirm it
_LARGEST_CURRENT = 20.0  # A
_REVERSE_LIMIT, _REVERSE_AT_ONCE, _REVERSE_TIME = -0.5, -5.0, 0.1  # A, A, s
_SHORT_VOLTAGE = 2.0  # V; no target has less while current flows
IDLE_CURRENT = 0.05  # A; below it no current flows
_IDLE_TIME, _IDLE_LIMIT = 0.05, 1.0  # s without current, after which the limit is this, A
_BLIND_TIMEOUT = 0.1  # s with a reading unknown or out of range
_SAG_TIMEOUT = 5.0  # s with a low battery, which sags under load
_BOUNCE_TIME, _BOUNCE_PERIOD = 0.02, 0.1  # s with open feedback from its first opening; between two first openings
_OVER = 0.3  # V above the limit that are tolerated for _BLIND_TIMEOUT
_START_LIMIT, _STARTED = 0.5, 0.2  # A into a dead port until current and voltage have held for this time, s
_HEADROOM, _EFFICIENCY = 0.5, 0.9  # V that a stage needs to step down; share of the input that arrives
HIGHEST_STAGE = 0.1  # V of a constant voltage above the limit


class StageReading(NamedTuple):
    """The power stage's readings; NaN = not measured."""

    battery: float
    target: float
    output: float
    current: float
    closed: bool
    fault: int = 0


class Outputs(NamedTuple):
    """Orders to the power stage: pre-charge, the contactor's coil, A and V at most."""

    precharge: bool = False
    contactor: bool = False
    current: float = 0.0
    voltage: float = 0.0


@dataclass(frozen=True)
class StageParameters(Bounded):
    """The converter between the charger's battery and the contactor, as the board declares it."""

    steps_up: bool = flag(True, "it charges above its battery's voltage; false = it only steps down")
    stage_voltage: float = number(0.0, 0.0, 60.0, "V", "its constant voltage; 0 = the board sets it")
    input_fuse: float = number(20.0, 1.0, 60.0, "A", "fuse between the charger's battery and the stage")
    current_limit: float = number(18.0, 0.5, 18.0, "A", "largest current of the stage (electrodes: 18 A)")
    lowest_target: float = number(10.0, 0.0, 60.0, "V", "lowest voltage of a target that the stage feeds")
    highest_target: float = number(30.0, 1.0, 60.0, "V", "highest voltage")

    def keeps(self, voltage: float) -> bool:
        """Return whether its output can be kept at or below this voltage (V)."""
        return not self.stage_voltage > voltage + HIGHEST_STAGE


class StageState(Enum):
    """Phase of the power stage."""

    OPEN = 0
    PRECHARGE = 1
    CLOSING = 2
    CLOSED = 3
    RAMPING_DOWN = 4


class PowerStage:
    """Judges one reading after the other and orders the outputs.

    Args:
        drive: takes the outputs at every change.
        parameters: of the stage.

    Attributes:
        state: its phase.
        dropped_out: whether the contactor opened on its own: a pulled plug, a fuse.
    """

    def __init__(self, drive: Callable[[Outputs], None], parameters: StageParameters) -> None:
        self._drive, self._given = drive, parameters
        self._outputs = Outputs()
        self._since = self._stepped = 0.0  # s, when the phase began; the last step
        self.reset(0.0)

    def reset(self, now: float) -> None:
        """Switch everything off."""
        self.dropped_out = False
        self._limits = ChargeLimits(0.0, 0.0)
        self._last: dict[str, float] = {}  # s, when each reading was last good
        self._enter(StageState.OPEN, now)
        self._order(Outputs())

    def close(self, limits: ChargeLimits, now: float) -> None:
        """Begin to close within these limits."""
        self.dropped_out, self._limits = False, limits
        self._started = not limits.dead
        self._last["forward"] = now
        self._enter(StageState.PRECHARGE, now)
        self._order(Outputs(precharge=True, voltage=limits.voltage))

    def limit(self, current: float) -> None:
        """Change the largest current (A)."""
        self._limits = self._limits._replace(current=current)

    def open(self, ramp: bool, now: float) -> None:
        """Open, after ramping down below 1 A or at once."""
        if ramp and self.state is StageState.CLOSED:
            self._enter(StageState.RAMPING_DOWN, now)
        elif not (ramp and self.state is StageState.RAMPING_DOWN):
            self._switch_off(now)

    def step(self, reading: StageReading, now: float) -> int:
        """Return the fault that a reading shows, 0 = none; the caller opens on one. Comparisons with NaN are false."""
        state = self.state
        if state is StageState.OPEN:
            live = reading.closed or abs(reading.current) >= ZERO_CURRENT
            return BoardFault.CONTACTOR_WELDED if live and now - self._since >= _ZERO_TIME else BoardFault.NONE
        fault = self._at_once(reading, now)
        if not fault and state is StageState.PRECHARGE:
            fault = self._precharge(reading, now)
        elif not fault and state is StageState.CLOSING:
            fault = self._pull_in(reading, now)
        elif not fault and not reading.closed and self._has_opened(now):
            self.dropped_out = state is StageState.CLOSED
            self._switch_off(now)
        elif not fault:
            fault = self._watch(reading, now)
            if not fault and state is StageState.CLOSED:
                fault = self._charge(reading, now)
            elif not fault:
                self._ramp_down(reading, now)
        self._stepped = now
        return fault

    def _order(self, outputs: Outputs) -> None:
        self._outputs = outputs
        self._drive(outputs)

    def _enter(self, state: StageState, now: float) -> None:
        self.state = state
        self._since = self._stepped = now

    def _switch_off(self, now: float) -> None:
        self._order(Outputs())
        if self.state is not StageState.OPEN:
            self._enter(StageState.OPEN, now)

    def _at_once(self, reading: StageReading, now: float) -> int:
        """Return the fault of a reading that no time excuses, or of a current that flows back for too long."""
        back = self._lapsed("forward", reading.current >= _REVERSE_LIMIT, _REVERSE_TIME, now)
        if reading.target <= -LIVE_VOLTAGE:
            return BoardFault.REVERSE_POLARITY
        if reading.current > _OPEN_CURRENT and reading.target < _SHORT_VOLTAGE:
            return BoardFault.SHORT_CIRCUIT
        if reading.current > _LARGEST_CURRENT:
            return BoardFault.OVER_CURRENT
        worst = _REVERSE_LIMIT if back else _REVERSE_AT_ONCE
        return BoardFault.REVERSE_CURRENT if reading.current < worst else BoardFault.NONE

    def _precharge(self, reading: StageReading, now: float) -> int:
        given, limits, target = self._given, self._limits, reading.target
        if limits.dead and math.isnan(target):
            target = 0.0
        low = -LIVE_VOLTAGE if limits.dead else given.lowest_target
        too_high = not given.steps_up and target > reading.battery - _HEADROOM
        if target < low or target > min(limits.voltage, given.highest_target) or too_high:
            return BoardFault.VOLTAGE_OUT_OF_RANGE
        if abs(reading.output - target) <= _PRECHARGE_MATCH:
            self._enter(StageState.CLOSING, now)
            self._order(self._outputs._replace(contactor=True))
        elif now - self._since >= _PRECHARGE_TIMEOUT:
            if math.isnan(target):
                return BoardFault.NO_CHARGE_CURRENT  # nothing is connected
            return BoardFault.STALE if math.isnan(reading.output) else BoardFault.VOLTAGE_OUT_OF_RANGE
        return BoardFault.NONE

    def _pull_in(self, reading: StageReading, now: float) -> int:
        if reading.closed:
            self._enter(StageState.CLOSED, now)
            self._last |= dict.fromkeys(("current", "target", "battery", "charge", "flow", "rest"), now)
            self._flowed, self._bounce = False, -math.inf
            self._order(self._outputs._replace(precharge=False))
            return BoardFault.NONE
        return BoardFault.NO_CHARGE_CURRENT if now - self._since >= _PULL_IN_TIMEOUT else BoardFault.NONE

    def _has_opened(self, now: float) -> bool:
        if now - self._bounce >= _BOUNCE_PERIOD:
            self._bounce = now
        return now - self._bounce >= _BOUNCE_TIME

    def _lapsed(self, name: str, good: bool, longest: float, now: float) -> bool:
        """Return whether `good` has not held for `longest` s."""
        if good:
            self._last[name] = now
        return now - self._last[name] >= longest

    def _watch(self, reading: StageReading, now: float) -> int:
        """Return the fault of a reading that stays unknown or out of range."""
        given, target, battery = self._given, reading.target, reading.battery
        low = given.lowest_target if self._started else -math.inf
        high = min(self._limits.voltage + _OVER, given.highest_target)
        if self._lapsed("current", math.isfinite(reading.current), _BLIND_TIMEOUT, now):
            return BoardFault.STALE
        if self._lapsed("target", low <= target <= high, _BLIND_TIMEOUT, now):
            return BoardFault.STALE if math.isnan(target) else BoardFault.VOLTAGE_OUT_OF_RANGE
        if self._lapsed("battery", battery <= BATTERY_MAX, _BLIND_TIMEOUT, now):
            return BoardFault.STALE if math.isnan(battery) else BoardFault.VOLTAGE_OUT_OF_RANGE
        if self._lapsed("charge", battery >= BATTERY_MIN, _SAG_TIMEOUT, now):
            return BoardFault.VOLTAGE_OUT_OF_RANGE
        return BoardFault.NONE

    def _charge(self, reading: StageReading, now: float) -> int:
        flows = reading.current >= IDLE_CURRENT
        if flows:
            self._last["flow"], self._flowed = now, True
        rests = not (flows and reading.target >= self._given.lowest_target)
        self._started = self._lapsed("rest", rests, _STARTED, now) or self._started
        if fault := self._missing(reading, now):
            return fault
        known = math.isfinite(reading.battery) and not (self._started and math.isnan(reading.target))
        rise = _RAMP_UP * (now - self._stepped) if known else 0.0
        wanted = min(self._outputs.current + rise, self._largest(reading, now))
        if wanted != self._outputs.current:
            self._order(self._outputs._replace(current=wanted))
        return BoardFault.NONE

    def _missing(self, reading: StageReading, now: float) -> int:
        """Return the fault of a current that has not begun in time, or has not returned.

        A dead port must also show a voltage in time. `_watch` handles an unknown current.
        """
        if not math.isfinite(reading.current):
            return BoardFault.NONE
        if self._started and self._flowed:
            gone = now - self._last["flow"] >= self._limits.gap_time
            return BoardFault.NO_CHARGE_CURRENT if gone else BoardFault.NONE
        if now - self._since < self._limits.start_time:
            return BoardFault.NONE
        if reading.current < IDLE_CURRENT:
            return BoardFault.NO_CHARGE_CURRENT
        return BoardFault.SHORT_CIRCUIT if reading.target < _SHORT_VOLTAGE else BoardFault.VOLTAGE_OUT_OF_RANGE

    def _largest(self, reading: StageReading, now: float) -> float:
        """Return the largest current allowed now, A: of the closing, the stage, its fuse, a start and a gap."""
        given = self._given
        limits = [given.current_limit, self._limits.current]
        power = given.input_fuse * _EFFICIENCY * reading.battery
        if math.isfinite(power):
            limits.append(power / max(reading.target, 1.0))
        if not self._started:
            limits.append(_START_LIMIT)
        if now - self._last["flow"] >= _IDLE_TIME:
            limits.append(_IDLE_LIMIT)
        return max(min(limits), 0.0)

    def _ramp_down(self, reading: StageReading, now: float) -> None:
        if reading.current < _OPEN_CURRENT or now - self._since >= _RAMP_TIME:
            self._switch_off(now)
            return
        present = min(self._outputs.current, reading.current)  # a limit far above the current would come down too late
        self._order(self._outputs._replace(current=max(present - _RAMP_DOWN * (now - self._stepped), 0.0)))
