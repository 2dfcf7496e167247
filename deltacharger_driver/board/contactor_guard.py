# SPDX-License-Identifier: Apache-2.0
"""Who gets the contactor closed: the lease joined to what the board reports. No ROS; tactile_node wraps it.

Energy never depends on a live host. The guard relays a live lease as the board's heartbeat and never invents one:
the heartbeat's deadline is the lease's, so whatever hangs here, it stops in time.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_driver.board.contactor_lease import ContactorLease, LeaseRefused
from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.board.protocol import fault_name
from deltacharger_driver.board.samples import PowerSample, ProbeResult, TactileSample
from deltacharger_driver.board.shared_call import SharedCall
from deltacharger_driver.errors import DriverError, NoAnswer

STALE_FRAME = 0.1  # s; a frame sampled longer ago says nothing about contact now
STALE_POWER = 0.5  # s
_PROBE_SHARED = 0.05  # s that a probe counts for later callers, where several waited for it
_FRAMES = 32  # kept; more than the 20 that come in STALE_FRAME at the highest rate
_CONFIRM_TIME = 0.3  # s to see the contactor open after the board accepted the command


class ContactorGuard:
    """Serves closes, openings and probes, and ends the lease on everything that ends it.

    Thread-safe. `observe_*` are called in the link's reader thread and never wait; the others may wait for the board.

    A close or a renewal needs fresh tactile frames with contact: any live taxel at 1 N or more on at least one pad
    within the last 0.1 s (the board's own notion of contact in TARE; both pads are not asked for, because a
    misaligned ridge may miss one). A first close also needs a fresh probe that allows it.

    Args:
        link: to the board.
        on_lease: called when a lease begins, so that somebody calls `tick` when it lapses.
    """

    def __init__(
        self,
        link: BoardLink,
        on_lease: Callable[[], None] | None = None,
    ) -> None:
        self._link = link
        self._on_lease = on_lease
        self._lease = ContactorLease()
        self._lock = threading.Lock()  # lease and observations; never held while waiting
        self._commands = threading.Lock()  # one contactor command at a time
        self._probe = SharedCall(self._measure, _PROBE_SHARED)
        self._power_seen = threading.Condition(self._lock)
        self._frames: deque[TactileSample] = deque(maxlen=_FRAMES)
        self._power: PowerSample | None = None
        self._was_closed = False
        self._shut = False
        self._refused = 0  # closes, since the start
        self._last_refusal = ""

    @property
    def holder(self) -> str:
        """Who holds the lease, '' where nobody does."""
        with self._lock:
            return self._lease.holder if self._lease.is_live(time.monotonic()) else ""

    def lease_record(self) -> dict[str, object]:
        """Return who holds the contactor for how long, and what became of the leases since the start, to be told."""
        with self._lock:
            lease, now = self._lease, time.monotonic()
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
            return self._lease.resistance, self._lease.probe_age(time.monotonic())

    def remaining(self) -> float:
        """Return the seconds until `tick` is due; inf where there is no lease."""
        with self._lock:
            return self._lease.remaining(time.monotonic())

    def observe_tactile(self, sample: TactileSample) -> None:
        """Take note of a tactile frame."""
        with self._lock:
            self._frames.append(sample)

    def observe_power(self, sample: PowerSample) -> None:
        """Take note of the power stage; the lease ends where the board has opened by itself."""
        with self._power_seen:
            before, self._power = self._power, sample
            power = sample.power
            new_fault = power.fault != 0 and (before is None or before.power.fault != power.fault)
            fell = self._was_closed and not power.contactor_closed
            self._was_closed = power.contactor_closed
            opened = new_fault or (bool(self._lease.holder) and (fell or power.fault != 0))
            if opened:
                self._opened()
            self._power_seen.notify_all()
        if opened:
            self._link.stop_heartbeat()

    @property
    def was_closed(self) -> bool:
        """Whether the board reported the contactor closed last."""
        with self._lock:
            return self._was_closed

    def interrupted(self) -> None:
        """Take note that the port vanished or the board rebooted: the contactor opens or is open."""
        with self._lock:
            self._opened()
            self._frames.clear()
            self._power = None
            self._was_closed = False
        self._link.stop_heartbeat()

    def close(self, holder: str, duration: float, token: str = "") -> float:
        """Close the contactor for a lease, or renew it. A close waits for a probe under way and goes before the next.

        Args:
            holder: who asks.
            duration: s; cut to 0.25.
            token: the holder's secret, which renews the lease that it began; '' = the name is enough.

        Returns:
            s that the lease lasts from now.

        Raises:
            LeaseRefused: another holder, no contact, stale frames, no fresh probe, a short …; nothing was closed.
            CommandRefused: an interlock of the board.
            DriverError: the board cannot be reached.
        """
        try:
            with self._commands:  # what would be refused waits for nothing
                self._open_if_lapsed()
                with self._lock:
                    self._check(holder, duration, token, time.monotonic())
            with self._probe:
                return self._close(holder, duration, token)
        except DriverError as error:
            with self._lock:
                self._refused += 1
                self._last_refusal = str(error)
            raise

    def _close(self, holder: str, duration: float, token: str) -> float:
        with self._commands:
            self._open_if_lapsed()
            with self._lock:
                now = time.monotonic()
                renewal = self._lease.is_live(now)
                self._check(holder, duration, token, now)
                until = self._lease.take(holder, duration, now, token)
                openings = self._lease.openings
                if not renewal:
                    self._was_closed = False  # until the board reports it, pre-charge runs
            if renewal:
                self._link.keep_alive(until)
            else:
                self._begin(until)
            with self._lock:
                if self._lease.openings == openings:
                    return until - now
        self._link.stop_heartbeat()  # an opening came in between; keep_alive must not outlive it
        raise LeaseRefused("the contactor was opened meanwhile; probe and ask again")

    def _check(self, holder: str, duration: float, token: str, now: float) -> None:
        self._check_board(now)
        self._lease.check(holder, duration, now, token)
        self._check_contact(now)

    def _opened(self) -> None:
        """Note an opening, under the lock."""
        self._lease.opened()
        self._probe.forget()

    def _check_board(self, now: float) -> None:
        power = self._power
        if self._shut:
            raise LeaseRefused("the node is shutting down")
        if power is None or now - power.time > STALE_POWER:
            raise LeaseRefused("the power stage is silent; check the board")
        if power.power.fault:
            fault = fault_name(power.power.fault)
            raise LeaseRefused(f"the board opened and latched a fault: {fault}; open to clear it, then probe")

    def _check_contact(self, now: float) -> None:
        age = now - self._frames[-1].time if self._frames else math.inf
        if age > STALE_FRAME:
            told = "there are none" if math.isinf(age) else f"the last is {age * 1e3:.0f} ms old"
            raise LeaseRefused(f"tactile frames are stale ({told}); nothing shows that the electrodes touch")
        if not any(_feels(sample) for sample in reversed(self._frames) if now - sample.time <= STALE_FRAME):
            raise LeaseRefused(f"no contact: no taxel reads {CONTACT_FORCE:g} N on either pad; dock first")

    def _begin(self, until: float) -> None:
        if self._on_lease is not None:
            self._on_lease()
        try:
            self._link.keep_alive(until)
            self._link.contactor(True)
        except DriverError as error:
            self._end_lease()
            if isinstance(error, NoAnswer):  # after a refusal an open would clear a fault that somebody should see
                with contextlib.suppress(DriverError):
                    self._link.contactor(False)  # the close may have been carried out
            raise

    def _end_lease(self) -> None:
        with self._lock:
            self._opened()
        self._link.stop_heartbeat()

    def open(self) -> None:
        """Open the contactor, whoever holds it, and clear the latched fault.

        Raises:
            NoAnswer, PortGone: not acknowledged; the heartbeat has stopped, so the board opens within 100 ms.
        """
        self._end_lease()  # before waiting for anything
        with self._commands:
            self._end_lease()  # a close that was being served may have begun a lease since
            self._link.contactor(False)

    def tick(self) -> None:
        """Open the contactor where the lease has lapsed; call it when `remaining` has passed."""
        with self._commands:
            self._open_if_lapsed()

    def _open_if_lapsed(self) -> None:
        with self._lock:
            lapsed = self._lease.has_lapsed(time.monotonic())
            self._lease.lapses += lapsed
        if lapsed:
            self._end_lease()
            self._link.contactor(False)

    def probe(self) -> ProbeResult:
        """Measure the circuit between the electrodes; up to 250 ms. Who comes meanwhile gets the same result.

        Raises:
            LeaseRefused: the contactor is closed, or an opening voided the result.
            CommandRefused: an interlock of the board.
            DriverError: the board cannot be reached.
        """
        return self._probe()

    def _measure(self) -> ProbeResult:
        with self._commands:
            self._open_if_lapsed()
        with self._lock:
            if self._lease.is_live(time.monotonic()):
                raise LeaseRefused(f"'{self._lease.holder}' keeps the contactor closed; open it, then probe")
            openings = self._lease.openings
        result = self._link.probe()
        with self._lock:
            if self._lease.openings != openings:
                raise LeaseRefused("the contactor was opened meanwhile, which voids the probe; probe again")
            self._lease.probed(result.resistance, result.target_voltage, result.time)
        return result

    def shut_down(self) -> bool:
        """Open for good and wait until the board reports it.

        A contactor that is known to be open is left alone, so that a latched fault survives for who comes next.

        Returns:
            Whether the contactor was seen open.
        """
        with self._lock:
            self._shut = True
            now = time.monotonic()
            power = self._power
            fresh = power is not None and now - power.time <= STALE_POWER
            if fresh and power is not None and not power.power.contactor_closed and not self._lease.holder:
                return True
        self.open()
        opened_at = time.monotonic()
        with self._power_seen:
            return self._power_seen.wait_for(lambda: self._seen_open_since(opened_at), _CONFIRM_TIME)

    def _seen_open_since(self, instant: float) -> bool:
        power = self._power
        return power is not None and power.time >= instant and not power.power.contactor_closed


def _feels(sample: TactileSample) -> bool:
    """Whether a live taxel feels contact."""
    return bool((sample.pads >= CONTACT_FORCE).any())
