# SPDX-License-Identifier: Apache-2.0
"""Decide from docking_state when a record of a docking begins, is quiet and ends.

The caller passes the time (s, monotonic).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from deltacharger_docking.codes import State

TAIL = 1.0  # s after the arm is home: result, status and last frames still belong to the docking
LOST_AFTER = 5.0  # s without a publisher of docking_state


@dataclass(frozen=True)
class Seen:
    """Content of docking_state."""

    state: int
    docked: bool
    charging: bool
    code: int
    message: str
    request_id: str

    @property
    def at_home(self) -> bool:
        """Whether nothing is in progress."""
        return self.state == State.IDLE and not self.docked

    @property
    def quiet(self) -> bool:
        """Whether this state may last for hours."""
        return self.docked and self.state in (State.CHARGING, State.IDLE)


class Session:
    """Consecutive dockings, as docking_state reports them.

    Attributes:
        last: newest docking_state.
        under_way: whether a docking is being recorded.
        went_out: whether the arm did more than return home.
        arrived: whether it docked.
    """

    def __init__(self) -> None:
        self.last: Seen | None = None
        self.under_way = self.went_out = self.arrived = False
        self._home_since = math.inf
        self._lost_since = math.inf
        self._kinds: set[str] = set()

    def begins(self, seen: Seen) -> bool:
        """Whether docking_state belongs to a docking that is not recorded yet."""
        return not seen.at_home and (not self.under_way or self._home_since < math.inf)

    def begin(self) -> None:
        """Note that a record has begun."""
        self.under_way, self.went_out, self.arrived = True, False, False
        self._home_since = self._lost_since = math.inf

    def end(self) -> None:
        """Note that the record has ended."""
        self.under_way = False
        self._home_since = math.inf

    def see(self, now: float, seen: Seen) -> None:
        """Take docking_state."""
        if self.last is None or (seen.state, seen.docked) != (self.last.state, self.last.docked):
            self._kinds = set()
        self.last = seen
        self.went_out |= seen.docked or seen.state not in (State.IDLE, State.RETRACT)
        self.arrived |= seen.docked
        self._home_since = min(self._home_since, now) if seen.at_home else math.inf

    def is_news(self, kind: str) -> bool:
        """Whether a decision is the first of its kind in the present state; routine decisions are not events."""
        known = kind in self._kinds
        self._kinds.add(kind)
        return not known

    def note_publisher(self, now: float, alive: bool) -> None:
        """Note whether docking_state has a publisher."""
        self._lost_since = math.inf if alive else min(self._lost_since, now)

    def is_over(self, now: float) -> bool:
        """Whether the record is complete."""
        return self.under_way and (now - self._home_since >= TAIL or now - self._lost_since >= LOST_AFTER)
