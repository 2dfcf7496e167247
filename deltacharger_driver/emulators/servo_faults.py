# SPDX-License-Identifier: Apache-2.0
"""Injected faults of an emulated servo bus."""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import dataclass, field

from deltacharger_driver.errors import DriverError

FAULTS = ("drop", "corrupt", "truncate", "duplicate", "garbage")
"""Faults of a reply: lost, a byte changed, cut short, sent twice, preceded by noise."""


@dataclass
class ServoFaults:
    """Faults of an emulated bus; may be changed at any time, from any thread.

    Attributes:
        missing: ids without supply: they neither receive nor answer.
        deaf: the servos receive nothing from the host and keep running.
        delay: added before every reply, s.
        rate: fault of `FAULTS` → share of affected replies, 0–1.
        servos: ids affected by `rate`; empty = all.
        rate_of: id → like `rate`, for one servo and in addition.
    """

    missing: set[int] = field(default_factory=set)
    deaf: bool = False
    delay: float = 0.0
    rate: dict[str, float] = field(default_factory=dict)
    servos: set[int] = field(default_factory=set)
    rate_of: dict[int, dict[str, float]] = field(default_factory=dict)
    _next: Counter[tuple[str, int]] = field(default_factory=Counter)

    def next_reply(self, fault: str, servo: int, count: int = 1) -> None:
        """Apply `fault` to the next `count` replies of one servo.

        Raises:
            DriverError: unknown fault.
        """
        if fault not in FAULTS:
            raise DriverError(f"unknown fault '{fault}'; known: {', '.join(FAULTS)}")
        self._next[(fault, servo)] += count

    def apply(self, servo: int, reply: bytes, random_source: random.Random) -> bytes:
        """Return `reply` after the faults."""
        if not self.rate and not self._next and not self.rate_of:
            return reply
        for fault in FAULTS:
            if self._occurs(fault, servo, random_source):
                reply = _damage(fault, reply, random_source)
        return reply

    def _occurs(self, fault: str, servo: int, random_source: random.Random) -> bool:
        if self._next[(fault, servo)] > 0:
            self._next[(fault, servo)] -= 1
            return True
        shares = [self.rate.get(fault, 0.0)] if not self.servos or servo in self.servos else []
        shares.append(self.rate_of.get(servo, {}).get(fault, 0.0))
        return any(share > 0.0 and random_source.random() < share for share in shares)


def _damage(fault: str, reply: bytes, random_source: random.Random) -> bytes:
    if not reply or fault == "drop":
        return b""
    if fault == "corrupt":
        # Behind the length, so that the packet is found and its checksum must detect the error.
        at = random_source.randrange(min(7, len(reply) - 1), len(reply))
        return reply[:at] + bytes((reply[at] ^ random_source.randrange(1, 256),)) + reply[at + 1 :]
    if fault == "truncate":
        return reply[: random_source.randrange(1, len(reply))]
    if fault == "duplicate":
        return reply + reply
    return random_source.randbytes(5) + reply


def collide(first: bytes, second: bytes, random_source: random.Random) -> bytes:
    """Return what a UART (8N1) receives from two colliding replies: the second starts 1 to 9 bits later, and 0 wins."""
    line = _bits(first)
    other = [1] * random_source.randrange(1, 10) + _bits(second)
    length = max(len(line), len(other))
    line += [1] * (length - len(line))
    other += [1] * (length - len(other))
    return _received([a & b for a, b in zip(line, other, strict=True)])


def _bits(data: bytes) -> list[int]:
    return [bit for byte in data for bit in (0, *(byte >> place & 1 for place in range(8)), 1)]


def _received(line: list[int]) -> bytes:
    """Read bytes from a line; if a stop bit is missing, keep the byte and wait until the line is idle."""
    found, at = bytearray(), 0
    line = [*line, *[1] * 10]
    while at < len(line) - 9:
        if line[at]:
            at += 1
            continue
        found.append(sum(bit << place for place, bit in enumerate(line[at + 1 : at + 9])))
        at += 9
        while at < len(line) and not line[at]:
            at += 1
    return bytes(found)
