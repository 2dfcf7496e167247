# SPDX-License-Identifier: Apache-2.0
"""A measurement for concurrent callers: a caller that arrives while it runs gets the same result."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

Result = TypeVar("Result")

_REFUSAL = 0.05  # s from the start of a call until its error is raised: limits the cost of repeated calls
_LATER = 16  # later callers that may reuse one result


class SharedCall(Generic[Result]):
    """Calls an action for any number of threads, never twice at a time. Thread-safe.

    A caller that arrives while it runs waits for that result or error. Whatever the number of callers, each waits
    at most for the running call and one more.

    Args:
        action: what is called; takes a moment.
        lasts: s for which later callers reuse a result that several callers awaited. Without it, each caller queued
            for a thread would cost its own call.
        clock: s.
    """

    def __init__(self, action: Callable[[], Result], lasts: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._action = action
        self._lasts = lasts
        self._clock = clock
        self._changed = threading.Condition()
        self._running: _Run[Result] | None = None
        self._last: _Run[Result] | None = None  # the last success, if several callers awaited it
        self._priority = 0  # number of blocks that wait to enter before the next call

    def __call__(self) -> Result:
        """Return the action's result, or raise its error."""
        with self._changed:
            run = self._running
            last = self._last
            if run is None and last and last.later < _LATER and self._clock() - last.ended < self._lasts:
                last.later += 1
                return last.outcome()
            if run is None:
                self._changed.wait_for(lambda: not self._priority or self._running)
                run = self._running
            begins = run is None
            if run is None:
                run = self._running = _Run(self._clock())
            run.callers += 1
        if begins:
            self._call(run)
        run.done.wait()
        if run.error is not None:
            time.sleep(max(run.began + _REFUSAL - self._clock(), 0.0))
        return run.outcome()

    def forget(self) -> None:
        """Discard the last result for later callers."""
        with self._changed:
            self._last = None

    def _call(self, run: _Run[Result]) -> None:
        try:
            run.result = self._action()
        except BaseException as error:
            run.error = error
        finally:
            run.ended = self._clock()
            with self._changed:
                self._running = None
                self._last = run if run.callers > 1 and run.error is None else None
                self._changed.notify_all()
            run.done.set()

    def __enter__(self) -> None:
        """Wait until the action is idle and block new calls until the exit."""
        with self._changed:
            self._priority += 1
            self._changed.wait_for(lambda: self._running is None)

    def __exit__(self, *exception: object) -> None:
        """Allow calls again."""
        with self._changed:
            self._priority -= 1
            self._changed.notify_all()


class _Run(Generic[Result]):
    """One call: its waiting and later callers, its outcome, and its start and end (s)."""

    def __init__(self, began: float) -> None:
        self.done = threading.Event()
        self.result: Result | None = None
        self.error: BaseException | None = None
        self.callers = self.later = 0
        self.began, self.ended = began, 0.0

    def outcome(self) -> Result:
        """Return the result or raise the error."""
        if self.error is not None:
            raise self.error
        return self.result  # type: ignore[return-value]
