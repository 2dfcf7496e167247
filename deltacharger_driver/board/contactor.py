# SPDX-License-Identifier: Apache-2.0
"""Who keeps the contactor closed: the lease and its guard. No ROS.

Energy never depends on a live host. The guard relays a live lease as the board's heartbeat and never sends a heartbeat
without one. Both have the same deadline, so the heartbeat stops in time even if the guard hangs.
"""

import contextlib
import hmac
import math
import threading
import time
from collections import deque
from collections.abc import Callable

from deltacharger_core.machine import CONTACT_FORCE, LONGEST_LEASE, PROBE_LIFETIME, ChargeLimits
from deltacharger_driver.board import protocol
from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.board.protocol import BoardFault, CommandRefused, PowerSample, ProbeResult, TactileSample
from deltacharger_driver.errors import DriverError, NoAnswer

LONGEST_NAME = 64
"""Largest length of a holder's name and of its token."""

STALE_FRAME = 0.1  # s; a frame sampled longer ago does not show contact now
_STALE_IN_LEASE = LONGEST_LEASE  # s, the same during a lease
STALE_POWER = 0.5  # s
_FRAMES = 32  # kept; at the highest rate 20 arrive within STALE_FRAME
_CONFIRM_TIME = 0.3  # s to see the contactor open after the board accepted the command


class LeaseRefused(DriverError, PermissionError):
    """A close or a renewal is refused. Example: another node holds the contactor."""


class ContactorLease:
    """The lease that keeps the contactor closed, and the probe that allows it.

    A close is a lease of at most 0.25 s that its holder renews. A lapsed lease means that the holder is dead or hangs;
    the contactor must then be opened before any other request is served. Every opening, whatever its cause, ends the
    lease and voids the probe. So each close follows a look at the port that it closes on. Its limits bind until the
    opening; a renewal may change the current.

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
            low, high = protocol.LIMITS["current"]
            current = 0.0 if limits is None else limits.current
            if current != 0.0 and not low <= current <= high:  # also NaN
                raise LeaseRefused(f"current is {current:g}: give {low:g} to {high:g}, or 0 to leave it")
            return
        if limits is None:
            raise LeaseRefused("a close needs limits of current and voltage: give current_max and voltage_max")
        if problem := protocol.limits_problem(limits):
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
        problem = protocol.probe_problem(self.resistance, self.target_voltage, dead)
        if problem:
            raise LeaseRefused(problem)

    def grant(
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


class ContactorGuard:
    """Serves closes, openings and probes, and ends the lease on every opening or fault.

    Thread-safe. `observe_*` are called in the link's reader thread and never wait; the others may wait for the board.

    A close needs fresh tactile frames with contact: any live taxel at 1 N or more on at least one pad within the last
    0.1 s. TARE of the board uses the same criterion. One pad suffices, because a misaligned ridge may miss the other. A
    first close also needs limits, and a fresh probe that allows it. A renewal may see the frames late by up to the
    lease, because a stall of this computer does no harm for so long; it needs contact in the last 0.1 s of them.

    Args:
        link: to the board.
        on_lease: called when a lease begins, so that the owner calls `tick` when it lapses.
        clock: s; the one of the samples' times and of the link's heartbeat.
    """

    def __init__(
        self,
        link: BoardLink,
        on_lease: Callable[[], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._link = link
        self._on_lease = on_lease
        self._clock = clock
        self._lease = ContactorLease()
        self._lock = threading.Lock()  # lease and observations; never held while waiting
        self._commands = threading.Lock()  # one contactor command at a time
        self._probing = threading.Lock()  # one probe at a time, and none during a close
        self._power_seen = threading.Condition(self._lock)
        self._frames: deque[TactileSample] = deque(maxlen=_FRAMES)
        self._power: PowerSample | None = None
        self._was_closed = False
        self._current = 0.0  # A, the largest that the board was told
        self._welded = False  # even if the board reboots or is replaced
        self._shut = False
        self._refused = 0  # closes, since the start
        self._last_refusal = ""

    def lease_record(self) -> dict[str, object]:
        """Return holder and remaining time of the lease, and counts since the start, for diagnostics."""
        with self._lock:
            lease, now = self._lease, self._clock()
            live = lease.is_live(now)
            return {
                "holder": lease.holder if live else "",
                "lease_left": f"{lease.remaining(now) if live else 0.0:.3f} s",
                "lease_renewals": lease.renewals,
                "lease_lapses": lease.lapses,
                "openings": lease.openings,
                "refused_closes": self._refused,
                "last_refusal": self._last_refusal,
            }

    def probe_record(self) -> tuple[float, float]:
        """Return the last probe's ohm (NaN = none) and its age in s (inf = none, or voided by an opening)."""
        with self._lock:
            return self._lease.resistance, self._lease.probe_age(self._clock())

    def remaining(self) -> float:
        """Return the seconds until `tick` is due; inf without a lease."""
        with self._lock:
            return self._lease.remaining(self._clock())

    def observe_tactile(self, sample: TactileSample) -> None:
        """Record a tactile frame."""
        with self._lock:
            self._frames.append(sample)

    def observe_power(self, sample: PowerSample) -> None:
        """Record a sample of the power stage; end the lease if the board opened on its own."""
        with self._power_seen:
            before, self._power = self._power, sample
            power = sample.power
            self._welded |= power.fault == BoardFault.CONTACTOR_WELDED
            new_fault = power.fault != 0 and (before is None or before.power.fault != power.fault)
            fell = self._was_closed and not power.contactor_closed
            self._was_closed = power.contactor_closed
            opened = new_fault or (bool(self._lease.holder) and (fell or power.fault != 0))
            if opened:
                self._lease.opened()
            self._power_seen.notify_all()
        if opened:
            self._link.stop_heartbeat()

    def interrupted(self) -> None:
        """Handle a vanished port or a reboot of the board: the contactor opens or is open."""
        with self._lock:
            self._lease.opened()
            self._frames.clear()
            self._power = None
            self._was_closed = False
        self._link.stop_heartbeat()

    def close(self, holder: str, duration: float, token: str = "", limits: ChargeLimits | None = None) -> float:
        """Close the contactor for a lease, or renew it. A close waits for a running probe.

        Args:
            holder: name of the client.
            duration: s; limited to 0.25.
            token: the holder's secret; a lease begun with a token is renewed only with it. '' = the name suffices.
            limits: of the closing; a renewal uses only the current, 0 = unchanged.

        Returns:
            Remaining time of the lease, s.

        Raises:
            LeaseRefused: another holder, no contact, stale frames, no limits, no fresh probe, a short …; nothing was
                closed.
            CommandRefused: an interlock of the board.
            DriverError: the board cannot be reached.
        """
        try:
            with self._commands:  # refuse without waiting for a probe
                self._open_if_lapsed()
                with self._lock:
                    self._check(holder, duration, token, limits, self._clock())
            with self._probing:
                return self._close(holder, duration, token, limits)
        except DriverError as error:
            with self._lock:
                self._refused += 1
                self._last_refusal = str(error)
            raise

    def _close(self, holder: str, duration: float, token: str, limits: ChargeLimits | None) -> float:
        with self._commands:
            self._open_if_lapsed()
            with self._lock:
                now = self._clock()
                renewal = self._lease.is_live(now)
                self._check(holder, duration, token, limits, now)
                until = self._lease.grant(holder, duration, now, token, limits)
                openings = self._lease.openings
                if not renewal:
                    self._was_closed = False  # until the board reports it, pre-charge runs
            if not renewal:
                assert limits is not None  # the lease refuses a close without
                self._begin(until, limits)
            else:
                self._link.keep_alive(until)
                if limits is not None:
                    self._limit(limits.current)
            with self._lock:
                if self._lease.openings == openings:
                    return until - now
        self._link.stop_heartbeat()  # the contactor was opened in between; keep_alive must not outlive that
        raise LeaseRefused("the contactor was opened during this request; probe and close again")

    def _check(self, holder: str, duration: float, token: str, limits: ChargeLimits | None, now: float) -> None:
        self._check_board(now)
        self._lease.check(holder, duration, now, token, limits)
        self._check_contact(now)

    def latched_fault(self) -> str:
        """Return the latched fault and how to clear it; '' if there is none. A weld stays over boards that forget."""
        power = self._power
        fault = int(BoardFault.CONTACTOR_WELDED) if self._welded else power.power.fault if power is not None else 0
        return f"latched fault: {protocol.fault_name(fault)}; {protocol.clearing(fault)}" if fault else ""

    def _check_board(self, now: float) -> None:
        power = self._power
        if self._shut:
            raise LeaseRefused("the node is shutting down")
        if latched := self.latched_fault():
            raise LeaseRefused(latched)
        if power is None or not now - power.time <= STALE_POWER:
            raise LeaseRefused("the power stage sends no data; check the board")

    def _check_contact(self, now: float) -> None:
        newest = self._frames[-1].time if self._frames else -math.inf
        age, renewal = now - newest, self._lease.is_live(now)
        if age > (_STALE_IN_LEASE if renewal else STALE_FRAME):
            age_text = "none received" if math.isinf(age) else f"the last is {age * 1e3:.0f} ms old"
            raise LeaseRefused(f"tactile frames are stale ({age_text}); contact is not confirmed")
        since = (newest if renewal else now) - STALE_FRAME
        if not any(_in_contact(sample) for sample in reversed(self._frames) if sample.time >= since):
            raise LeaseRefused(f"no contact: no taxel reads {CONTACT_FORCE:g} N on either pad; dock first")

    def _begin(self, until: float, limits: ChargeLimits) -> None:
        if self._on_lease is not None:
            self._on_lease()
        try:
            self._link.keep_alive(until)
            self._link.contactor(True, limits)
            self._current = limits.current
        except DriverError as error:
            self._end_lease()
            if isinstance(error, NoAnswer):  # after a refusal, an opening would clear a fault that must stay visible
                with contextlib.suppress(DriverError):
                    self._link.contactor(False)  # the board may have closed
            raise

    def _limit(self, current: float) -> None:
        """Tell the board another largest current (A, 0 = unchanged), once it reports the contactor closed."""
        if current and current != self._current and self._was_closed:
            self._link.limit_current(current)
            self._current = current

    def _end_lease(self) -> None:
        with self._lock:
            self._lease.opened()
        self._link.stop_heartbeat()

    def open(self) -> None:
        """Open the contactor, whatever its holder, and clear the latched fault, but no weld.

        Raises:
            NoAnswer, PortGone: not acknowledged; the heartbeat has stopped, so the board opens within 100 ms.
        """
        self._end_lease()  # before waiting for anything
        with self._commands:
            self._end_lease()  # a concurrent close may have begun a lease
            self._link.contactor(False)

    def clear_weld(self) -> None:
        """Clear a latched weld for a person who has replaced the contactor.

        Raises:
            LeaseRefused: something is still live; the message names it.
            CommandRefused, NoAnswer, PortGone: as for `BoardLink.clear_weld`.
        """
        with self._commands:
            try:
                self._link.clear_weld()
            except CommandRefused as error:
                power = self._power
                live = protocol.weld_problem(power.power) if power is not None else ""
                if error.error != protocol.AckError.INTERLOCK or not live:
                    raise
                raise LeaseRefused(f"the weld stays latched: {live}; undock and switch the battery off") from error
            with self._lock:
                self._welded = False

    def tick(self) -> None:
        """Open the contactor if the lease has lapsed; call it after `remaining` s."""
        with self._commands:
            self._open_if_lapsed()

    def _open_if_lapsed(self) -> None:
        with self._lock:
            lapsed = self._lease.has_lapsed(self._clock())
            self._lease.lapses += lapsed
        if lapsed:
            self._end_lease()
            self._link.contactor(False)

    def probe(self) -> ProbeResult:
        """Measure the circuit between the electrodes; takes up to 250 ms. Another caller waits.

        Raises:
            LeaseRefused: the contactor is closed, a weld is latched, or an opening voided the result.
            CommandRefused: an interlock of the board.
            DriverError: the board cannot be reached.
        """
        with self._probing:
            return self._measure()

    def _measure(self) -> ProbeResult:
        with self._commands:
            self._open_if_lapsed()
        with self._lock:
            if self._welded:
                raise LeaseRefused(self.latched_fault())
            if self._lease.is_live(self._clock()):
                raise LeaseRefused(f"'{self._lease.holder}' keeps the contactor closed; open it, then probe")
            openings = self._lease.openings
        result = self._link.probe()
        with self._lock:
            if self._lease.openings != openings:
                raise LeaseRefused("the contactor was opened during the probe, which voids it; probe again")
            self._lease.probed(result.resistance, result.target_voltage, result.time)
        return result

    def shut_down(self) -> bool:
        """Open for the last time and wait until the board reports it.

        If the contactor is known to be open, no command is sent: a latched fault stays visible to the next client.

        Returns:
            Whether the board reported it open.
        """
        with self._lock:
            self._shut = True
            now = self._clock()
            power = self._power
            fresh = power is not None and now - power.time <= STALE_POWER
            if fresh and power is not None and not power.power.contactor_closed and not self._lease.holder:
                return True
        self.open()
        opened_at = self._clock()

        def is_seen() -> bool:
            power = self._power
            return power is not None and power.time >= opened_at and not power.power.contactor_closed

        with self._power_seen:
            return self._power_seen.wait_for(is_seen, _CONFIRM_TIME)


def _in_contact(sample: TactileSample) -> bool:
    """Return whether a live taxel reads contact."""
    return bool((sample.pads >= CONTACT_FORCE).any())
