# SPDX-License-Identifier: Apache-2.0
"""Consistent overhead byte stuffing (Cheshire and Baker, 1999): encodes any bytes without the byte zero.

A zero on the wire always marks the start or end of a packet. A reader resynchronises at the next zero after any
garbage.
"""

from __future__ import annotations

from deltacharger_core.picklable import Picklable

_LONGEST_RUN = 254


class CobsError(Picklable, ValueError):
    """Bytes that no encoder produces.

    Args:
        reason: what is wrong with them.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"not a COBS sequence: {reason}")


def encode(data: bytes) -> bytes:
    """Return `data` without zeros: one byte longer, plus one for every 254 bytes in a row without a zero.

    Args:
        data: any bytes; may be empty.

    Returns:
        The stuffed bytes, without delimiters; never empty.
    """
    out = bytearray()
    for run in data.split(b"\0"):
        if len(run) >= _LONGEST_RUN:
            run = _stuff_long(run, out)
        out.append(len(run) + 1)
        out += run
    if not run and data and data[-1]:
        del out[-1]  # a full run at the very end needs no closing code
    return bytes(out)


def _stuff_long(run: bytes, out: bytearray) -> bytes:
    """Move all full runs of 254 bytes from `run` to `out` and return the rest, which may be empty."""
    full = len(run) // _LONGEST_RUN
    for index in range(full):
        out.append(0xFF)
        out += run[index * _LONGEST_RUN : (index + 1) * _LONGEST_RUN]
    return run[full * _LONGEST_RUN :]


def decode(data: bytes) -> bytes:
    """Return the bytes that `encode` was given.

    Args:
        data: stuffed bytes without delimiters.

    Raises:
        CobsError: `data` is empty, contains a zero or ends inside a run.
    """
    if not data:
        raise CobsError("it is empty")
    if 0 in data:
        raise CobsError("it contains a zero")
    runs = []
    position, end = 0, len(data)
    while True:
        code = data[position]
        following = position + code
        runs.append(data[position + 1 : following])
        if following >= end:
            break
        if code != 0xFF:
            runs.append(b"\0")
        position = following
    if following > end:
        raise CobsError(f"it ends {following - end} bytes inside a run")
    return b"".join(runs)
