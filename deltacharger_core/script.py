# SPDX-License-Identifier: Apache-2.0
"""Scripts: generators that read from top to bottom, as an algorithm does on paper, and never block.

A script yields once per tick and finds the world renewed when it goes on. What it yields says how long it only lets
time pass, so that a scheduler in virtual time may take longer steps; one in real time need not look at it. Docking and
the mission both stand on this.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Generator, Iterable
from typing import Generic, NamedTuple, Protocol, TypeVar

T = TypeVar("T")


class Wait(NamedTuple):
    """What a script waits for.

    Attributes:
        until: s; up to then it only lets time pass, as far as it knows; what interrupts it is looked at in steps.
        reads: whether it judges by the servos' readings made until then.
        nearing: m/s; it also ends at touch, and nears the target at this speed at most; 0 = it does not look for touch.
    """

    until: float = -math.inf
    reads: bool = False
    nearing: float = 0.0


NEXT = Wait()
"""The next tick."""
Script = Generator[Wait, None, T]


class Runner:
    """Steps one script at a time."""

    def __init__(self) -> None:
        self._script: Script[None] | None = None

    @property
    def is_running(self) -> bool:
        """Whether a script has been started and has not ended."""
        return self._script is not None

    def start(self, script: Script[None]) -> None:
        """Begin a script, in place of any other."""
        self.stop()
        self._script = script

    def stop(self) -> None:
        """Forget the script."""
        if self._script is not None:
            self._script.close()
        self._script = None

    def step(self, problem: Exception | None) -> Wait:
        """Let the script go on, or throw `problem` into it where it waits; return what it waits for now."""
        if self._script is None:
            return NEXT
        try:
            return next(self._script) if problem is None else self._script.throw(problem)
        except StopIteration:
            self._script = None
            return NEXT


class Numbered(Protocol):
    """A reply to the request of the same number."""

    @property
    def number(self) -> int:
        """Of the request."""


R = TypeVar("R", bound=Numbered)


class Calls(Generic[R]):
    """Requests under way, by their numbers, and the replies that have come; what nobody waits for is left out.

    Attributes:
        open: numbers of the requests without a reply.
    """

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._replies: dict[int, R] = {}
        self.open: set[int] = set()

    def number(self, awaited: bool = True) -> int:
        """Return the number of a new request."""
        number = next(self._numbers)
        if awaited:
            self.open.add(number)
        return number

    def hear(self, replies: Iterable[R]) -> None:
        """Take what came; the first reply of a number counts."""
        for reply in replies:
            if reply.number in self.open:
                self.open.discard(reply.number)
                self._replies[reply.number] = reply

    def take(self, number: int) -> R | None:
        """Return and forget the reply of a request; None = there is none yet."""
        return self._replies.pop(number, None)

    def forget(self) -> None:
        """Wait for nobody any more."""
        self.open.clear()
        self._replies.clear()
