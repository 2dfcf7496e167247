# SPDX-License-Identifier: Apache-2.0
"""Waits for a condition with a deadline, never for a fixed time."""

import time
from collections.abc import Callable
from typing import TypeVar

Value = TypeVar("Value")

DEADLINE = 60.0  # s; far longer than needed, so that a busy computer fails no test
_width = 1.0


def widen(factor: float) -> None:
    """Set by how much `host` widens (the option --host-deadlines)."""
    global _width
    _width = factor


def host(seconds: float) -> float:
    """Return a deadline (s) that this computer must keep: as given at night, wider beside other work.

    Only for times that the computer's scheduler decides. Times that the board, the emulators or the world keep by
    their own clocks are compared as they are.
    """
    return seconds * _width


def wait_until(condition: Callable[[], Value], what: str = "a condition", deadline: float = DEADLINE) -> Value:
    """Return the first true value of `condition`, or fail and name the awaited condition."""
    end = time.monotonic() + deadline
    while not (value := condition()):
        assert time.monotonic() < end, f"waited {deadline:g} s for: {what}"
        time.sleep(0.005)
    return value
