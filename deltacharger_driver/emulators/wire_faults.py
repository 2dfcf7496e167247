# SPDX-License-Identifier: Apache-2.0
"""Injected wire faults for emulators: packets dropped, damaged, cut short, surrounded by noise."""

from __future__ import annotations

import collections
import math
from dataclasses import dataclass

import numpy as np

KINDS = ("drop", "corrupt", "truncate", "garbage", "duplicate")


class DelayLine:
    """A wire with delay; packets never overtake each other.

    Attributes:
        due: when the next packet arrives, s; inf = none.
    """

    def __init__(self) -> None:
        self.due = math.inf
        self._packets: collections.deque[tuple[float, bytes]] = collections.deque()

    def pass_on(self, packets: list[bytes], delay: float, now: float) -> bytes:
        """Send packets to arrive `delay` s later, or after the one before if that is later; return arrived bytes."""
        if not delay and not self._packets:
            return b"".join(packets)
        for packet in packets:
            last = self._packets[-1][0] if self._packets else now
            self._packets.append((max(now + delay, last), packet))
        arrived = bytearray()
        while self._packets and self._packets[0][0] <= now:
            arrived += self._packets.popleft()[1]
        self.due = self._packets[0][0] if self._packets else math.inf
        return bytes(arrived)


@dataclass
class _Injection:
    kind: str
    count: int
    type: int | None


class WireFaults:
    """Damages packets on their way from an emulated device to the host.

    Attributes:
        probability: of each kind for every packet, initially 0. drop: it vanishes; corrupt: a bit flips; truncate:
            its end is missing, delimiter included; garbage: 1 to 64 random bytes precede it; duplicate: it is sent
            twice.
        silent: nothing leaves the device, which keeps running.
        deaf: nothing reaches the device, which keeps running.
        delay: s, of every packet.

    Args:
        seed: of the damage.
    """

    def __init__(self, seed: int | None = None) -> None:
        self.probability = dict.fromkeys(KINDS, 0.0)
        self.silent = False
        self.deaf = False
        self.delay = 0.0
        self._random = np.random.default_rng(seed)
        self._injections: list[_Injection] = []

    def inject(self, kind: str, count: int = 1, type: int | None = None) -> None:
        """Apply `kind` to the next `count` packets of one type, or of any.

        Raises:
            ValueError: unknown kind.
        """
        if kind not in KINDS:
            raise ValueError(f"unknown wire fault '{kind}'; known: {', '.join(KINDS)}")
        self._injections.append(_Injection(kind, count, type))

    def apply(self, packet: bytes, type: int) -> bytes:
        """Return a packet (with its delimiters) of a type after the faults."""
        if self.silent:
            return b""
        for kind in self._draw(type):
            packet = self._damage(packet, kind)
        return packet

    def _draw(self, type: int) -> list[str]:
        kinds = [kind for kind, chance in self.probability.items() if chance and self._random.random() < chance]
        for injection in self._injections:
            if injection.type in (None, type) and injection.count > 0:
                injection.count -= 1
                kinds.append(injection.kind)
        self._injections = [injection for injection in self._injections if injection.count > 0]
        return kinds

    def _damage(self, packet: bytes, kind: str) -> bytes:
        if kind == "drop" or not packet:
            return b""
        if kind == "duplicate":
            return packet + packet
        if kind == "garbage":
            return self._random.bytes(int(self._random.integers(1, 65))) + packet
        if kind == "truncate":
            return packet[: int(self._random.integers(1, len(packet)))]
        damaged = bytearray(packet)
        damaged[int(self._random.integers(1, len(packet) - 1))] ^= 1 << int(self._random.integers(8))
        return bytes(damaged)
