# SPDX-License-Identifier: Apache-2.0
"""Measures each test's processor time and duration, and lists those above their budget in the summary."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from typing import Any

import pytest

CPU = 0.3  # s of processor time of one test, its fixtures and ended children
WALL = 1.0  # s
WITNESS_WALL = 8.0  # s of a real-time test that shows a law about bytes, threads or processes
WITNESSES = 30  # at most, in the whole suite
_LISTED = 40


def _processor_time() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


class Budget:
    """Plugin: `make test` stays short only if each of its tests does.

    Only the list is affected, not the result: durations depend on the computer and its load.
    """

    def __init__(self) -> None:
        self._spent: list[tuple[float, float, str]] = []  # CPU s, wall s, test

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Refuse more witnesses than the suite has time for."""
        count = sum(item.get_closest_marker("witness") is not None for item in items)
        if count > WITNESSES:
            raise pytest.UsageError(f"{count} tests are marked witness, {WITNESSES} at most")

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Measure one test with its fixtures."""
        cpu, wall = _processor_time(), time.monotonic()
        result = yield
        cpu, wall = _processor_time() - cpu, time.monotonic() - wall
        marks = {mark.name for mark in item.iter_markers()}
        if marks & {"rest", "night"}:
            limits = float("inf"), float("inf")
        else:
            limits = (WITNESS_WALL, WITNESS_WALL) if "witness" in marks else (CPU, WALL)
        if cpu > limits[0] or wall > limits[1] or item.config.getoption("--times"):
            self._spent.append((cpu, wall, item.nodeid))
        return result

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if hasattr(session.config, "workeroutput"):  # in a worker, which has no terminal
            session.config.workeroutput["spent"] = self._spent

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Collect what the tests of a worker spent."""
        self._spent += map(tuple, getattr(node, "workeroutput", {}).get("spent", []))

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        self._spent.sort(reverse=True)
        all_of_them = terminalreporter.config.getoption("--times")
        for cpu, wall, name in self._spent if all_of_them else self._spent[:_LISTED]:
            terminalreporter.write_line(f"SPENT {cpu:.2f} s of CPU, {wall:.2f} s: {name}")
