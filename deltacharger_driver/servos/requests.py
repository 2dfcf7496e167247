# SPDX-License-Identifier: Apache-2.0
"""What the servos' thread is asked for, and whom it asks to open the contactor. No ROS."""

from __future__ import annotations

import threading
from typing import Protocol


class Request:
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
