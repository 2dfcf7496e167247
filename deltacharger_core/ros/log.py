# SPDX-License-Identifier: Apache-2.0
"""Non-blocking log of a node, safe for texts received from others."""

import select
import threading
import time

from rclpy.node import Node

from deltacharger_core import streams
from deltacharger_core.texts import cut

_STDERR = 2


class Log:
    """Writes lines through a node's logger, and drops lines that would block the process.

    rclpy writes to standard error while it holds Python's global interpreter lock. If the reader has stopped (Ctrl-S in
    a terminal, a launch that hangs), every thread would block, including servos and heartbeat. The next line reports
    how many lines were dropped. A line takes 0.6 ms.

    Args:
        node: its logger is used.
    """

    def __init__(self, node: Node) -> None:
        self._logger = node.get_logger()
        self._lock = threading.Lock()
        self._lost = 0
        self._due = 0.0  # s, monotonic, when the next repeated line may be logged

    def info(self, line: str) -> None:
        """Log normal progress; line breaks and terminal control characters are escaped."""
        if self._is_open():
            self._logger.info(cut(streams.plain(line)))

    def warning(self, line: str, pause: float = 0.0) -> None:
        """Log what a person should check; `pause` as in `error`."""
        if self._is_due(pause) and self._is_open():
            self._logger.warning(cut(streams.plain(line)))

    def error(self, line: str, pause: float = 0.0) -> None:
        """Log what a person must fix; of lines with a `pause`, whatever their text, at most one in `pause` s.

        rclpy's throttle distinguishes places of calls, and here all calls have the same place.
        """
        if self._is_due(pause) and self._is_open():
            self._logger.error(cut(streams.plain(line)))

    def _is_due(self, pause: float) -> bool:
        now = time.monotonic()
        with self._lock:
            if pause and now < self._due:
                return False
            self._due = now + pause if pause else self._due
            return True

    def _is_open(self) -> bool:
        """Return whether standard error accepts a line at once; if so, report the number of dropped lines."""
        with self._lock:
            if not _takes_a_line():
                self._lost += 1
                return False
            lost, self._lost = self._lost, 0
        if lost:
            self._logger.warning(f"{lost} lines of this log are missing here: standard error was blocked")
        return True


def _takes_a_line() -> bool:
    """Return whether a write to standard error returns at once, also if it fails because the stream is closed."""
    look = select.poll()
    look.register(_STDERR, select.POLLOUT)
    return bool(look.poll(0))
