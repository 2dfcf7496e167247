# SPDX-License-Identifier: Apache-2.0
"""What the log says while the machine works: a line for each phase, each failure, and each switch of the contactor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from deltacharger_core.quantity import figure
from deltacharger_core.texts import passage
from deltacharger_docking.codes import Code, State
from deltacharger_docking.observation import DockingStatus, Observation


def changes(before: State, passed: Sequence[State], now: State) -> list[State]:
    """Return the states to tell after `before`: those passed through within one tick, then the present one."""
    return [state for last, state in pairwise((before, *passed, now)) if state is not last]


class PhaseLog:
    """Turns what the machine tells into lines; without a change there is none.

    Every line begins with the title of the goal that was taken last: what happens after its end, such as the end of
    charging, belongs to it.
    """

    def __init__(self) -> None:
        self._title = "docking"
        self._state, self._since = State.IDLE, math.nan
        self._code = Code.NONE
        self._closed, self._closed_since = False, math.nan

    def begin(self, title: str) -> None:
        """Take the title of a goal that begins."""
        self._title, self._code = title, Code.NONE

    def lines(self, status: DockingStatus, passed: Sequence[State], seen: Observation) -> list[str]:
        """Return what is new.

        Args:
            status: of the machine.
            passed: states entered since the last call, in their order.
            seen: the observation that the machine was stepped with.
        """
        told = []
        if seen.contactor_closed is not self._closed:
            told.append(self._switched(seen))
        if passed or status.state is not self._state or status.code is not self._code:
            told += self._passages(status, changes(self._state, passed, status.state), seen)
        return told

    def _switched(self, seen: Observation) -> str:
        self._closed = seen.contactor_closed
        if self._closed:
            self._closed_since = seen.time
            return f"{self._title}: contactor closed, target {figure(seen.target_voltage, 'V', 1)}"
        return f"{self._title}: contactor open after {seen.time - self._closed_since:.1f} s"

    def _passages(self, status: DockingStatus, entered: Sequence[State], seen: Observation) -> list[str]:
        news = self._news(status)
        back = entered.index(State.RETRACT) if State.RETRACT in entered else len(entered) - 1  # where a failure leads
        told = []
        for index, state in enumerate(entered):
            lasted = math.nan if self._state is State.IDLE else seen.time - self._since
            about = news if index == back else []
            told.append(passage(self._title, self._state.name, state.name, lasted, *about, *_figures(status, seen)))
            self._state, self._since = state, seen.time
        if news and not entered:
            told.append(f"{self._title}: {self._state.name.lower()}, {news[0]}")
        return told

    def _news(self, status: DockingStatus) -> list[str]:
        """Return in words that a code has come or gone."""
        before, self._code = self._code, status.code
        if status.code is before:
            return []
        return [f"{int(status.code)} {status.code.name}: {status.message}"] if status.code else ["docking again"]


def _figures(status: DockingStatus, seen: Observation) -> list[str]:
    """Return what is measured now, in words; nothing of what is not."""
    values = (
        ("z", 1e3 * status.position[2], "mm", 1),
        ("contact current", status.contact_current, "A", 3),
        ("force", status.contact_force, "N", 1),
        ("charge current", seen.charge_current if seen.contactor_closed else math.nan, "A", 2),
    )
    return [f"{name} {figure(value, unit, digits)}" for name, value, unit, digits in values if math.isfinite(value)]
