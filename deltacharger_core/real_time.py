# SPDX-License-Identifier: Apache-2.0
"""Real-time priority of processes with deadlines: nodes that keep the contactor closed, and emulated hardware."""

from __future__ import annotations

import os

_PRIORITY = 1  # the lowest of real time: above all ordinary processes, below the kernel's own threads


def take_priority() -> str:
    """Give the calling thread and all that it starts from now on real-time priority (SCHED_FIFO), if permitted.

    Call it before any thread starts: threads of one interpreter wait for each other, so one of ordinary priority would
    delay the others.

    Returns:
        '' = done, else why not and what to permit.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except (AttributeError, OSError) as error:
        why = getattr(error, "strerror", None) or "this is not Linux"
        return (
            f"ordinary priority ({why}): programs beside it may end a charge; to permit real time, set LimitRTPRIO=1 "
            "in a systemd unit, 'USER - rtprio 1' in /etc/security/limits.d/, or docker run --ulimit rtprio=1"
        )
    return ""


def priority() -> str:
    """Return the calling thread's priority in words."""
    try:
        return "real time" if os.sched_getscheduler(0) == os.SCHED_FIFO else "ordinary"
    except AttributeError:
        return "ordinary"
