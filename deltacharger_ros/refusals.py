# SPDX-License-Identifier: Apache-2.0
"""Messages that are not taken: stamps that are none, lie ahead or go back, and bytes that are no message."""

from __future__ import annotations

from typing import Any

from deltacharger_ros.messages import seconds

AHEAD = 0.1
"""By how much (s) a stamp may be ahead of this computer's clock: it hides as much age, and press_age_max allows no
more. Clocks of two computers that are kept by NTP differ by less than a tenth of it."""


class MessageRefused(Exception):
    """A message is not taken. Example: its stamp lies in the future."""


class Refusals:
    """What was not taken.

    Attributes:
        count: of messages.
        last: why, the last of them.
    """

    def __init__(self) -> None:
        self.count = 0
        self.last = ""

    def add(self, topic: str, reason: str) -> None:
        """Count a message."""
        self.count += 1
        self.last = f"{topic}: {reason}"


def stamp_seconds(stamp: Any) -> float:
    """Return a stamp in s.

    Raises:
        MessageRefused: it is none.
    """
    if stamp.sec < 0 or stamp.nanosec >= 1_000_000_000:
        raise MessageRefused(f"its stamp is none: {stamp.sec} s and {stamp.nanosec} ns")
    return seconds(stamp)


def check_ahead(ahead: float) -> None:
    """Refuse a stamp that is so far ahead (s) of this computer's clock.

    Raises:
        MessageRefused: it is.
    """
    if ahead > AHEAD:
        raise MessageRefused(f"its stamp is {ahead:.3f} s ahead of this computer's clock; set both clocks")


def stamp_and_sequence(data: bytes, longest: int) -> tuple[float, int]:
    """Return stamp (s) and sequence of a message in CDR of at most `longest` bytes, whose first fields they are.

    Raises:
        MessageRefused: it is none.
    """
    if not 24 <= len(data) <= longest:
        raise MessageRefused(f"it has {len(data)} bytes")
    order: Any = "little" if data[1] & 1 else "big"
    second, nanosecond, length = (int.from_bytes(data[at : at + 4], order) for at in (4, 8, 12))
    start = 4 + (12 + length + 7) // 8 * 8  # behind frame_id, at a multiple of its own size from behind the head
    if second >= 1 << 31 or nanosecond >= 1_000_000_000 or start + 8 > len(data):
        raise MessageRefused("its first bytes are no stamp, frame_id and sequence")
    return second + 1e-9 * nanosecond, int.from_bytes(data[start : start + 8], order)
