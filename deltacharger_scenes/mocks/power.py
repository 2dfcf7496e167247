# SPDX-License-Identifier: Apache-2.0
"""The mock nodes' power stage: contactor, lease, probe and charge current. Pure; the caller passes the time."""

from __future__ import annotations

import math

from deltacharger_core.machine import ChargeLimits
from deltacharger_driver.board.contactor import ContactorLease, LeaseRefused
from deltacharger_driver.board.protocol import BoardFault, clearing

BATTERY = 26.0  # V, within machine.BATTERY_MIN and BATTERY_MAX
TARGET = 23.5  # V, of a live port
CHARGE_CURRENT = 5.0  # A once ramped up, or less if the limits allow less
_RISE = 0.1  # s, time constant of the ramp
_GRACE = 0.5  # s after a close until missing current is a fault


class MockPower:
    """The board's power stage as tactile_node's clients see it.

    Attributes:
        lease: on the contactor, by the driver's own code.
        closed: whether the contactor is closed.
        current: A into the target.
        current_max: A, the limit of the lease.
        fault: code of ChargerPower, latched until the next opening command, a weld until it is cleared.
        misbehaviour: "" or one of short, open_circuit, reverse_polarity, no_charge_current, contactor_refusal,
            contactor_welded.
    """

    def __init__(self) -> None:
        self.lease = ContactorLease()
        self.closed = False
        self.current = 0.0
        self.current_max = 0.0
        self.fault = 0
        self.misbehaviour = ""
        self._closed_at = 0.0
        self._last: float | None = None

    def advance(self, now: float, contact: bool) -> None:
        """Advance to `now` (s), with or without contact between the electrodes."""
        step = 0.0 if self._last is None else max(now - self._last, 0.0)
        self._last = now
        if self.lease.has_lapsed(now):
            self._open()
        flows = self.closed and contact and self.misbehaviour != "no_charge_current"
        aim = min(CHARGE_CURRENT, self.current_max) if flows else 0.0
        self.current = aim + (self.current - aim) * math.exp(-step / _RISE) if flows else 0.0
        if self.closed and not flows and now - self._closed_at > _GRACE and self.misbehaviour != "contactor_welded":
            self.fault = self.fault or BoardFault.NO_CHARGE_CURRENT
            self._open()

    def probe(self, now: float, contact: bool) -> tuple[float, float]:
        """Look at the port, as `port_of` takes it; the result allows a close for 2 s.

        Raises:
            LeaseRefused: the contactor is closed.
        """
        if self.closed:
            raise LeaseRefused("the contactor is closed: open it before probing")
        found = {"short": (0.05, 0.0), "open_circuit": (math.inf, 0.0), "reverse_polarity": (math.nan, -TARGET)}
        live = (math.nan, TARGET)
        resistance, voltage = found.get(self.misbehaviour, live) if contact else found["open_circuit"]
        self.lease.probed(resistance, voltage, now)
        return resistance, voltage

    def close(
        self, holder: str, duration: float, now: float, token: str = "", limits: ChargeLimits | None = None
    ) -> None:
        """Close, or renew with another current or the same (0).

        Raises:
            LeaseRefused: by the lease, a latched fault, or the mock's misbehaviour.
        """
        if self.misbehaviour == "contactor_refusal":
            raise LeaseRefused("the board's interlock keeps the contactor open")
        if self.fault:
            raise LeaseRefused(f"fault {self.fault} is latched; {clearing(self.fault)}")
        self.lease.take(holder, duration, now, token, limits)
        self.current_max = (0.0 if limits is None else limits.current) or self.current_max
        if not self.closed:
            self.closed, self._closed_at = True, now

    def open(self) -> None:
        """Open by command, which also clears a latched fault, but no weld."""
        if self.fault != BoardFault.CONTACTOR_WELDED:
            self.fault = 0
        self._open()

    def clear_weld(self) -> None:
        """Clear a latched weld.

        Raises:
            LeaseRefused: the contactor is still closed.
        """
        if self.closed:
            raise LeaseRefused("the weld stays latched: the contactor reports closed")
        self.fault = 0

    def _open(self) -> None:
        self.lease.opened()
        if self.misbehaviour == "contactor_welded" and self.closed:
            self.fault = BoardFault.CONTACTOR_WELDED
            return
        self.closed = False
        self.current = 0.0
