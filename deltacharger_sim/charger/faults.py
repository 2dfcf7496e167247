# SPDX-License-Identifier: Apache-2.0
"""Schedule faults of emulated hardware: from the scene, and on request while it runs."""

from __future__ import annotations

import functools
import heapq
import itertools
import logging
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from deltacharger_core.parameters import Bounded, ParameterError, number, words
from deltacharger_sim.charger.fault_kinds import KINDS, ONE, SERVOS, FaultOrder, Hardware, Kind, Undo

__all__ = ["KINDS", "Fault", "Faults", "Hardware"]
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Fault(Bounded):
    """One fault."""

    kind: str = words("", "one of " + ", ".join(KINDS))
    at: float = number(0.0, 0.0, 1e6, "s", "after the simulated charger's start")
    last: float = number(0.0, 0.0, 1e6, "s", "until it is over; 0 = for good")
    servo: int = number(0, 0, SERVOS, "", "id; 0 = servo 2 for a fault of one servo, all for a fault of several")
    amount: float | None = number(
        None, -math.inf, math.inf, "", "share 0 to 1, s, V, bit/s, id, taxel or fault code, depending on kind"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind not in KINDS:
            raise ParameterError("kind", self.kind, f"unknown fault {self.kind!r}: give one of {', '.join(KINDS)}")
        kind = KINDS[self.kind]
        if self.last and not kind.lasts:
            raise ParameterError("last", self.last, f"{self.kind} is momentary: leave out its duration")
        if self.servo and not kind.servo:
            raise ParameterError("servo", self.servo, f"{self.kind} does not affect a single servo: leave out servo")
        self._check_amount(kind)

    def _check_amount(self, kind: Kind) -> None:
        if self.amount is None:
            problem = ""
        elif kind.amount is None:
            problem = f"{self.kind} takes no amount"
        else:
            problem = kind.amount.problem(self.amount)
        if not problem and self.kind == "servo_duplicate_id" and self.whom == self.how_much:
            problem = f"servo {self.whom} already has that id: give another amount or servo"
        if problem:
            raise ParameterError("amount", self.amount, problem)

    @property
    def whom(self) -> int:
        """The affected servo, 0 = none in particular."""
        return self.servo or (2 if KINDS[self.kind].servo == ONE else 0)

    @property
    def how_much(self) -> float:
        """Its amount: the given one, else the kind's default; 0 if the kind has none."""
        amount = KINDS[self.kind].amount
        if self.amount is not None:
            return self.amount
        return 0.0 if amount is None else amount.default

    @property
    def key(self) -> tuple[str, int, float]:
        """Identifies a fault; a new fault replaces an active one with the same key."""
        return self.kind, self.whom, self.how_much if KINDS[self.kind].several else 0.0


@dataclass(frozen=True)
class _Active:
    fault: Fault
    undo: Undo
    until: float  # s on the clock; inf = until it is cleared


class Faults:
    """Causes and ends faults; thread-safe. Its thread exists only while an event is scheduled.

    An error in that thread is logged with the fault's kind; other faults continue as scheduled.

    Args:
        scheduled: faults of the scene, at times after now.
        hardware: to affect.
        clock: s, monotonic.
    """

    def __init__(self, scheduled: Sequence[Fault], hardware: Hardware, clock: Callable[[], float]) -> None:
        self._hardware = hardware
        self._clock = clock
        self._condition = threading.Condition(threading.RLock())
        self._active: dict[tuple[str, int, float], _Active] = {}
        self._later: list[tuple[float, int, str, Callable[[], None]]] = []
        self._numbers = itertools.count()
        self._stopping = False
        self._thread: threading.Thread | None = None
        start = clock()
        for fault in scheduled:
            self._plan(start + fault.at, fault.kind, functools.partial(self.begin, fault))

    def begin(self, fault: Fault) -> None:
        """Cause a fault now, regardless of its `at`; it ends after its `last`, or with `clear`."""
        kind = KINDS[fault.kind]
        with self._condition:
            self._end(fault.key)
            now = self._clock()
            undo = kind.apply(self._hardware, FaultOrder(fault.whom, fault.how_much, now))
            if undo is None:
                return
            until = now + fault.last if fault.last else float("inf")
            active = self._active[fault.key] = _Active(fault, undo, until)
            if fault.last:
                self._plan(until, f"the end of {fault.kind}", lambda: self._end(fault.key, active))

    def clear(self) -> None:
        """End all lasting faults; latched errors remain for the driver to clear."""
        with self._condition:
            for key in reversed(list(self._active)):
                self._end(key)

    def active(self) -> list[dict[str, Any]]:
        """Return the lasting faults: kind, servo and amount (None = has none), remaining_s (None = unlimited)."""
        with self._condition:
            now = self._clock()
            return [
                {
                    "kind": each.fault.kind,
                    "servo": each.fault.whom or None,
                    "amount": each.fault.how_much if KINDS[each.fault.kind].amount else None,
                    "remaining_s": max(each.until - now, 0.0) if each.fault.last else None,
                }
                for each in self._active.values()
            ]

    def close(self) -> None:
        """Cause no further faults. Safe to call twice."""
        with self._condition:
            self._stopping = True
            self._condition.notify_all()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _end(self, key: tuple[str, int, float], only: _Active | None = None) -> None:
        with self._condition:
            active = self._active.get(key)
            if active is not None and only in (None, active):
                del self._active[key]
                active.undo()

    def _plan(self, at: float, what: str, action: Callable[[], None]) -> None:
        with self._condition:
            heapq.heappush(self._later, (at, next(self._numbers), what, action))
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="faults", daemon=True)
                self._thread.start()
            self._condition.notify_all()

    def _run(self) -> None:
        with self._condition:
            while not self._stopping:
                wait = self._later[0][0] - self._clock() if self._later else None
                if wait is None or wait > 0.0:
                    self._condition.wait(wait)
                else:
                    self._do(*heapq.heappop(self._later)[2:])

    def _do(self, what: str, action: Callable[[], None]) -> None:
        try:
            action()
        except Exception:  # an impossible fault must not stop the others
            _log.exception("simulated fault failed: %s", what)
