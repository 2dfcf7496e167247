# SPDX-License-Identifier: Apache-2.0
"""Age of a request, by the middleware's stamp of its sending: every service has it, also those of std_srvs.

It is the time of the sender's computer, whatever /clock shows.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from deltacharger_ros.refusals import ANOTHER_CLOCK

_served = threading.local()


@contextmanager
def serving(header: Any) -> Iterator[None]:
    """Remember the header of the request that this thread serves."""
    _served.sent = getattr(header, "source_timestamp", 0)
    try:
        yield
    finally:
        _served.sent = 0


def order_age() -> float:
    """Return the age (s) of the request that this thread serves; 0 if it is unknown."""
    return age(getattr(_served, "sent", 0), time.time_ns())


def age(sent: int, now: int) -> float:
    """Return the age (s) at `now` of a request sent at `sent` (ns since 1970).

    It is 0 if not stamped, stamped in the future, or so old that a clock was set meanwhile.
    """
    old = (now - sent) * 1e-9
    return old if sent and 0.0 < old < ANOTHER_CLOCK else 0.0
