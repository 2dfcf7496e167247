# SPDX-License-Identifier: Apache-2.0
"""Scripts: generators that read from top to bottom like an algorithm on paper, and never block.

A script yields once per tick and sees updated inputs when it continues. The yielded Wait states how long the script
only waits, so that a scheduler in virtual time can take longer steps; a real-time scheduler may ignore it. Docking and
the mission use scripts.
"""

import itertools
import math
from collections.abc import Generator, Iterable
from typing import Generic, NamedTuple, Protocol, TypeVar

T = TypeVar("T")


class Wait(NamedTuple):
    """What a script waits for.

    Attributes:
        until: s; the script only waits until then, but interruptions are checked in steps.
        reads: whether the script uses the servo readings made until then.
        nearing: m/s, maximum approach speed if the wait also ends at touch; 0 = touch is not checked.
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
        self._begun = False

    @property
    def is_running(self) -> bool:
        """Whether a script is running."""
        return self._script is not None

    def start(self, script: Script[None]) -> None:
        """Start a script; replaces a running one."""
        self.stop()
        self._script, self._begun = script, False

    def stop(self) -> None:
        """Close the script."""
        if self._script is not None:
            self._script.close()
        self._script = None

    def step(self, problem: Exception | None) -> Wait:
        """Continue the script, or raise `problem` in it; return its next wait.

        A script handles nothing before it has begun, so its first step comes first.
        """
        if self._script is None:
            return NEXT
        begun, self._begun = self._begun, True
        try:
            return next(self._script) if problem is None or not begun else self._script.throw(problem)
        except StopIteration:
            self._script = None
            return NEXT


class Numbered(Protocol):
    """A reply to the request of the same number."""

    @property
    def number(self) -> int:
        """Number of the request."""


R = TypeVar("R", bound=Numbered)


class Calls(Generic[R]):
    """Pending requests by number, and their replies. Requests that are not awaited are not tracked.

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

    def receive(self, replies: Iterable[R]) -> None:
        """Take the replies; the first one of each number counts."""
        for reply in replies:
            if reply.number in self.open:
                self.open.discard(reply.number)
                self._replies[reply.number] = reply

    def take_reply(self, number: int) -> R | None:
        """Remove and return the reply of a request; None = none yet."""
        return self._replies.pop(number, None)

    def forget(self) -> None:
        """Drop all pending requests and replies."""
        self.open.clear()
        self._replies.clear()
