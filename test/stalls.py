# SPDX-License-Identifier: Apache-2.0
"""Repeats a test that failed during a stall of the computer, at most twice, and reports it in the summary.

Tests have real deadlines: a heartbeat is lost after 95 ms, a lease ends after 250 ms. A stalled virtual machine misses
them like a robot's computer would, and the failure then shows nothing about the code. A thread sleeps, sends itself a
byte through a pseudo-terminal and measures the delay. Without delay a failure stands. The byte is needed because each
processor's kernel workers pass it on: under load one byte took 156 ms while a pipe took less than 15. The thread
changes processors. It samples: another terminal may stall unseen, and then a failure stands that should not.
"""

from __future__ import annotations

import itertools
import os
import threading
import time
import tty
from os import read, write  # not by `os.`: a test may replace those
from typing import Any

import pytest
from _pytest.runner import runtestprotocol

STALL = 0.022  # s; a later reply of a servo is lost: the tightest deadline of the tests
_NAP = 0.01  # s
_REPEATS = 2  # a slow and busy computer often stalls in the first repetition too


class StallWatch:
    """Plugin that measures stalls during every test and repeats a test that failed during a stall."""

    def __init__(self) -> None:
        self._longest = 0.0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True, name="stall-watch")
        self._repeated: list[str] = []

    def _watch(self) -> None:
        master, slave = os.openpty()
        tty.setraw(slave)
        processors = itertools.cycle(sorted(os.sched_getaffinity(0)))
        before = time.monotonic()
        while not self._end.wait(_NAP):
            os.sched_setaffinity(0, {next(processors)})  # of this thread
            write(master, b"x")
            read(slave, 1)
            now = time.monotonic()
            self._longest = max(self._longest, now - before - _NAP)
            before = now

    def pytest_sessionstart(self) -> None:
        self._thread.start()

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        self._end.set()
        if hasattr(session.config, "workeroutput"):  # in a worker, which has no terminal
            session.config.workeroutput["repeated"] = self._repeated

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Collect the tests that a worker repeated."""
        self._repeated += getattr(node, "workeroutput", {}).get("repeated", [])

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool:
        """Run one test, and again while it fails during a stall."""
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        reports = self._run(item, nextitem)
        for _ in range(_REPEATS):
            if self._longest <= STALL or not any(report.failed for report in reports):
                break
            crashes = [getattr(report.longrepr, "reprcrash", None) for report in reports if report.failed]
            why = "; ".join(crash.message.splitlines()[0][:300] for crash in crashes if crash)
            self._repeated.append(f"{item.nodeid}: the computer stood still for {self._longest * 1e3:.0f} ms: {why}")
            item._initrequest()  # type: ignore[attr-defined]
            reports = self._run(item, nextitem)
        for report in reports:
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def _run(self, item: pytest.Item, nextitem: pytest.Item | None) -> list[pytest.TestReport]:
        self._longest = 0.0
        return runtestprotocol(item, nextitem=nextitem, log=False)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        for line in self._repeated:
            terminalreporter.write_line(f"REPEATED {line}")
