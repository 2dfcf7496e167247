# SPDX-License-Identifier: Apache-2.0
"""The wire between an emulated device and its host: damage and delay of packets."""

import math
import random
from collections import Counter, deque

KINDS = ("drop", "corrupt", "truncate", "garbage", "duplicate")


class WireFaults:
    """Damages packets on their way from an emulated device to the host; may be changed at any time.

    A sender is a servo's id or the board's type of packet.

    Attributes:
        rate: share, 0 to 1, of all packets that each kind affects. drop: it vanishes; corrupt: a bit flips; truncate:
            its end is missing; garbage: 1 to 64 random bytes precede it; duplicate: it is sent twice.
        rate_of: the same for one sender, in addition.
        missing: senders without supply.
        silent: nothing leaves the device, which keeps running.
        deaf: nothing reaches the device, which keeps running.
        delay: s, of every packet.

    Args:
        seed: of the damage.
        head: bytes at the start that corruption spares, so that the host finds the packet.
    """

    def __init__(self, seed: int | None = None, head: int = 1) -> None:
        self.rate: dict[str, float] = {}
        self.rate_of: dict[int, dict[str, float]] = {}
        self.missing: set[int] = set()
        self.silent = self.deaf = False
        self.delay = 0.0
        self._random, self._head = random.Random(seed), head
        self._next: Counter[tuple[str, int | None]] = Counter()

    def inject(self, kind: str, count: int = 1, sender: int | None = None) -> None:
        """Apply `kind` to the next `count` packets of one sender, or of any.

        Raises:
            ValueError: unknown kind.
        """
        if kind not in KINDS:
            raise ValueError(f"unknown wire fault '{kind}'; known: {', '.join(KINDS)}")
        self._next[kind, sender] += count

    def apply(self, packet: bytes, sender: int) -> bytes:
        """Return a packet of a sender after the faults."""
        if self.silent:
            return b""
        for kind in KINDS if self.rate or self.rate_of or self._next else ():
            if self._occurs(kind, sender):
                packet = self._damage(packet, kind)
        return packet

    def _occurs(self, kind: str, sender: int) -> bool:
        for key in ((kind, sender), (kind, None)):
            if self._next[key] > 0:
                self._next[key] -= 1
                return True
        shares = self.rate.get(kind, 0.0), self.rate_of.get(sender, {}).get(kind, 0.0)
        return any(share > 0.0 and self._random.random() < share for share in shares)

    def _damage(self, packet: bytes, kind: str) -> bytes:
        if kind == "drop" or not packet:
            return b""
        if kind == "duplicate":
            return packet + packet
        if kind == "garbage":
            return self._random.randbytes(self._random.randrange(1, 65)) + packet
        if kind == "truncate":
            return packet[: self._random.randrange(1, len(packet))]
        damaged, first = bytearray(packet), min(self._head, len(packet) - 2)
        damaged[self._random.randrange(first, len(packet) - 1)] ^= 1 << self._random.randrange(8)
        return bytes(damaged)


class DelayLine:
    """A wire with delay; packets never overtake each other.

    Attributes:
        due: when the next packet arrives, s; inf = none.
    """

    def __init__(self) -> None:
        self.due = math.inf
        self._packets: deque[tuple[float, bytes]] = deque()

    def send(self, packet: bytes, at: float) -> None:
        """Let a packet arrive `at` s, or after the one before if that is later."""
        self._packets.append((max(at, self._packets[-1][0]) if self._packets else at, packet))
        self.due = self._packets[0][0]

    def arrived(self, now: float) -> bytes:
        """Return the bytes that have arrived."""
        arrived = bytearray()
        while self._packets and self._packets[0][0] <= now:
            arrived += self._packets.popleft()[1]
        self.due = self._packets[0][0] if self._packets else math.inf
        return bytes(arrived)
