# SPDX-License-Identifier: Apache-2.0
"""Requests to the servos' thread, and its interface to the contactor. No ROS."""

from __future__ import annotations

import math
import queue
import threading
from typing import Protocol

from deltacharger_driver.servos.port import ServoPort

_POLL_PERIOD = 0.005  # s between two checks of the contactor


class ServoRequest:
    """A request to the servos' thread, with its result."""

    def __init__(self, action: str, sent: float = math.inf) -> None:
        self.action = action
        self.sent = sent  # s, the servos' clock
        self.success = False
        self.message = ""
        self._done = threading.Event()

    def finish(self, success: bool, message: str) -> None:
        """Set the result."""
        self.success, self.message = success, message
        self._done.set()

    def wait(self, timeout: float) -> bool:
        """Wait at most `timeout` s for the result; return whether it is there."""
        return self._done.wait(timeout)


class ServoRequests:
    """Requests waiting for the servos' thread, and those held until torque is off.

    `put` may be called from any thread, the others from the servos' thread.
    """

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[ServoRequest] = queue.SimpleQueue()
        self._held: list[ServoRequest] = []

    def put(self, action: str, sent: float = math.inf) -> ServoRequest:
        """Queue a request that was sent at `sent` (s)."""
        request = ServoRequest(action, sent)
        self._queue.put(request)
        return request

    def next(self) -> ServoRequest | None:
        """Return the next queued request, or None."""
        return None if self._queue.empty() else self._queue.get_nowait()

    def hold(self, request: ServoRequest) -> None:
        """Hold a request until `finish_held`."""
        self._held.append(request)

    @property
    def has_queued(self) -> bool:
        """Whether a request is queued."""
        return not self._queue.empty()

    @property
    def has_held(self) -> bool:
        """Whether a request is held."""
        return bool(self._held)

    def finish_held(self, success: bool, message: str) -> None:
        """Finish all held requests."""
        for request in self._held:
            request.finish(success, message)
        self._held.clear()

    def refuse_all(self, reason: str) -> None:
        """Finish every request without success."""
        self.finish_held(False, reason)
        while request := self.next():
            request.finish(False, reason)


class Contactor(Protocol):
    """The contactor for the servos' thread: it must be open before torque goes off.

    Neither method may wait or raise: they are called between two bus cycles.
    """

    def request_open(self) -> None:
        """Request an opening."""

    def is_open(self) -> bool:
        """Return whether it was reported open after the last `request_open`, or does not exist."""


class NoContactor:
    """For an arm without a power stage."""

    def request_open(self) -> None:
        """Do nothing."""

    def is_open(self) -> bool:
        """Return True: nothing is closed."""
        return True


def wait_until_open(contactor: Contactor, seconds: float, clock: ServoPort) -> None:
    """Request an opening and wait for it, at most `seconds`; for use outside the cycle."""
    contactor.request_open()
    end = clock.now() + seconds
    while not contactor.is_open() and clock.now() < end:
        clock.sleep(_POLL_PERIOD)
