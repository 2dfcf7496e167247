# SPDX-License-Identifier: Apache-2.0
"""A shared call: one at a time, one result for all waiting callers, and precedence for a block."""

from __future__ import annotations

import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor

import pytest

from deltacharger_driver.board.contactor import SharedCall

from ..waiting import DEADLINE, wait_until


class Slow:
    """An action that ends on command and counts its calls."""

    def __init__(self) -> None:
        self.calls = 0
        self.go_on = threading.Event()
        self.error: Exception | None = None

    def __call__(self) -> int:
        self.calls += 1
        assert self.go_on.wait(DEADLINE)
        if self.error is not None:
            raise self.error
        return self.calls


@pytest.fixture
def slow() -> Slow:
    return Slow()


def together(shared: SharedCall[int], pool: ThreadPoolExecutor, count: int) -> list[Future[int]]:
    """Start `count` calling threads, and return once all wait."""
    jobs = [pool.submit(shared) for _ in range(count)]
    wait_until(lambda: shared._running is not None and shared._running.callers == count, "all callers")
    return jobs


def test_callers_share_an_error_and_the_next_one_calls_again(slow: Slow) -> None:
    shared = SharedCall(slow, DEADLINE)
    slow.error = ValueError("no")
    with ThreadPoolExecutor(3) as pool:
        jobs = together(shared, pool, 3)
        slow.go_on.set()
        for job in jobs:
            with pytest.raises(ValueError, match="no"):
                job.result(DEADLINE)
    slow.error = None
    assert shared() == 2


def test_a_result_is_reused_only_if_several_waited_and_until_it_is_discarded(slow: Slow) -> None:
    shared = SharedCall(slow, DEADLINE)
    slow.go_on.set()
    assert [shared(), shared()] == [1, 2]
    slow.go_on.clear()
    with ThreadPoolExecutor(2) as pool:
        jobs = together(shared, pool, 2)
        slow.go_on.set()
        assert [job.result(DEADLINE) for job in jobs] == [3, 3]
    assert shared() == 3
    shared.forget()
    assert shared() == 4


def test_a_block_waits_for_the_running_call_and_precedes_the_next(slow: Slow) -> None:
    shared = SharedCall(slow, 0.0)
    entered, leave = threading.Event(), threading.Event()

    def go_first() -> int:
        with shared:
            entered.set()
            assert leave.wait(DEADLINE)
            return slow.calls

    with ThreadPoolExecutor(3) as pool:
        (under_way,) = together(shared, pool, 1)
        first = pool.submit(go_first)
        wait_until(lambda: shared._priority, "the block to wait")
        assert not entered.is_set()
        slow.go_on.set()
        assert under_way.result(DEADLINE) == 1
        assert entered.wait(DEADLINE)
        late = pool.submit(shared)
        leave.set()
        assert first.result(DEADLINE) == 1
        assert late.result(DEADLINE) == 2


def test_repeated_failures_are_answered_at_a_bounded_rate(slow: Slow) -> None:
    slow.error = ValueError("no")
    slow.go_on.set()
    began = time.monotonic()
    with pytest.raises(ValueError, match="no"):
        SharedCall(slow, 0.0)()
    assert time.monotonic() - began >= 0.05
