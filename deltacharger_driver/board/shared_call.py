# SPDX-License-Identifier: Apache-2.0
"""A measurement that many may ask for at once: who comes while it runs gets the same result."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

Result = TypeVar("Result")

_REFUSAL = 0.05  # s from the beginning of a call until its error is told: who calls again and again costs little
_LATER = 16  # callers for whom one result counts later


class SharedCall(Generic[Result]):
    """Calls an action for any number of threads, never twice at a time. Thread-safe.

    Who comes while it runs waits for its outcome, an error included. However many callers there are, and however often
    they call, nobody waits for more than the call under way and one of its own.

    Args:
        action: what is called; takes a moment.
        lasts: s for which a result that several waited for counts for later callers too; without it, each of those who
            queue for a thread would cost a call of its own.
    """

    def __init__(self, action: Callable[[], Result], lasts: float) -> None:
        self._action = action
        self._lasts = lasts
        self._changed = threading.Condition()
        self._running: _Run[Result] | None = None
        self._last: _Run[Result] | None = None  # that succeeded, where several waited for it
        self._priority = 0  # how many others wait for their turn before the next call

    @property
    def is_running(self) -> bool:
        """Whether the action is being called."""
        return self._running is not None

    def __call__(self) -> Result:
        """Return the action's result, or raise its error."""
        with self._changed:
            run = self._running
            last = self._last
            if run is None and last and last.later < _LATER and time.monotonic() - last.ended < self._lasts:
                last.later += 1
                return last.outcome()
            if run is None:
                self._changed.wait_for(lambda: not self._priority or self._running)
                run = self._running
            begins = run is None
            if run is None:
                run = self._running = _Run()
            run.callers += 1
        if begins:
            self._call(run)
        run.done.wait()
        if run.error is not None:
            time.sleep(max(run.began + _REFUSAL - time.monotonic(), 0.0))
        return run.outcome()

    def forget(self) -> None:
        """Let the last result count for nobody who comes later."""
        with self._changed:
            self._last = None

    def _call(self, run: _Run[Result]) -> None:
        try:
            run.result = self._action()
        except BaseException as error:
            run.error = error
        finally:
            run.ended = time.monotonic()
            with self._changed:
                self._running = None
                self._last = run if run.callers > 1 and run.error is None else None
                self._changed.notify_all()
            run.done.set()

    def __enter__(self) -> None:
        """Wait until nothing runs, and let nothing begin until the exit."""
        with self._changed:
            self._priority += 1
            self._changed.wait_for(lambda: self._running is None)

    def __exit__(self, *exception: object) -> None:
        """Let it begin again."""
        with self._changed:
            self._priority -= 1
            self._changed.notify_all()


class _Run(Generic[Result]):
    """One call: how many wait for it, how many have got its result later, its outcome, when it began and ended (s)."""

    def __init__(self) -> None:
        self.done = threading.Event()
        self.result: Result | None = None
        self.error: BaseException | None = None
        self.callers = self.later = 0
        self.began, self.ended = time.monotonic(), 0.0

    def outcome(self) -> Result:
        """Return the result or raise the error."""
        if self.error is not None:
            raise self.error
        return self.result  # type: ignore[return-value]
