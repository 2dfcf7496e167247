# SPDX-License-Identifier: Apache-2.0
"""What the servos' thread is asked for, and whom it asks to open the contactor. No ROS."""

from __future__ import annotations

import queue
import threading
import time
from typing import Protocol

_LOOK = 0.005  # s between two looks at the contactor


class ServoRequest:
    """Something asked of the servos' thread, and its outcome."""

    def __init__(self, action: str) -> None:
        self.action = action
        self.success = False
        self.message = ""
        self._done = threading.Event()

    def finish(self, success: bool, message: str) -> None:
        """Say how it went."""
        self.success, self.message = success, message
        self._done.set()

    def wait(self, timeout: float) -> bool:
        """Wait at most `timeout` s for the outcome and return whether it is there."""
        return self._done.wait(timeout)


class ServoRequests:
    """What waits for the servos' thread: requests not yet served, and those held back until the torque is off.

    `put` may be called from any thread, the others from the servos' thread.
    """

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[ServoRequest] = queue.SimpleQueue()
        self._held: list[ServoRequest] = []

    def put(self, action: str) -> ServoRequest:
        """Ask for something."""
        request = ServoRequest(action)
        self._queue.put(request)
        return request

    def next(self) -> ServoRequest | None:
        """Return what was asked for next, or None."""
        return None if self._queue.empty() else self._queue.get_nowait()

    def hold(self, request: ServoRequest) -> None:
        """Keep a request that will be finished by `finish_held`."""
        self._held.append(request)

    @property
    def are_there(self) -> bool:
        """Whether one is not served yet."""
        return not self._queue.empty()

    @property
    def are_held(self) -> bool:
        """Whether one is held."""
        return bool(self._held)

    def finish_held(self, success: bool, message: str) -> None:
        """Say how those held went."""
        for request in self._held:
            request.finish(success, message)
        self._held.clear()

    def refuse_all(self, reason: str) -> None:
        """Finish every one without success."""
        self.finish_held(False, reason)
        while request := self.next():
            request.finish(False, reason)


class Contactor(Protocol):
    """The contactor as the servos' thread sees it: it must be open before the arm lets go of the electrodes.

    Neither method may wait or raise: they are called between two bus cycles.
    """

    def ask_open(self) -> None:
        """Ask for an opening."""

    def is_open(self) -> bool:
        """Return whether it was seen open after the last `ask_open`, or nobody serves one."""


class NoContactor:
    """For an arm without a power stage."""

    def ask_open(self) -> None:
        """Nothing to ask."""

    def is_open(self) -> bool:
        """Return True: nothing is closed."""
        return True


def wait_until_open(contactor: Contactor, seconds: float) -> None:
    """Ask for an opening and wait for it, at most `seconds`; where no cycle looks."""
    contactor.ask_open()
    end = time.monotonic() + seconds
    while not contactor.is_open() and time.monotonic() < end:
        time.sleep(_LOOK)
