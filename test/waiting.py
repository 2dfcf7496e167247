# SPDX-License-Identifier: Apache-2.0
"""Waiting for what a test is about: by its condition, never by sleeping for luck."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

Value = TypeVar("Value")

DEADLINE = 60.0  # s; far longer than anything takes, so that a loaded machine fails no test


def wait_until(condition: Callable[[], Value], what: str = "what was waited for", deadline: float = DEADLINE) -> Value:
    """Return the first true value of `condition`, or fail saying what was waited for."""
    end = time.monotonic() + deadline
    while not (value := condition()):
        assert time.monotonic() < end, f"waited {deadline:g} s for: {what}"
        time.sleep(0.005)
    return value
