# SPDX-License-Identifier: Apache-2.0
"""What tests of the servo bus share: figures, and waiting for something to come to pass."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

OVERLOAD = 1 << 5
BOUND = (0.83, 0.83, 0.83)
Result = TypeVar("Result")


def until(condition: Callable[[], Result], seconds: float = 3.0) -> Result:
    """Wait for a condition with a deadline and return what it gave."""
    deadline = time.monotonic() + seconds
    while not (result := condition()):
        assert time.monotonic() < deadline, "it did not come to pass"
        time.sleep(0.002)
    return result
