# SPDX-License-Identifier: Apache-2.0
"""The emulated board's power stage: contactor, heartbeat, latched faults and probe, with every interlock."""

from __future__ import annotations

import math
from statistics import fmean
from typing import Protocol

from deltacharger_core.charge_port import ChargeLimits
from deltacharger_driver.board.payloads import Power, probe_problem, weld_problem
from deltacharger_driver.board.protocol import HEARTBEAT_TIMEOUT, PROBE_LIFETIME, ZERO_CURRENT, AckError, BoardFault
from deltacharger_driver.emulators.stage import (
    IDLE_CURRENT,
    Outputs,
    PowerStage,
    StageParameters,
    StageReading,
    StageState,
)

HEARTBEAT_LIMIT = HEARTBEAT_TIMEOUT - 0.005
"""s without a heartbeat until the contactor opens; the remaining 5 ms are for the board to notice and to open."""
CHECK_PERIOD = 0.010  # s between checks of the power stage while it is busy, and after an opening
_CONFIRMED = 0.15  # s after an opening in which a weld shows


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
        probe_time: s that a probe takes, at most 0.25.
        parameters: of the stage.
    """

    def __init__(self, plant: PowerPlant, probe_time: float, parameters: StageParameters | None = None) -> None:
        self._plant = plant
        self._probe_time = probe_time
        self.parameters = parameters or StageParameters()
        self.stage = PowerStage(plant.drive, self.parameters)
        self.closed = False
        self.fault = int(BoardFault.NONE)
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

    def close(self, limits: ChargeLimits, now: float) -> AckError:
        """Close within these limits if every interlock allows it."""
        if self.closed:
            return AckError.NOT_NOW
        allowed = now < self._probe_deadline and not probe_problem(*self._probed, limits.dead)
        if now >= self._heartbeat_deadline or self.fault or not allowed or not self.parameters.keeps(limits.voltage):
            return AckError.INTERLOCK
        self._abort_probe()  # the probe's circuit must leave the electrodes before the battery is connected
        self.closed = True
        self._next_check = now + CHECK_PERIOD
        self.stage.close(limits, now)
        return AckError.DONE

    def limit(self, current: float) -> AckError:
        """Change the largest current (A) of a closed contactor."""
        if not self.closed:
            return AckError.NOT_NOW
        self.stage.limit(current)
        return AckError.DONE

    def open(self, now: float) -> None:
        """Open as commanded, ramping down, and clear the latched fault, but no weld; a persisting one returns."""
        self._now = now
        self._open(ramp=True)
        self._clear_fault()

    def _clear_fault(self) -> None:
        if self.fault != BoardFault.CONTACTOR_WELDED:
            self.fault = int(BoardFault.NONE)

    def clear_weld(self) -> AckError:
        """Clear a latched weld once contactor and electrodes are dead."""
        if self.closed or self.fault not in (BoardFault.NONE, BoardFault.CONTACTOR_WELDED):
            return AckError.NOT_NOW
        seen = self._plant.read_power()
        if weld_problem(Power(seen.battery, seen.target, seen.current, seen.closed, 0)):
            return AckError.INTERLOCK
        self.fault = int(BoardFault.NONE)
        return AckError.DONE

    def trip(self, fault: int) -> None:
        """Open at once and latch `fault`; the first fault stays, but a weld replaces it."""
        self._open(ramp=False)
        if self._outranks(fault):
            self.fault = int(fault)

    def _outranks(self, fault: int) -> bool:
        return bool(fault) and (not self.fault or fault == BoardFault.CONTACTOR_WELDED != self.fault)

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

    def start_probe(self, now: float) -> AckError:
        """Start a probe; DONE means that `poll_probe` will return the result."""
        if self.fault:
            return AckError.INTERLOCK
        seen = self._plant.read_power()
        if self.closed or self._probe_due < math.inf or seen.closed or self.stage.state is not StageState.OPEN:
            return AckError.NOT_NOW
        if abs(seen.current) >= ZERO_CURRENT:
            return AckError.INTERLOCK
        self._probe_due = now + self._probe_time
        return AckError.DONE

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
            self.trip(BoardFault.HEARTBEAT_LOST)
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
        fault = reading.fault if reading.fault and shown != BoardFault.CONTACTOR_WELDED else shown
        if fault == BoardFault.NO_CHARGE_CURRENT and not self.closed:
            fault = int(BoardFault.NONE)  # after an opening no current is expected
        if self._outranks(fault):
            self.trip(fault)
            reading = self._plant.read_power()
        elif self.closed and self.stage.dropped_out:
            self._open(ramp=False)  # it opened on its own: a pulled plug, a fuse
        return reading

    def report(self) -> Power:
        """Return the content of a POWER packet: currents since the last one, the target's voltage while they flowed."""
        reading = self._check()
        mean, least = (fmean(self._currents), min(self._currents)) if self._currents else (math.nan, math.nan)
        target = fmean(self._voltages) if self._voltages else reading.target
        self._clear_report()
        closed = reading.closed or self.stage.state in (StageState.CLOSED, StageState.RAMPING_DOWN)
        return Power(reading.battery, target, mean, closed, self.fault, least)

    def _clear_report(self) -> None:
        self._currents: list[float] = []  # A since the last report
        self._voltages: list[float] = []  # V of the target while current flowed

    def next_event(self) -> float:
        """Return when `poll` or `poll_probe` is due, s."""
        due = min(self._probe_due, self._next_check)
        return min(due, self._heartbeat_deadline) if self.closed else due
