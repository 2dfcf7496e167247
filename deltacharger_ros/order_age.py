# SPDX-License-Identifier: Apache-2.0
"""Age of a request, by the middleware's stamp of its sending: every service has it, also those of std_srvs.

It is the time of the sender's computer, whatever /clock shows.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from deltacharger_core.host_clock import HOST
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
    """Return the age (s) of the request that this thread serves; 0 if it is unknown, or as of another clock."""
    sent = getattr(_served, "sent", 0)
    old = HOST.age(1e-9 * sent)
    return old if sent and 0.0 < old < ANOTHER_CLOCK else 0.0
