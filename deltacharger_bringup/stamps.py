"""From the monotonic clock, by which hardware is timed, to the stamps of a node's messages."""

from __future__ import annotations

import time

from rclpy.clock import Clock

_LOOK = 0.1  # s between two looks at both clocks


class Stamps:
    """Translates instants from the monotonic clock to a node's clock; used by one thread.

    The difference is measured ten times a second and not for every message: reading ROS time costs as much as filling
    a message, and meanwhile the two drift apart by 50 ns at most where the system's clock is being slewed.

    Args:
        clock: of the node.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._offset = 0  # ns
        self._due = -1.0

    def convert(self, instant: float) -> tuple[int, int]:
        """Return `instant` (s, monotonic) as the s and ns of a stamp."""
        now = time.monotonic()
        if now >= self._due:
            self._due = now + _LOOK
            self._offset = self._clock.now().nanoseconds - int(now * 1e9)
        return divmod(max(int(instant * 1e9) + self._offset, 0), 1_000_000_000)
