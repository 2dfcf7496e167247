# SPDX-License-Identifier: Apache-2.0
"""Waits for a condition with a deadline, never for a fixed time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

Value = TypeVar("Value")

DEADLINE = 60.0  # s; far longer than needed, so that a busy computer fails no test


def wait_until(condition: Callable[[], Value], what: str = "a condition", deadline: float = DEADLINE) -> Value:
    """Return the first true value of `condition`, or fail and name the awaited condition."""
    end = time.monotonic() + deadline
    while not (value := condition()):
        assert time.monotonic() < end, f"waited {deadline:g} s for: {what}"
        time.sleep(0.005)
    return value
