# SPDX-License-Identifier: Apache-2.0
"""The emulated board's power stage with every interlock, and the target at the other end of the electrodes.

Sequence, limits and latched faults are those of the firmware (dc_stage.c); docs/board-link.md has the source of each
number. Real ports behave like `TargetPort`; docs/targets.md and deltacharger_sim.circuit have the sources.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from statistics import fmean
from typing import NamedTuple, Protocol

from deltacharger_core.machine import BATTERY_MAX, BATTERY_MIN, LIVE_VOLTAGE, PROBE_LIFETIME, ZERO_CURRENT, ChargeLimits
from deltacharger_core.parameters import Bounded, flag, number
from deltacharger_driver.board import protocol

_PRECHARGE_TIMEOUT, _PRECHARGE_MATCH = 0.5, 1.0  # s; V between both sides of the contactor when it closes
_PULL_IN_TIMEOUT = 0.1  # s until the feedback shows closed
_RAMP_UP, _RAMP_DOWN, _RAMP_TIME = 40.0, 500.0, 0.05  # A/s, A/s, s that a commanded opening may take
_OPEN_CURRENT = 1.0  # A; below it a ramped opening opens the contactor
_ZERO_TIME = 0.05  # s from the opening until feedback and current must confirm it
_LARGEST_CURRENT = 20.0  # A
_CURRENT_LIMIT = 18.0  # A of stage and electrodes
_LOWEST_TARGET, _HIGHEST_TARGET = 10.0, 30.0  # V of a target that the stage feeds
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
HEARTBEAT_LIMIT = protocol.HEARTBEAT_TIMEOUT - 0.005
"""s without a heartbeat until the contactor opens; the remaining 5 ms are for the board to notice and to open."""
CHECK_PERIOD = 0.010  # s between checks of the power stage while it is busy, and after an opening
_CONFIRMED = 0.15  # s after an opening in which a weld shows

_PROBE_VOLTAGE, _PROBE_RESISTANCE, _PROBE_TIME = 5.0, 100.0, 0.15  # V through Ω, s until it is judged
_PROBE_OPEN = 1e-4  # A; below it the circuit is open
_NEAR_FULL = 0.3  # V below its end in which a regulated input reduces its power
_SWING, _SWINGS = 2.0 * math.pi * 7.0, 0.6  # rad/s and share by which a regulated input's power oscillates
_FALLS_ASLEEP = 0.6  # of its wake_voltage
_SECOND = 29.4  # V at which a second charger ends
_FLOWS = 0.02  # A
_FILM_MOST, _FILM_GROWS = 20.0, 0.0025  # Ω, and Ω/s while current flows
_DERATES_FROM, _DERATED = 10.0, 0.3  # A that a cold battery takes at first and at last
_DISCHARGED = 20.6  # V from which a deeply discharged battery takes full current
BATTERY_RESISTANCE = 0.15  # Ω inside the target's battery
_BURST, _BURST_PERIOD = 0.01, 3.0  # s of current out of the target, and between two bursts
_RELAXES = 0.02  # V, of a battery that its BMS has disconnected


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
    """The stage's sequence: pre-charge, contactor, ramp up within the closing's limits; ramp down, open, confirm.

    It judges one reading after the other and orders the outputs.

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
            return (
                protocol.BoardFault.CONTACTOR_WELDED
                if live and now - self._since >= _ZERO_TIME
                else protocol.BoardFault.NONE
            )
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
            return protocol.BoardFault.REVERSE_POLARITY
        if reading.current > _OPEN_CURRENT and reading.target < _SHORT_VOLTAGE:
            return protocol.BoardFault.SHORT_CIRCUIT
        if reading.current > _LARGEST_CURRENT:
            return protocol.BoardFault.OVER_CURRENT
        worst = _REVERSE_LIMIT if back else _REVERSE_AT_ONCE
        return protocol.BoardFault.REVERSE_CURRENT if reading.current < worst else protocol.BoardFault.NONE

    def _precharge(self, reading: StageReading, now: float) -> int:
        given, limits, target = self._given, self._limits, reading.target
        if limits.dead and math.isnan(target):
            target = 0.0
        low = -LIVE_VOLTAGE if limits.dead else _LOWEST_TARGET
        too_high = not given.steps_up and target > reading.battery - _HEADROOM
        if target < low or target > min(limits.voltage, _HIGHEST_TARGET) or too_high:
            return protocol.BoardFault.VOLTAGE_OUT_OF_RANGE
        if abs(reading.output - target) <= _PRECHARGE_MATCH:
            self._enter(StageState.CLOSING, now)
            self._order(self._outputs._replace(contactor=True))
        elif now - self._since >= _PRECHARGE_TIMEOUT:
            if math.isnan(target):
                return protocol.BoardFault.NO_CHARGE_CURRENT  # nothing is connected
            return protocol.BoardFault.STALE if math.isnan(reading.output) else protocol.BoardFault.VOLTAGE_OUT_OF_RANGE
        return protocol.BoardFault.NONE

    def _pull_in(self, reading: StageReading, now: float) -> int:
        if reading.closed:
            self._enter(StageState.CLOSED, now)
            self._last |= dict.fromkeys(("current", "target", "battery", "charge", "flow", "rest"), now)
            self._flowed, self._bounce = False, -math.inf
            self._order(self._outputs._replace(precharge=False))
            return protocol.BoardFault.NONE
        return (
            protocol.BoardFault.NO_CHARGE_CURRENT if now - self._since >= _PULL_IN_TIMEOUT else protocol.BoardFault.NONE
        )

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
        target, battery = reading.target, reading.battery
        low = _LOWEST_TARGET if self._started else -math.inf
        high = min(self._limits.voltage + _OVER, _HIGHEST_TARGET)
        if self._lapsed("current", math.isfinite(reading.current), _BLIND_TIMEOUT, now):
            return protocol.BoardFault.STALE
        if self._lapsed("target", low <= target <= high, _BLIND_TIMEOUT, now):
            return protocol.BoardFault.STALE if math.isnan(target) else protocol.BoardFault.VOLTAGE_OUT_OF_RANGE
        if self._lapsed("battery", battery <= BATTERY_MAX, _BLIND_TIMEOUT, now):
            return protocol.BoardFault.STALE if math.isnan(battery) else protocol.BoardFault.VOLTAGE_OUT_OF_RANGE
        if self._lapsed("charge", battery >= BATTERY_MIN, _SAG_TIMEOUT, now):
            return protocol.BoardFault.VOLTAGE_OUT_OF_RANGE
        return protocol.BoardFault.NONE

    def _charge(self, reading: StageReading, now: float) -> int:
        flows = reading.current >= IDLE_CURRENT
        if flows:
            self._last["flow"], self._flowed = now, True
        rests = not (flows and reading.target >= _LOWEST_TARGET)
        self._started = self._lapsed("rest", rests, _STARTED, now) or self._started
        if fault := self._missing(reading, now):
            return fault
        known = math.isfinite(reading.battery) and not (self._started and math.isnan(reading.target))
        rise = _RAMP_UP * (now - self._stepped) if known else 0.0
        wanted = min(self._outputs.current + rise, self._largest(reading, now))
        if wanted != self._outputs.current:
            self._order(self._outputs._replace(current=wanted))
        return protocol.BoardFault.NONE

    def _missing(self, reading: StageReading, now: float) -> int:
        """Return the fault of a current that has not begun in time, or has not returned.

        A dead port must also show a voltage in time. `_watch` handles an unknown current.
        """
        if not math.isfinite(reading.current):
            return protocol.BoardFault.NONE
        if self._started and self._flowed:
            gone = now - self._last["flow"] >= self._limits.gap_time
            return protocol.BoardFault.NO_CHARGE_CURRENT if gone else protocol.BoardFault.NONE
        if now - self._since < self._limits.start_time:
            return protocol.BoardFault.NONE
        if reading.current < IDLE_CURRENT:
            return protocol.BoardFault.NO_CHARGE_CURRENT
        return (
            protocol.BoardFault.SHORT_CIRCUIT
            if reading.target < _SHORT_VOLTAGE
            else protocol.BoardFault.VOLTAGE_OUT_OF_RANGE
        )

    def _largest(self, reading: StageReading, now: float) -> float:
        """Return the largest current allowed now, A: of the closing, the stage, its fuse, a start and a gap."""
        given = self._given
        limits = [_CURRENT_LIMIT, self._limits.current]
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


class PowerPlant(Protocol):
    """The physics behind the power stage, on its own clock."""

    def read_power(self) -> StageReading:
        """Return what the board measures now; a fault of the stage's own detectors is latched by the board."""

    def drive(self, outputs: Outputs) -> None:
        """Take the board's orders."""

    def probe(self) -> tuple[float, float]:
        """Return ohm and V that the probe measures in its two looks."""


class EmulatedPower:
    """State of the power stage between packets.

    Attributes:
        closed: a close was accepted and no opening followed (the stage may still pre-charge).
        fault: the latched fault, 0 = none.
        probe_aborted: the running probe was aborted, and the host has no answer yet.
        stage: its sequence.

    Args:
        plant: the physics.
        parameters: of the stage.
        probe_time: s that a probe takes, at most 0.25.
    """

    def __init__(
        self, plant: PowerPlant, parameters: StageParameters | None = None, probe_time: float = _PROBE_TIME
    ) -> None:
        self._plant = plant
        self._probe_time = probe_time
        self.parameters = parameters or StageParameters()
        self.stage = PowerStage(plant.drive, self.parameters)
        self.closed = False
        self.fault = int(protocol.BoardFault.NONE)
        self.reset(0.0)

    def reset(self, now: float) -> None:
        """Boot: reset all state but a weld, open the contactor."""
        self.stage.reset(now)
        self.closed = False
        self._clear_fault()
        self._now = now
        self._heartbeat_deadline = -math.inf
        self._probe_deadline, self._probed = -math.inf, (math.nan, math.nan)  # the last probe allows a close until then
        self._probe_due = math.inf
        self._next_check, self._checked_until = now, now + _CONFIRMED
        self.probe_aborted = False
        self._clear_report()

    def heartbeat(self, now: float) -> None:
        """Take a heartbeat."""
        self._heartbeat_deadline = now + HEARTBEAT_LIMIT

    def close(self, limits: ChargeLimits, now: float) -> protocol.AckError:
        """Close within these limits if every interlock allows it."""
        if self.closed:
            return protocol.AckError.NOT_NOW
        allowed = now < self._probe_deadline and not protocol.probe_problem(*self._probed, limits.dead)
        if now >= self._heartbeat_deadline or self.fault or not allowed or not self.parameters.keeps(limits.voltage):
            return protocol.AckError.INTERLOCK
        self._abort_probe()  # the probe's circuit must leave the electrodes before the battery is connected
        self.closed = True
        self._next_check = now + CHECK_PERIOD
        self.stage.close(limits, now)
        return protocol.AckError.DONE

    def limit(self, current: float) -> protocol.AckError:
        """Change the largest current (A) of a closed contactor."""
        if not self.closed:
            return protocol.AckError.NOT_NOW
        self.stage.limit(current)
        return protocol.AckError.DONE

    def open(self, now: float) -> None:
        """Open as commanded, ramping down, and clear the latched fault, but no weld; a persisting one returns."""
        self._now = now
        self._open(ramp=True)
        self._clear_fault()

    def _clear_fault(self) -> None:
        if self.fault != protocol.BoardFault.CONTACTOR_WELDED:
            self.fault = int(protocol.BoardFault.NONE)

    def clear_weld(self) -> protocol.AckError:
        """Clear a latched weld once contactor and electrodes are dead."""
        if self.closed or self.fault not in (protocol.BoardFault.NONE, protocol.BoardFault.CONTACTOR_WELDED):
            return protocol.AckError.NOT_NOW
        seen = self._plant.read_power()
        if protocol.weld_problem(protocol.Power(seen.battery, seen.target, seen.current, seen.closed, 0)):
            return protocol.AckError.INTERLOCK
        self.fault = int(protocol.BoardFault.NONE)
        return protocol.AckError.DONE

    def trip(self, fault: int) -> None:
        """Open at once and latch `fault`; the first fault stays, but a weld replaces it."""
        self._open(ramp=False)
        if self._outranks(fault):
            self.fault = int(fault)

    def _outranks(self, fault: int) -> bool:
        return bool(fault) and (not self.fault or fault == protocol.BoardFault.CONTACTOR_WELDED != self.fault)

    def _open(self, ramp: bool) -> None:
        self.stage.open(ramp, self._now)
        self.closed = False
        self._probe_deadline = -math.inf
        self._next_check, self._checked_until = self._now + CHECK_PERIOD, self._now + _CONFIRMED
        self._abort_probe()

    def _abort_probe(self) -> None:
        if self._probe_due < math.inf:
            self._probe_due = math.inf
            self.probe_aborted = True

    def start_probe(self, now: float) -> protocol.AckError:
        """Start a probe; DONE means that `poll_probe` will return the result."""
        if self.fault:
            return protocol.AckError.INTERLOCK
        seen = self._plant.read_power()
        if self.closed or self._probe_due < math.inf or seen.closed or self.stage.state is not StageState.OPEN:
            return protocol.AckError.NOT_NOW
        if abs(seen.current) >= ZERO_CURRENT:
            return protocol.AckError.INTERLOCK
        self._probe_due = now + self._probe_time
        return protocol.AckError.DONE

    def poll_probe(self, now: float) -> tuple[float, float] | None:
        """Return the result (ohm, V) of a probe that just ended, else None."""
        if now < self._probe_due:
            return None
        self._probe_due = math.inf
        self._probed, self._probe_deadline = self._plant.probe(), now + PROBE_LIFETIME
        return self._probed

    def poll(self, now: float) -> None:
        """Check the heartbeat and the power stage."""
        self._now = now
        if self.closed and now >= self._heartbeat_deadline:
            self.trip(protocol.BoardFault.HEARTBEAT_LOST)
        if now >= self._next_check:
            self._check()
            busy = self.stage.state is not StageState.OPEN or now < self._checked_until
            self._next_check = now + CHECK_PERIOD if busy else math.inf

    def _check(self) -> StageReading:
        """Read the plant and latch a fault that it shows."""
        reading = self._plant.read_power()
        if math.isfinite(reading.current):
            self._currents.append(reading.current)
        if reading.current >= IDLE_CURRENT and math.isfinite(reading.target):
            self._voltages.append(reading.target)
        shown = self.stage.step(reading, self._now)
        fault = reading.fault if reading.fault and shown != protocol.BoardFault.CONTACTOR_WELDED else shown
        if fault == protocol.BoardFault.NO_CHARGE_CURRENT and not self.closed:
            fault = int(protocol.BoardFault.NONE)  # after an opening no current is expected
        if self._outranks(fault):
            self.trip(fault)
            reading = self._plant.read_power()
        elif self.closed and self.stage.dropped_out:
            self._open(ramp=False)  # it opened on its own: a pulled plug, a fuse
        return reading

    def report(self) -> protocol.Power:
        """Return the content of a POWER packet: currents since the last one, the target's voltage while they flowed."""
        reading = self._check()
        mean, least = (fmean(self._currents), min(self._currents)) if self._currents else (math.nan, math.nan)
        target = fmean(self._voltages) if self._voltages else reading.target
        self._clear_report()
        closed = reading.closed or self.stage.state in (StageState.CLOSED, StageState.RAMPING_DOWN)
        return protocol.Power(reading.battery, target, mean, closed, self.fault, least)

    def _clear_report(self) -> None:
        self._currents: list[float] = []  # A since the last report
        self._voltages: list[float] = []  # V of the target while current flowed

    def next_event(self) -> float:
        """Return when `poll` or `poll_probe` is due, s."""
        due = min(self._probe_due, self._next_check)
        return min(due, self._heartbeat_deadline) if self.closed else due


@dataclass(frozen=True)
class PortParameters(Bounded):
    """The target's battery and port; by default a battery of 24 V whose voltage lies at the port."""

    voltage: float = number(24.0, -60.0, 60.0, "V", "voltage of the battery without load; negative = swapped")
    capacity: float = number(0.0, 0.0, 1e9, "C/V", "charge that raises that voltage by 1 V; 0 = it stays constant")
    accepts: bool = flag(True, "false = the target takes no current")
    diode: float = number(0.0, 0.0, 2.0, "V", "forward voltage of a diode that hides the battery; 0 = none")
    bleeder: float = number(0.0, 0.0, 1e6, "Ω", "resistor across the port, such as a detector's divider; 0 = none")
    capacitor: float = number(0.0, 0.0, 0.1, "F", "capacitor at the port; 0 = none")
    wake_voltage: float = number(0.0, 0.0, 60.0, "V", "voltage at which it connects its battery; 0 = always")
    wake_time: float = number(0.0, 0.0, 120.0, "s", "delay from there until the battery is connected")
    gap_time: float = number(0.0, 0.0, 3600.0, "s", "duration of each gap in the current; 0 = none")
    gap_period: float = number(1.0, 0.001, 3600.0, "s", "time with current between two gaps")
    gaps: int = number(0, 0, 1000, "", "number of gaps after the battery was connected; 0 = without end")
    trickle: float = number(0.0, 0.0, 18.0, "A", "current into a battery below 20.6 V; 0 = as any other")
    derating_time: float = number(0.0, 0.0, 1e5, "s", "time constant of a cold battery that takes less; 0 = never")
    cut_voltage: float = number(0.0, 0.0, 60.0, "V", "battery voltage at which its BMS disconnects it; 0 = never")
    cut_time: float = number(0.0, 0.0, 3600.0, "s", "time until it connects the battery again; 0 = never")
    load: float = number(0.0, -500.0, 500.0, "W", "power that the target uses; negative = a second charger, to 29.4 V")
    load_period: float = number(0.0, 0.0, 3600.0, "s", "the load is on and off for this time each; 0 = always on")
    regeneration: float = number(0.0, 0.0, 18.0, "A", "current out of it while it brakes, 10 ms every 3 s; 0 = none")
    power: float = number(0.0, 0.0, 500.0, "W", "of a regulated input behind a capacitor, oscillating; 0 = none")
    film: float = number(0.0, 0.0, 20.0, "Ω", "of dirt on the electrodes, growing while current flows; 0 = clean")


class TargetPort:
    """State of one target, for the emulated board, virtual time and the firmware's bench.

    Args:
        parameters: of the target.

    Attributes:
        voltage: of its battery without load, V.
        film: resistance of dirt, Ω.
        steady: whether nothing about it changes by itself.
    """

    def __init__(self, parameters: PortParameters) -> None:
        self.parameters = parameters
        plain = PortParameters(voltage=parameters.voltage, diode=parameters.diode)
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
        hidden = p.diode or p.power or self._time < self._woken
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
            self.film = min(self.film + _FILM_GROWS * dt, _FILM_MOST) if p.film else 0.0
        if self._woken == math.inf and shown >= p.wake_voltage and not math.isinf(contact):
            self._woken = self._time + p.wake_time
        self._charge(dt, into)
        return current, shown

    @property
    def _source(self) -> float:
        """A from a second charger now."""
        given = max(-self.parameters.load, 0.0) / max(self.voltage, 1.0)
        return min(given, max(_SECOND - self.voltage, 0.0) / BATTERY_RESISTANCE)

    @property
    def _takes(self) -> bool:
        """Whether the battery takes current now."""
        p, cut = self.parameters, self._time - self._cut
        gone = not p.accepts or self._time < self._woken
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
        swing = 1.0 - _SWINGS * (0.5 - 0.5 * math.cos(_SWING * self._time))
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
        if p.regeneration and since >= 0.0 and since % _BURST_PERIOD >= _BURST_PERIOD - _BURST:
            return -p.regeneration, voltage + p.regeneration * contact
        path, behind = contact + BATTERY_RESISTANCE, self.voltage + p.diode + self._source * BATTERY_RESISTANCE
        most = p.trickle if p.trickle and self.voltage < _DISCHARGED else limit
        if p.derating_time and since >= 0.0:
            most = min(most, _DERATED + _DERATES_FROM * math.exp(-since / p.derating_time))
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
        load = 0.0 if idle else max(p.load, 0.0) / max(self.voltage, 1.0)
        self.voltage += (into + self._source - load) * dt / p.capacity
        if p.cut_voltage and not p.power and self._takes and self.voltage >= p.cut_voltage:
            self._cut = self._time
            self.voltage -= _RELAXES
