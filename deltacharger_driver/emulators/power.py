# SPDX-License-Identifier: Apache-2.0
"""The emulated board's power stage: contactor, heartbeat, latched faults and probe, with every interlock."""

from __future__ import annotations

import math
from typing import Protocol

from deltacharger_driver.board.payloads import Power, probe_problem, weld_problem
from deltacharger_driver.board.protocol import HEARTBEAT_TIMEOUT, PROBE_LIFETIME, ZERO_CURRENT, AckError, BoardFault
from deltacharger_driver.emulators.detectors import TARGET_VOLTAGES, Detectors

HEARTBEAT_LIMIT = HEARTBEAT_TIMEOUT - 0.005
"""s without a heartbeat until the contactor opens; the remaining 5 ms are for the board to notice and to open."""
CHECK_PERIOD = 0.010  # s between checks of the power stage's detectors while closed, and after an opening


class PowerPlant(Protocol):
    """The physics behind the power stage, on its own clock."""

    def read_power(self) -> tuple[float, float, float, bool, int]:
        """Return battery V, target V, charge A (NaN = not measured), contactor closed, fault detected now (0 = none).

        The fault is one of 1, 2, 4, 5, 6, 7, 9 of docs/board-link.md; the board latches it.
        """

    def close_contactor(self) -> None:
        """Pre-charge, close and ramp up."""

    def open_contactor(self, ramp: bool) -> None:
        """Open: with `ramp` reduce the current below 1 A first (≤ 50 ms), otherwise open at once."""

    def probe(self) -> tuple[float, float]:
        """Return ohm between the electrodes (inf = open circuit) and V of the target, measured at low voltage."""


class EmulatedPower:
    """State of the power stage between packets.

    Attributes:
        closed: a close was accepted and no opening followed (the plant may still pre-charge).
        fault: the latched fault, 0 = none.
        probe_aborted: the running probe was aborted, and the host has no answer yet.

    Args:
        plant: the physics.
        probe_time: s that a probe takes, at most 0.25.
        target_voltages: lowest and highest V that the stage charges.
    """

    def __init__(
        self, plant: PowerPlant, probe_time: float, target_voltages: tuple[float, float] = TARGET_VOLTAGES
    ) -> None:
        self._plant = plant
        self._probe_time = probe_time
        self._detectors = Detectors(target_voltages)
        self.closed = False
        self.fault = int(BoardFault.NONE)
        self.reset(0.0)

    def reset(self, now: float) -> None:
        """Boot: reset all state but a weld, open the contactor."""
        if self.closed:
            self._plant.open_contactor(False)
        self.closed = False
        self._clear_fault()
        self._now = now
        self._detectors.reset(now)
        self._heartbeat_deadline = -math.inf
        self._probe_deadline = -math.inf  # the last probe allows a close until then
        self._probe_due = math.inf
        self._next_check = now
        self.probe_aborted = False

    def heartbeat(self, now: float) -> None:
        """Take a heartbeat."""
        self._heartbeat_deadline = now + HEARTBEAT_LIMIT

    def close(self, now: float) -> AckError:
        """Close if every interlock allows it."""
        if self.closed:
            return AckError.NOT_NOW
        if now >= self._heartbeat_deadline or self.fault or now >= self._probe_deadline:
            return AckError.INTERLOCK
        self._abort_probe()  # the probe's circuit must leave the electrodes before the battery is connected
        self.closed = True
        self._detectors.close()
        self._next_check = now + CHECK_PERIOD
        self._plant.close_contactor()
        return AckError.DONE

    def open(self, now: float) -> None:
        """Open as commanded, ramping down, and clear the latched fault, but no weld; a persisting one returns."""
        self._now = now
        self._open(ramp=True)
        self._clear_fault()
        self._next_check = now + CHECK_PERIOD

    def _clear_fault(self) -> None:
        if self.fault != BoardFault.CONTACTOR_WELDED:
            self.fault = int(BoardFault.NONE)

    def clear_weld(self) -> AckError:
        """Clear a latched weld once contactor and electrodes are dead."""
        if self.closed or self.fault not in (BoardFault.NONE, BoardFault.CONTACTOR_WELDED):
            return AckError.NOT_NOW
        if weld_problem(Power(*self._plant.read_power())):
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
        self._plant.open_contactor(ramp)
        self._detectors.open(self._now, ramp)
        self.closed = False
        self._probe_deadline = -math.inf
        self._abort_probe()

    def _abort_probe(self) -> None:
        if self._probe_due < math.inf:
            self._probe_due = math.inf
            self.probe_aborted = True

    def start_probe(self, now: float) -> AckError:
        """Start a probe; DONE means that `poll_probe` will return the result."""
        if self.fault:
            return AckError.INTERLOCK
        _, _, current, closed, _ = self._plant.read_power()
        if self.closed or self._probe_due < math.inf or closed:
            return AckError.NOT_NOW
        if abs(current) >= ZERO_CURRENT:
            return AckError.INTERLOCK
        self._probe_due = now + self._probe_time
        return AckError.DONE

    def poll_probe(self, now: float) -> tuple[float, float] | None:
        """Return the result (ohm, V) of a probe that just ended, else None."""
        if now < self._probe_due:
            return None
        self._probe_due = math.inf
        resistance, voltage = self._plant.probe()
        allowed = not probe_problem(resistance, voltage)
        self._probe_deadline = now + PROBE_LIFETIME if allowed else -math.inf
        return resistance, voltage

    def poll(self, now: float) -> None:
        """Check the heartbeat and the power stage's detectors."""
        self._now = now
        if self.closed and now >= self._heartbeat_deadline:
            self.trip(BoardFault.HEARTBEAT_LOST)
        if now >= self._next_check:
            self.read()
            self._next_check = now + CHECK_PERIOD if now < self._detectors.open_from else math.inf

    def read(self) -> Power:
        """Read the plant, latch a detected fault, and return the content of a POWER packet."""
        battery, target, current, contactor, detected = reading = self._plant.read_power()
        was_closed = self._detectors.seen_closed
        shown = self._detectors.fault(self._now, Power(*reading))
        if not detected or shown == BoardFault.CONTACTOR_WELDED:
            detected = shown
        if detected == BoardFault.NO_CHARGE_CURRENT and not self.closed:
            detected = BoardFault.NONE  # after an opening no current is expected
        if self._outranks(detected):
            self.trip(detected)
            contactor = self._plant.read_power()[3]
        elif was_closed and not self._detectors.seen_closed:
            self._open(ramp=False)  # it opened on its own: a pulled plug, a fuse
        return Power(battery, target, current, bool(contactor) or self._detectors.seen_closed, self.fault)

    def next_event(self) -> float:
        """Return when `poll` or `poll_probe` is due, s."""
        due = min(self._probe_due, self._next_check)
        return min(due, self._heartbeat_deadline) if self.closed else due
