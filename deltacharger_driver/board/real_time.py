# SPDX-License-Identifier: Apache-2.0
"""Real-time priority of one thread, if this computer permits it."""

from __future__ import annotations

import os


def take_priority(priority: int) -> str:
    """Give the calling thread real-time priority, if permitted; return its priority in words.

    Linux only. It needs CAP_SYS_NICE or the user's limit `rtprio`.

    Args:
        priority: SCHED_FIFO priority, 1 to 99; 0 = ordinary.
    """
    if priority == 0:
        return "ordinary"
    try:
        # RESET_ON_FORK: a child process must not inherit the priority.
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except (AttributeError, OSError) as error:
        return f"ordinary; real time is not permitted ({getattr(error, 'strerror', None) or 'this is not Linux'})"
    return f"real time {priority}"
