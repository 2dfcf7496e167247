# SPDX-License-Identifier: Apache-2.0
"""Refuses messages with invalid or future stamps or invalid bytes, and counts refusals."""

from __future__ import annotations

from typing import Any

from deltacharger_ros.messages import seconds


class MessageRefused(Exception):
    """A message is refused. Example: its stamp lies in the future."""


class Refusals:
    """Refused messages.

    Attributes:
        count: number of messages.
        last: reason of the last one.
    """

    def __init__(self) -> None:
        self.count = 0
        self.last = ""

    def add(self, topic: str, reason: str) -> None:
        """Count a refused message."""
        self.count += 1
        self.last = f"{topic}: {reason}"


def stamp_seconds(stamp: Any) -> float:
    """Return a stamp in s.

    Raises:
        MessageRefused: the stamp is invalid.
    """
    if stamp.sec < 0 or stamp.nanosec >= 1_000_000_000:
        raise MessageRefused(f"its stamp is invalid: {stamp.sec} s and {stamp.nanosec} ns")
    return seconds(stamp)


def stamp_and_sequence(data: bytes, longest: int) -> tuple[float, int]:
    """Return stamp (s) and sequence, the first fields of a CDR message of at most `longest` bytes.

    Raises:
        MessageRefused: the bytes are invalid.
    """
    if not 24 <= len(data) <= longest:
        raise MessageRefused(f"it has {len(data)} bytes; allowed are 24 to {longest}")
    order: Any = "little" if data[1] & 1 else "big"
    second, nanosecond, length = (int.from_bytes(data[at : at + 4], order) for at in (4, 8, 12))
    start = 4 + (12 + length + 7) // 8 * 8  # behind frame_id, aligned to its size from the end of the CDR header
    if second >= 1 << 31 or nanosecond >= 1_000_000_000 or start + 8 > len(data):
        raise MessageRefused("it does not begin with a valid stamp, frame_id and sequence")
    return second + 1e-9 * nanosecond, int.from_bytes(data[start : start + 8], order)
