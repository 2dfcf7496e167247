# SPDX-License-Identifier: Apache-2.0
"""A node's log for lines that name what others sent, from threads that must not be held up."""

from __future__ import annotations

import select
import threading
import time

from rclpy.node import Node

from deltacharger_core import streams
from deltacharger_core.texts import cut

_STDERR = 2


class Log:
    """Writes lines through the logger of a node, and leaves out those that would hold its process up.

    rclpy writes to standard error while it holds Python's lock: where a reader has stopped (Ctrl-S in a terminal, a
    launch that hangs), every thread would stand still until it goes on, that of the servos and the heartbeat's too.
    What was left out is counted and told with the next line. A line takes 0.6 ms.

    Args:
        node: whose logger it is.
    """

    def __init__(self, node: Node) -> None:
        self._logger = node.get_logger()
        self._lock = threading.Lock()
        self._lost = 0
        self._due = 0.0  # s, monotonic, for the next line of those that come again and again

    def info(self, line: str) -> None:
        """Say what goes on; what would control a terminal, or end the line, is spelt out."""
        if self._is_open():
            self._logger.info(cut(streams.plain(line)))

    def warning(self, line: str, pause: float = 0.0) -> None:
        """Say what a person should look at; `pause` as in `error`."""
        if self._is_due(pause) and self._is_open():
            self._logger.warning(cut(streams.plain(line)))

    def error(self, line: str, pause: float = 0.0) -> None:
        """Say what a person must mend; where it may come at each tick, once in `pause` s.

        rclpy's own throttle goes by the place of the call, which is this one for all.
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
        """Return whether standard error takes a line at once, and tell how many it did not take before."""
        with self._lock:
            if not _takes_a_line():
                self._lost += 1
                return False
            lost, self._lost = self._lost, 0
        if lost:
            self._logger.warning(f"{lost} lines of this log are missing here: standard error took none")
        return True


def _takes_a_line() -> bool:
    """Return whether a write ends at once; where standard error is closed it fails at once, which is well too."""
    look = select.poll()
    look.register(_STDERR, select.POLLOUT)
    return bool(look.poll(0))
