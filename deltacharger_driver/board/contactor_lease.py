# SPDX-License-Identifier: Apache-2.0
"""Who may keep the contactor closed, and until when: pure logic, the clock is passed in.

A close is a lease of at most 0.25 s that its holder renews. When the lease lapses, the holder is dead or
hangs, and the contactor must be opened before anybody is served. Every opening, by whom or whatever, ends the
lease and voids the probe, so each close follows a measurement of the circuit that it closes.
"""

from __future__ import annotations

import hmac
import math

from deltacharger_core.machine import LONGEST_LEASE
from deltacharger_driver.board.payloads import probe_problem
from deltacharger_driver.board.protocol import PROBE_LIFETIME
from deltacharger_driver.errors import DriverError

LONGEST_NAME = 64
"""Characters of a holder's name and of its token."""


class LeaseRefused(DriverError, PermissionError):
    """A close or a renewal is refused. Example: another node holds the contactor.

    Its message says why not, and what to do.
    """


class ContactorLease:
    """The lease on the contactor and the probe that allows it.

    Not thread-safe: its owner calls it under one lock.

    Attributes:
        holder: who holds it; '' where nobody does.
        until: s, when it lapses unless renewed.
        openings: counts openings; who compares it across a wait knows whether the contactor was opened
            meanwhile.
        renewals: counts the leases that their holder prolonged.
        lapses: counts the leases that ran out; kept by the owner, who opens then.
        resistance: ohm, the last probe's result, void or not; NaN where none was made.
        target_voltage: V, the last probe's result.
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
        """Whether somebody holds the lease at `now` (s)."""
        return bool(self.holder) and now < self.until

    def has_lapsed(self, now: float) -> bool:
        """Whether a lease ran out without an opening since: open the contactor, then call `opened`."""
        return bool(self.holder) and now >= self.until

    def remaining(self, now: float) -> float:
        """Return the seconds until the lease lapses, 0 where it has, inf where there is none."""
        return max(self.until - now, 0.0) if self.holder else math.inf

    def probed(self, resistance: float, target_voltage: float, now: float) -> None:
        """Note a probe's result (ohm, V) at `now`."""
        self.resistance = resistance
        self.target_voltage = target_voltage
        self._probed_at = now

    def probe_age(self, now: float) -> float:
        """Return the seconds since the last probe that still counts; inf = never, or voided by an opening."""
        return now - self._probed_at

    def check(self, holder: str, duration: float, now: float, token: str = "") -> None:
        """Refuse what `take` would refuse, without changing anything.

        Raises:
            LeaseRefused: no name, a name or a token that is too long, no positive duration, lapsed and not yet opened,
                held by another or begun with another token, or, for a new lease, no probe younger than 2 s that allows
                a close.
        """
        for what, text in (("holder", holder), ("token", token)):
            if len(text) > LONGEST_NAME:
                raise LeaseRefused(f"the {what} has {len(text)} characters; give at most {LONGEST_NAME}")
        if not holder:
            raise LeaseRefused("the holder has no name; give one, so that others know who holds the contactor")
        if not duration > 0.0:  # also NaN
            raise LeaseRefused(f"a lease of {duration:g} s closes nothing; ask for up to {LONGEST_LEASE} s and renew")
        if self.has_lapsed(now):
            raise LeaseRefused(f"the lease of '{self.holder}' lapsed and the contactor is not open yet; ask again")
        if self.is_live(now):
            if holder != self.holder or not self._is_known(token):
                raise LeaseRefused(f"'{self.holder}' holds the contactor for another {self.remaining(now):.2f} s")
            return
        self._check_probe(now)

    def _is_known(self, token: str) -> bool:
        """Whether `token` is the one with which the lease began; a lease without one is held by its name alone."""
        return not self._token or hmac.compare_digest(token.encode(), self._token.encode())

    def _check_probe(self, now: float) -> None:
        age = self.probe_age(now)
        if not age < PROBE_LIFETIME:
            made = "there is none since the last opening" if math.isinf(age) else f"it is {age:.1f} s old"
            raise LeaseRefused(f"a close needs a probe younger than {PROBE_LIFETIME:g} s, but {made}; call probe")
        problem = probe_problem(self.resistance, self.target_voltage)
        if problem:
            raise LeaseRefused(problem)

    def take(self, holder: str, duration: float, now: float, token: str = "") -> float:
        """Grant or renew the lease.

        Args:
            holder: who asks.
            duration: s; cut to 0.25.
            now: s.
            token: the holder's secret: who begins a lease with one renews it with the same.

        Returns:
            Until when it lasts, s.

        Raises:
            LeaseRefused: as in `check`.
        """
        self.check(holder, duration, now, token)
        renewal = self.is_live(now)
        self.renewals += renewal
        self.holder = holder
        self._token = self._token if renewal else token
        self.until = now + min(duration, LONGEST_LEASE)
        return self.until

    def opened(self) -> None:
        """Note that the contactor was opened, by whom or whatever: the lease ends and the probe is void."""
        self.holder = self._token = ""
        self.until = -math.inf
        self._probed_at = -math.inf
        self.openings += 1
