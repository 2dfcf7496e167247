# SPDX-License-Identifier: Apache-2.0
"""Delayed commands and readings of the servos; not created if there is no delay."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from deltacharger_sim.parameters import ServoParameters

Command = tuple[int, bool, float, float, float, float]
State = tuple[float, float, float, float, float]

_ROUNDING = 1e-9  # s; sums of steps differ from their product by less


def delays(servo: ServoParameters) -> bool:
    """Return whether there is any delay; if not, this module is not used."""
    return servo.command_latency > 0.0 or servo.reading_latency > 0.0


class Latency:
    """Commands and readings in transit, in whole steps of the world: a delay ends with the step that reaches it."""

    def __init__(self, servo: ServoParameters) -> None:
        self._servo = servo
        self._commands: deque[tuple[float, Command]] = deque()
        self._states: deque[tuple[float, list[State]]] = deque()

    def command(self, now: float, command: Command) -> None:
        """Send a command at `now` s."""
        self._commands.append((now + self._servo.command_latency, command))

    def due(self, now: float) -> Iterator[Command]:
        """Yield the arrived commands in order."""
        while self._commands and self._commands[0][0] <= now + _ROUNDING:
            yield self._commands.popleft()[1]

    def keep(self, now: float, states: list[State]) -> None:
        """Store the servos' state at `now` s while it may still be read."""
        latest = now - self._servo.reading_latency + _ROUNDING
        self._states.append((now, states))
        while len(self._states) > 1 and self._states[1][0] <= latest:
            self._states.popleft()

    def state(self, index: int) -> State | None:
        """Return the reading of servo `index`: its newest state that is old enough; None before the first step."""
        return self._states[0][1][index] if self._states else None
