# SPDX-License-Identifier: Apache-2.0
"""The lease that keeps the contactor closed: pure logic, the clock is passed in.

A close is a lease of at most 0.25 s that its holder renews. A lapsed lease means that the holder is dead or hangs; the
contactor must then be opened before any other request is served. Every opening, whatever its cause, ends the lease and
voids the probe. So each close follows a look at the port that it closes on. Its limits bind until the opening; a
renewal may change the current.
"""

from __future__ import annotations

import hmac
import math

from deltacharger_core.charge_port import ChargeLimits
from deltacharger_core.machine import LONGEST_LEASE
from deltacharger_driver.board.payloads import LIMITS, limits_problem, probe_problem
from deltacharger_driver.board.protocol import PROBE_LIFETIME
from deltacharger_driver.errors import DriverError

LONGEST_NAME = 64
"""Largest length of a holder's name and of its token."""


class LeaseRefused(DriverError, PermissionError):
    """A close or a renewal is refused. Example: another node holds the contactor."""


class ContactorLease:
    """The lease on the contactor and the probe that allows it.

    Not thread-safe: its owner calls it under one lock.

    Attributes:
        holder: name of the holder; '' if there is none.
        until: s; end of the lease unless renewed.
        openings: number of openings; compare it before and after a wait to detect one.
        renewals: number of renewals.
        lapses: number of leases that ran out; kept by the owner, which then opens the contactor.
        resistance: ohm, result of the last probe, even if void; NaN before the first, and of a live port.
        target_voltage: V, result of the last probe.
    """

    def __init__(self) -> None:
        self.holder = ""
        self.until = -math.inf
        self.openings = 0
        self.renewals = 0
        self.lapses = 0
        self.resistance = math.nan
        self.target_voltage = math.nan
        self._probed_at = -math.inf
        self._token = ""

    def is_live(self, now: float) -> bool:
        """Return whether the lease is held at `now` (s)."""
        return bool(self.holder) and now < self.until

    def has_lapsed(self, now: float) -> bool:
        """Return whether a lease ran out without an opening since: open the contactor, then call `opened`."""
        return bool(self.holder) and now >= self.until

    def remaining(self, now: float) -> float:
        """Return the seconds until the lease lapses; 0 if it has, inf without a lease."""
        return max(self.until - now, 0.0) if self.holder else math.inf

    def probed(self, resistance: float, target_voltage: float, now: float) -> None:
        """Record a probe's result (ohm, V) at `now`."""
        self.resistance = resistance
        self.target_voltage = target_voltage
        self._probed_at = now

    def probe_age(self, now: float) -> float:
        """Return the age of the last valid probe, s; inf = none, or voided by an opening."""
        return now - self._probed_at

    def check(
        self, holder: str, duration: float, now: float, token: str = "", limits: ChargeLimits | None = None
    ) -> None:
        """Raise the errors of `take` without changing anything.

        Raises:
            LeaseRefused: no name; name or token too long; duration not positive; lapsed and not yet opened; held by
                another holder or with another token; for a new lease, no valid limits, or no probe younger than 2 s
                that allows a close within them; for a renewal, a current out of range.
        """
        for what, text in (("holder", holder), ("token", token)):
            if len(text) > LONGEST_NAME:
                raise LeaseRefused(f"the {what} has {len(text)} characters; give at most {LONGEST_NAME}")
        if not holder:
            raise LeaseRefused("the holder has no name; set 'holder', which is reported to other clients")
        if not duration > 0.0:  # also NaN
            raise LeaseRefused(f"lease of {duration:g} s: not positive; request up to {LONGEST_LEASE} s and renew it")
        if self.has_lapsed(now):
            raise LeaseRefused(f"the lease of '{self.holder}' lapsed and the contactor is not open yet; retry")
        if self.is_live(now):
            if holder != self.holder or not self._is_known(token):
                raise LeaseRefused(f"'{self.holder}' holds the contactor for another {self.remaining(now):.2f} s")
            low, high = LIMITS["current"]
            current = 0.0 if limits is None else limits.current
            if current != 0.0 and not low <= current <= high:  # also NaN
                raise LeaseRefused(f"current is {current:g}: give {low:g} to {high:g}, or 0 to leave it")
            return
        if limits is None:
            raise LeaseRefused("a close needs limits of current and voltage: give current_max and voltage_max")
        if problem := limits_problem(limits):
            raise LeaseRefused(f"a close needs limits: {problem}")
        self._check_probe(now, limits.dead)

    def _is_known(self, token: str) -> bool:
        """Return whether `token` is the lease's own; for a lease without token, the name suffices."""
        return not self._token or hmac.compare_digest(token.encode(), self._token.encode())

    def _check_probe(self, now: float, dead: bool) -> None:
        age = self.probe_age(now)
        if not age < PROBE_LIFETIME:
            state = "there is none since the last opening" if math.isinf(age) else f"it is {age:.1f} s old"
            raise LeaseRefused(f"a close needs a probe younger than {PROBE_LIFETIME:g} s, but {state}; call probe")
        problem = probe_problem(self.resistance, self.target_voltage, dead)
        if problem:
            raise LeaseRefused(problem)

    def take(
        self, holder: str, duration: float, now: float, token: str = "", limits: ChargeLimits | None = None
    ) -> float:
        """Grant or renew the lease.

        Args:
            holder: name of the client.
            duration: s; limited to 0.25.
            now: s.
            token: the holder's secret; a lease begun with a token is renewed only with it.
            limits: of the closing; a renewal uses only the current, 0 = unchanged.

        Returns:
            End of the lease, s.

        Raises:
            LeaseRefused: as in `check`.
        """
        self.check(holder, duration, now, token, limits)
        renewal = self.is_live(now)
        self.renewals += renewal
        self.holder = holder
        self._token = self._token if renewal else token
        self.until = now + min(duration, LONGEST_LEASE)
        return self.until

    def opened(self) -> None:
        """Record an opening, whatever its cause: the lease ends and the probe is void."""
        self.holder = self._token = ""
        self.until = -math.inf
        self._probed_at = -math.inf
        self.openings += 1
