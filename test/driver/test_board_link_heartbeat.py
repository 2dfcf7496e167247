# SPDX-License-Identifier: Apache-2.0
"""What `BoardLink` reports about its heartbeat."""

from __future__ import annotations

import errno
import os
import threading
import time

import pytest

from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.emulators.board import BoardEmulator
from deltacharger_driver.pseudo_terminal import PseudoTerminal

from ..waiting import wait_until


def heartbeat_thread() -> int:
    """Return the system's id of the heartbeat thread."""
    (thread,) = [each for each in threading.enumerate() if each.name.startswith("board heartbeat")]
    assert thread.native_id is not None
    return thread.native_id


@pytest.mark.parametrize("priority", [0, 3])
def test_only_the_heartbeat_thread_has_the_reported_priority(board: BoardEmulator, priority: int) -> None:
    with PseudoTerminal(board) as cable:
        link = BoardLink(cable.path, heartbeat_priority=priority)
        assert link.heartbeat_runs_with == ""
        link.open()
        reported, thread = link.heartbeat_runs_with, heartbeat_thread()
        kind, level = os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK, os.sched_getparam(thread).sched_priority
        others = [each.native_id or 0 for each in threading.enumerate() if each.native_id != thread]
        assert {os.sched_getscheduler(each) for each in others} == {os.SCHED_OTHER}
        link.close()
    real_time = reported == f"real time {priority}"
    assert (kind, level) == ((os.SCHED_FIFO, priority) if real_time else (os.SCHED_OTHER, 0))
    assert real_time or reported.startswith("ordinary")
    assert priority or not real_time


def test_without_permission_for_real_time_the_heartbeat_works_and_reports_it(
    board: BoardEmulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*arguments: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with PseudoTerminal(board) as cable:
        link = BoardLink(cable.path, heartbeat_priority=3)
        link.open()
        assert link.heartbeat_runs_with.startswith("ordinary; ")
        link.keep_alive(time.monotonic() + 1.0)
        wait_until(lambda: link.counters.heartbeats >= 3)
        link.close()
