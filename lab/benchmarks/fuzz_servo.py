# SPDX-License-Identifier: Apache-2.0
"""Damaged replies and instructions of servos, decoded by the driver and by the emulator.

"Escapes" are replies with a right checksum and wrong data.
"""

from __future__ import annotations

import random
import struct
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from fuzz_wire import BODY_AT, LONGEST_BURST, SERVO_DAMAGE, flip

from deltacharger_driver.errors import RangeError
from deltacharger_driver.servos.packets import READ, InstructionParser, status
from deltacharger_driver.servos.protocol import ServoProtocol, crc16
from deltacharger_driver.servos.snapshot import (
    CURRENT_SPAN,
    HIGHEST_VOLTAGE,
    HOTTEST,
    LOWEST_VOLTAGE,
    READ_ADDRESS,
    READ_LENGTH,
    Reading,
    decode_block,
    has_restarted,
)

SERVO = 1
BLOCK = struct.Struct("<BBhiiHBBBB")


class Line:
    """A port for a protocol handler: one reply, then silence."""

    def __init__(self) -> None:
        self.is_using = False
        self.packet_timeout = 0.0
        self._waiting = b""

    def answer(self, reply: bytes) -> None:
        self._waiting = reply

    def received(self) -> bytes:
        return self._waiting

    def discard(self, length: int) -> None:
        self._waiting = self._waiting[length:]

    def readPort(self, length: int) -> bytes:  # noqa: N802
        data = self._waiting[: max(length, 0)]
        self.discard(len(data))
        return data

    def writePort(self, packet: list[int]) -> int:  # noqa: N802
        return len(packet)

    def isPacketTimeout(self) -> bool:  # noqa: N802
        return not self._waiting

    def clearPort(self) -> None:  # noqa: N802
        return None

    def drain(self, quiet: float = 0.0) -> None:
        return None

    def setPacketTimeout(self, length: int) -> None:  # noqa: N802
        return None


class ServoSide:
    """Decodes replies as the bus does: by the real protocol handler, with the expected length."""

    def __init__(self) -> None:
        self.line = Line()
        self.protocol = ServoProtocol()

    def receive(self, wire: bytes) -> bytes | None:
        """Return the data of the reply that passes checksum, id and length."""
        self.line.answer(wire)
        replies = self.protocol.sync_read(self.line, (SERVO,), READ_ADDRESS, READ_LENGTH)  # type: ignore[arg-type]
        reply = replies.get(SERVO)
        return reply[1] if reply is not None and len(reply[1]) == READ_LENGTH else None


def in_range(reading: Reading) -> bool:
    return (
        abs(reading.current) <= CURRENT_SPAN
        and LOWEST_VOLTAGE <= reading.voltage <= HIGHEST_VOLTAGE
        and 0 <= reading.temperature <= HOTTEST
    )


def random_block(source: random.Random) -> bytes:
    """Return a servo's read block within the limits of a healthy arm."""
    return BLOCK.pack(
        source.randrange(2),
        0,
        source.randrange(-900, 901),
        source.randrange(-285, 286),
        source.randrange(1000, 3100),
        source.randrange(100, 130),
        source.randrange(15, 80),
        6,
        2,
        0,
    )


def fuzz_servo(count: int, seed: int) -> dict[str, Any]:
    """Damage replies, decode them, and count those that pass the checksum and those that reach the snapshot."""
    source, side = random.Random(seed), ServoSide()
    tries: Counter[str] = Counter()
    escapes: Counter[str] = Counter()
    accepted: Counter[str] = Counter()
    out_of_range = 0
    for index in range(count):
        kind = list(SERVO_DAMAGE)[index % len(SERVO_DAMAGE)]
        sent = random_block(source)
        wire = status(SERVO, 0, sent)
        damaged = SERVO_DAMAGE[kind](source, wire)
        tries[kind] += 1
        data = side.receive(damaged)
        if data is None or data == sent:
            continue
        escapes[kind] += 1
        try:
            reading = decode_block(data)
        except RangeError:
            continue
        accepted[kind] += 1
        out_of_range += not in_range(reading)
    return {
        "packets": count,
        "escapes": {kind: escapes[kind] for kind in tries},
        "false_accepts": {kind: accepted[kind] for kind in tries},
        "false_accepts_per_million": {kind: 1e6 * accepted[kind] / tries[kind] for kind in tries},
        "out_of_range": out_of_range,
    }


def syndromes(wire: bytes, least_first: bool) -> np.ndarray[Any, np.dtype[np.uint16]]:
    """Return for each bit of a packet the effect of its flip on the difference of both checksums (linear)."""
    right = crc16(wire[:-2])
    differences = []
    for bit in range(8 * len(wire)):
        damaged = flip(wire, [bit], least_first)
        written = int.from_bytes(damaged[-2:], "little")
        differences.append(crc16(damaged[:-2]) ^ right ^ written ^ right)
    return np.array(differences, np.uint16)


def every_burst(least_first: bool) -> Iterator[list[int]]:
    """Find all bursts of up to 16 bits after the length field that keep the checksum right."""
    wire = status(SERVO, 0, bytes(BLOCK.size))
    effect = syndromes(wire, least_first)
    patterns = np.arange(1, 1 << LONGEST_BURST, 2, dtype=np.uint32)  # the first bit of a burst is always flipped
    for start in range(8 * BODY_AT, 8 * len(wire)):
        span = min(LONGEST_BURST, 8 * len(wire) - start)
        difference = np.zeros(len(patterns), np.uint16)
        for bit in range(span):
            difference[(patterns >> bit & 1).astype(bool)] ^= effect[start + bit]
        for pattern in patterns[(difference == 0) & (patterns < 1 << span)].tolist():
            yield [start + bit for bit in range(span) if pattern >> bit & 1]


def exhaust_bursts(seed: int) -> dict[str, Any]:
    """Send every burst that CRC-16 cannot detect, over several replies, through the real reader.

    Replies with byte stuffing are left out, because a burst may change their length. `fuzz_servo` has them.
    """
    source, side = random.Random(seed), ServoSide()
    result: dict[str, Any] = {}
    for order, least_first in (("packet_order", False), ("wire_order", True)):
        unseen = list(every_burst(least_first))
        accepted, restarted, tail = 0, 0, 0
        for bits in unseen:
            tail += bits[-1] // 8 >= 9 + READ_LENGTH
            for _ in range(20):
                sent = random_block(source)
                data = side.receive(flip(status(SERVO, 0, sent), bits, least_first))
                if data is None or data == sent:
                    continue
                restarted += has_restarted(data)
                try:
                    decode_block(data)
                except RangeError:
                    continue
                accepted += 1
        result[order] = {
            "unseen_by_crc": len(unseen),
            "of_these_touching_the_crc": tail,
            "replies_tried": 20 * len(unseen),
            "in_the_snapshot": accepted,
            "taken_for_a_restart": restarted,
        }
    return result


def fuzz_instructions(count: int, seed: int) -> dict[str, Any]:
    """Damage instructions to a servo and decode them with the emulator."""
    source, parser = random.Random(seed), InstructionParser(protocol_1=True)
    found = Counter({True: 0, False: 0})
    kinds = list(SERVO_DAMAGE.values())
    for index in range(count):
        head = b"\xff\xff\xfd\x00" + bytes((SERVO, 7, 0, READ)) + struct.pack("<HH", READ_ADDRESS, READ_LENGTH)
        wire = kinds[index % len(kinds)](source, head + crc16(head).to_bytes(2, "little"))
        found.update(instruction.intact for instruction in parser.feed(wire, float(index)))
    return {"packets": count, "intact": found[True], "bad_checksum": found[False]}
