# SPDX-License-Identifier: Apache-2.0
"""Real-time priority of one thread, where this computer permits it."""

from __future__ import annotations

import os


def take_priority(priority: int) -> str:
    """Let the calling thread run before all of ordinary priority; return how it runs now, in words.

    Linux alone knows it. It is permitted with CAP_SYS_NICE, or up to the limit `rtprio` of the user.

    Args:
        priority: of SCHED_FIFO, 1 to 99; 0 = ordinary.
    """
    if priority == 0:
        return "ordinary"
    try:
        # A process that this thread might start must not inherit it.
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except (AttributeError, OSError) as error:
        return f"ordinary; real time is not permitted ({getattr(error, 'strerror', None) or 'this is no Linux'})"
    return f"real time {priority}"
