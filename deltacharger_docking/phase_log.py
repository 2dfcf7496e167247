# SPDX-License-Identifier: Apache-2.0
"""Log lines of docking: one for each phase, each failure, and each switching of the contactor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from deltacharger_core.quantity import figure
from deltacharger_core.texts import passage
from deltacharger_docking.codes import Code, State
from deltacharger_docking.observation import DockingStatus, Observation

_WANTED = (Code.NONE, Code.CANCELED)


def changes(before: State, passed: Sequence[State], now: State) -> list[State]:
    """Return the states to report after `before`: those passed through within one tick, then the present one."""
    return [state for last, state in pairwise((before, *passed, now)) if state is not last]


class PhaseLog:
    """Turns changes of the machine into log lines.

    Every line begins with the title of the last goal. Later events, such as the end of charging, belong to that goal.

    Attributes:
        lost: which of the last lines tells that a failure has ended charging, or the rest on a target; '' = none.
    """

    def __init__(self) -> None:
        self._title, self.lost = "docking", ""
        self._state, self._since = State.IDLE, math.nan
        self._code = Code.NONE
        self._closed, self._closed_since = False, math.nan

    def begin(self, title: str) -> None:
        """Set the title of a goal that begins."""
        self._title, self._code = title, Code.NONE

    def lines(self, status: DockingStatus, passed: Sequence[State], seen: Observation) -> list[str]:
        """Return the lines for what changed.

        Args:
            status: of the machine.
            passed: states entered since the last call, in their order.
            seen: the observation that the machine was stepped with.
        """
        lines, self.lost = [], ""
        if seen.contactor_closed is not self._closed:
            lines.append(self._switched(seen))
        if passed or status.state is not self._state or status.code is not self._code:
            lines += self._passages(status, changes(self._state, passed, status.state), seen)
        return lines

    def _switched(self, seen: Observation) -> str:
        self._closed = seen.contactor_closed
        if self._closed:
            self._closed_since = seen.time
            return f"{self._title}: contactor closed, target {figure(seen.target_voltage, 'V', 1)}"
        return f"{self._title}: contactor open, it was closed for {seen.time - self._closed_since:.1f} s"

    def _passages(self, status: DockingStatus, entered: Sequence[State], seen: Observation) -> list[str]:
        news = self._news(status)
        back = entered.index(State.RETRACT) if State.RETRACT in entered else len(entered) - 1  # a failure leads there
        lines = []
        for index, state in enumerate(entered):
            lasted = math.nan if self._state is State.IDLE else seen.time - self._since
            about = news if index == back else []
            lines.append(passage(self._title, self._state.name, state.name, lasted, *about, *_figures(status, seen)))
            rested = status.docked and self._state in (State.CHARGING, State.IDLE)
            self.lost = lines[-1] if about and rested and status.code not in _WANTED else self.lost
            self._state, self._since = state, seen.time
        if news and not entered:
            lines.append(f"{self._title}: {self._state.name.lower()}, {news[0]}")
        return lines

    def _news(self, status: DockingStatus) -> list[str]:
        """Return the message that a code was set or cleared."""
        before, self._code = self._code, status.code
        if status.code is before:
            return []
        return [f"{int(status.code)} {status.code.name}: {status.message}"] if status.code else ["docking again"]


def _figures(status: DockingStatus, seen: Observation) -> list[str]:
    """Return the present measurements as text, without unknown ones."""
    values = (
        ("z", 1e3 * status.position[2], "mm", 1),
        ("contact current", status.contact_current, "A", 3),
        ("force", status.contact_force, "N", 1),
        ("charge current", seen.charge_current if seen.contactor_closed else math.nan, "A", 2),
    )
    return [f"{name} {figure(value, unit, digits)}" for name, value, unit, digits in values if math.isfinite(value)]
