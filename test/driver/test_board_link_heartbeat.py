# SPDX-License-Identifier: Apache-2.0
"""What `BoardLink` tells about its heartbeat."""

from __future__ import annotations

import errno
import math
import os
import threading
import time

import pytest

from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.emulators.board import BoardEmulator
from deltacharger_driver.emulators.pseudo_terminal import PseudoTerminal

from ..waiting import wait_until

pytestmark = pytest.mark.realtime


def test_how_late_heartbeats_were_is_told_while_there_is_a_connection(board: BoardEmulator) -> None:
    with PseudoTerminal(board) as cable:
        link = BoardLink(cable.path)
        assert link.heartbeat_lateness is None
        link.open()
        lateness = link.heartbeat_lateness
        assert lateness is not None
        assert math.isnan(lateness.largest)
        link.keep_alive(time.monotonic() + 1.0)
        wait_until(lambda: link.counters.heartbeats >= 3)
        assert 0.0 <= lateness.percentile(0.5) <= lateness.largest
        link.close()
        assert link.heartbeat_lateness is None


def heartbeat_thread() -> int:
    """Return the system's number of the one heartbeat's thread."""
    (thread,) = [each for each in threading.enumerate() if each.name.startswith("board heartbeat")]
    assert thread.native_id is not None
    return thread.native_id


@pytest.mark.parametrize("priority", [0, 3])
def test_its_thread_has_the_priority_that_is_told(board: BoardEmulator, priority: int) -> None:
    with PseudoTerminal(board) as cable:
        link = BoardLink(cable.path, heartbeat_priority=priority)
        assert link.heartbeat_runs_with == ""
        link.open()
        told, thread = link.heartbeat_runs_with, heartbeat_thread()
        kind = os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK
        real = (kind, os.sched_getparam(thread).sched_priority) == (os.SCHED_FIFO, priority)
        others = {os.sched_getscheduler(each.native_id or 0) for each in threading.enumerate()} - {
            os.sched_getscheduler(thread)
        }
        link.close()
    if priority == 0 or not real:
        assert kind == os.SCHED_OTHER
        assert told.startswith("ordinary")
    else:
        assert told == "real time 3"
        assert others == {os.SCHED_OTHER}, "no other thread has it"


def test_where_real_time_is_not_permitted_it_says_so_and_works(
    board: BoardEmulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*arguments: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with PseudoTerminal(board) as cable:
        link = BoardLink(cable.path, heartbeat_priority=3)
        link.open()
        assert link.heartbeat_runs_with == "ordinary; real time is not permitted (Operation not permitted)"
        link.keep_alive(time.monotonic() + 1.0)
        wait_until(lambda: link.counters.heartbeats >= 3)
        link.close()
