# SPDX-License-Identifier: Apache-2.0
"""Commands that reach a servo late and readings that are old; a world without either never makes one of these."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from deltacharger_sim.parameters import ServoParameters

Command = tuple[int, bool, float, float, float]
State = tuple[float, float, float, float, float]

_ROUNDING = 1e-9  # s; sums of steps differ from their product by less


def delays(servo: ServoParameters) -> bool:
    """Return whether anything is late; if not, none of this module runs."""
    return servo.command_latency > 0.0 or servo.reading_latency > 0.0


class Latency:
    """What is under way to and from the servos, in whole steps of the world: a delay ends with the step that reaches
    it."""

    def __init__(self, servo: ServoParameters) -> None:
        self._servo = servo
        self._commands: deque[tuple[float, Command]] = deque()
        self._states: deque[tuple[float, list[State]]] = deque()

    def command(self, now: float, command: Command) -> None:
        """Send a command off at `now` s."""
        self._commands.append((now + self._servo.command_latency, command))

    def due(self, now: float) -> Iterator[Command]:
        """Yield the commands that have arrived, in their order."""
        while self._commands and self._commands[0][0] <= now + _ROUNDING:
            yield self._commands.popleft()[1]

    def keep(self, now: float, states: list[State]) -> None:
        """Remember the servos' state at `now` s as long as somebody may still read it."""
        latest = now - self._servo.reading_latency + _ROUNDING
        self._states.append((now, states))
        while len(self._states) > 1 and self._states[1][0] <= latest:
            self._states.popleft()

    def state(self, index: int) -> State | None:
        """Return what servo `index` tells: its newest state that is old enough; None before the first step."""
        return self._states[0][1][index] if self._states else None
