# SPDX-License-Identifier: Apache-2.0
"""Random damage of bytes on a line.

A burst of n bits flips its first and its last bit and any between them. Its position has one of two orders:

- packet order: bytes as in the packet, each from its most significant bit. CRC-16 uses this order, except for its own
  two bytes, of which the low one is first.
- wire order: bytes as in the packet, each from its least significant bit, as a UART sends them (no start, no stop bit).
"""

from __future__ import annotations

import random
from collections.abc import Callable

LONGEST_BURST = 16
BODY_AT = 7  # of a status packet: after the length, which must be intact for the packet to be found


def flip(wire: bytes, bits: list[int], least_first: bool) -> bytes:
    damaged = bytearray(wire)
    for bit in bits:
        damaged[bit // 8] ^= 1 << (bit % 8 if least_first else 7 - bit % 8)
    return bytes(damaged)


def burst(source: random.Random, wire: bytes, least_first: bool) -> bytes:
    """Flip a burst of 2 to 16 bits that begins anywhere in the packet."""
    length = source.randrange(2, LONGEST_BURST + 1)
    start = source.randrange(8 * len(wire) - length + 1)
    inner = source.getrandbits(length) | 1 | 1 << length - 1
    return flip(wire, [start + i for i in range(length) if inner >> i & 1], least_first)


def scattered(source: random.Random, wire: bytes) -> bytes:
    """Flip 2 to 40 bits anywhere."""
    return flip(wire, source.sample(range(8 * len(wire)), source.randrange(2, 41)), False)


def overwritten(source: random.Random, wire: bytes) -> bytes:
    """Replace everything after the length by noise, so that only the checksum can detect it."""
    return wire[:BODY_AT] + b"\x55" + source.randbytes(len(wire) - BODY_AT - 1)


def cut_and_joined(source: random.Random, wire: bytes) -> bytes:
    """Lose, repeat or insert up to 20 bytes, or overlap pieces."""
    at, size = source.randrange(len(wire)), source.randrange(1, 21)
    kind = source.randrange(5)
    if kind == 0:
        return wire[:at]
    if kind == 1:
        return wire[:at] + wire[at + size :]
    if kind == 2:
        return wire[:at] + source.randbytes(size) + wire[at:]
    if kind == 3:
        return wire[:at] + wire[max(at - size, 0) :]
    return source.randbytes(size) + wire[: at + 1] + wire[at:]


def noise(source: random.Random, wire: bytes) -> bytes:
    return source.randbytes(source.randrange(1, 60))


SERVO_DAMAGE: dict[str, Callable[[random.Random, bytes], bytes]] = {
    "burst_packet_order": lambda source, wire: burst(source, wire, False),
    "burst_wire_order": lambda source, wire: burst(source, wire, True),
    "scattered_bits": scattered,
    "body_overwritten": overwritten,
    "cut_and_joined": cut_and_joined,
    "noise": noise,
}


BOARD_DAMAGE: dict[str, Callable[[random.Random, bytes], bytes]] = {
    "burst": lambda source, wire: burst(source, wire, source.random() < 0.5),
    "scattered_bits": scattered,
    "cut_and_joined": cut_and_joined,
    "noise": noise,
}
