"""What the driver's codecs do with noise: `python benchmarks/driver_fuzz.py [--packets 1000000] [--json]`.

Ends with 1 where a promise is broken: no input raises, what is accepted passes the range checks, nothing false passes
CRC-32, no burst of up to 16 bits in packet order ends in a servo's snapshot, and of other damage at most 40 in a
million. Some minutes on one core with the default.

A burst of n bits flips its first and its last bit and any between them; its place is counted in one of two orders:

- packet order: bytes as they stand in the packet, each from its most significant bit. CRC-16 divides in this order, but
  for its own two bytes, of which the low one stands first.
- wire order: the same bytes, each from its least significant bit, as a UART sends them (start and stop bits left out).

"Escapes" are replies whose checksum is right and whose data is not what was sent.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import struct
import sys
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from deltacharger_driver import cobs
from deltacharger_driver.board_payloads import (
    Ack,
    Hello,
    Power,
    decode_ack,
    decode_hello,
    decode_ping,
    decode_power,
    decode_probe,
    decode_samples,
    encode_ack,
    encode_hello,
    encode_power,
    encode_probe,
    encode_samples,
)
from deltacharger_driver.board_protocol import (
    Packet,
    PacketDecoder,
    PacketError,
    PacketType,
    SampleFormat,
    check_header,
    encode_packet,
)
from deltacharger_driver.errors import RangeError
from deltacharger_driver.servo_packets import READ, InstructionParser, status
from deltacharger_driver.servo_protocol import ServoProtocol, crc16
from deltacharger_driver.servo_snapshot import (
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
ALLOWED_PER_MILLION = 40.0
LONGEST_BURST = 16
BLOCK = struct.Struct("<BBhiiHBBB")
BODY_AT = 7  # of a status packet: behind the length, which a damaged one must not change to be found at all


class Line:
    """The port that a protocol handler sees: one reply, then silence."""

    def __init__(self) -> None:
        self.is_using = False
        self.packet_timeout = 0.0
        self._waiting = b""

    def answer(self, reply: bytes) -> None:
        self._waiting = reply

    def readPort(self, length: int) -> bytes:  # noqa: N802
        data, self._waiting = self._waiting[: max(length, 0)], self._waiting[max(length, 0) :]
        return data

    def writePort(self, packet: list[int]) -> int:  # noqa: N802
        return len(packet)

    def isPacketTimeout(self) -> bool:  # noqa: N802
        return not self._waiting

    def clearPort(self) -> None:  # noqa: N802
        return None

    def drain(self) -> None:
        return None

    def setPacketTimeout(self, length: int) -> None:  # noqa: N802
        return None


class ServoSide:
    """Replies as the bus reads them: by the real protocol handler, which is told the expected length."""

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
    """A servo's read block as one reports it: within the limits of a healthy arm."""
    return BLOCK.pack(
        source.randrange(2),
        0,
        source.randrange(-900, 901),
        source.randrange(-285, 286),
        source.randrange(1000, 3100),
        source.randrange(100, 130),
        source.randrange(15, 80),
        2,
        0,
    )


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
    """Replace everything behind the length by noise, so that only the checksum stands between it and the data."""
    return wire[:BODY_AT] + b"\x55" + source.randbytes(len(wire) - BODY_AT - 1)


def cut_and_joined(source: random.Random, wire: bytes) -> bytes:
    """Lose, repeat or insert up to 20 bytes; or lay one piece over another."""
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


def fuzz_servo(count: int, seed: int) -> dict[str, Any]:
    """Damage replies, read them back, and tell what came through the checksum and what into the snapshot."""
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
    """Return for each bit of a packet what flipping it does to the difference of both checksums; it is linear."""
    right = crc16(wire[:-2])
    differences = []
    for bit in range(8 * len(wire)):
        damaged = flip(wire, [bit], least_first)
        written = int.from_bytes(damaged[-2:], "little")
        differences.append(crc16(damaged[:-2]) ^ right ^ written ^ right)
    return np.array(differences, np.uint16)


def every_burst(least_first: bool) -> Iterator[list[int]]:
    """Find all bursts of up to 16 bits behind the length that leave the checksum right."""
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
    """Send every burst that CRC-16 cannot see, over several replies, through the real reader.

    Replies with byte stuffing are left out: there a burst may change the length too. `fuzz_servo` has them.
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


def random_payload(source: random.Random, kind: PacketType) -> tuple[bytes, int]:
    """A payload as the board sends it, and its sample format."""
    if kind is PacketType.TACTILE:
        sample_format = source.choice((SampleFormat.U8, SampleFormat.U12, SampleFormat.U16))
        forces = np.random.default_rng(source.getrandbits(32)).uniform(0.0, 10.0, 200)
        return encode_samples(forces[:100], forces[100:], sample_format), sample_format
    if kind is PacketType.POWER:
        charge = source.choice((math.nan, 3.0))
        return encode_power(Power(26.5, 24.0, charge, source.random() < 0.5, source.randrange(10))), 0
    if kind is PacketType.HELLO:
        return encode_hello(Hello(1, 0, 10, 10, source.getrandbits(32), 120.0)), 0
    if kind is PacketType.ACK:
        data = encode_probe(25.5, 24.0) if source.random() < 0.5 else b""
        return encode_ack(Ack(source.randrange(1, 13), source.randrange(5), source.getrandbits(16), data)), 0
    return source.randbytes(source.randrange(65)), 0


FROM_BOARD = (PacketType.TACTILE, PacketType.POWER, PacketType.HELLO, PacketType.PING, PacketType.ACK)


def random_packet(source: random.Random) -> Packet:
    kind = source.choice(FROM_BOARD)
    payload, sample_format = random_payload(source, kind)
    flags = source.randrange(4) if kind is PacketType.TACTILE else 0
    return Packet(kind, payload, source.getrandbits(16), source.getrandbits(40), flags, sample_format)


def made_up(source: random.Random) -> bytes:
    """An intact packet with a header and a payload that nobody would send."""
    size = source.choice((0, 1, 4, 8, 12, 16, 64, 200, 300, 400, source.randrange(500)))
    payload = source.choice((bytes(size), source.randbytes(size), b"\x7f\x80" * (size // 2)))
    header = struct.pack(
        "<BBHQBBH",
        source.choice((1, 1, 1, 1, source.randrange(256))),
        source.choice((*FROM_BOARD, source.randrange(256))),
        source.getrandbits(16),
        source.getrandbits(64),
        source.choice((0, 0, source.randrange(256))),
        source.choice((0, 1, 2, 3, source.randrange(256))),
        source.choice((0, 0, 0, source.getrandbits(16))),
    )
    body = header + payload
    return b"\0" + cobs.encode(body + struct.pack("<I", zlib.crc32(body))) + b"\0"


def meaning_in_range(packet: Packet) -> bool | None:
    """Read a packet as the receiver does; None where it is refused, else whether every value is one that may be."""
    try:
        check_header(packet)
        if packet.type == PacketType.TACTILE:
            forces = np.concatenate(decode_samples(packet.payload, packet.format))
            return bool(((forces >= 0.0) & (forces <= 10.0) | np.isnan(forces)).all())
        if packet.type == PacketType.POWER:
            power = decode_power(packet.payload)
            values = (power.battery_voltage, power.target_voltage, power.charge_current)
            return not any(map(math.isinf, values)) and 0 <= power.fault <= 9
        if packet.type == PacketType.HELLO:
            return 0.0 <= decode_hello(packet.payload).rate < math.inf
        if packet.type == PacketType.ACK:
            ack = decode_ack(packet.payload)
            if ack.type == PacketType.PROBE and ack.data:
                resistance, voltage = decode_probe(ack.data)
                return resistance != -math.inf and not math.isinf(voltage)
            return True
        if packet.type == PacketType.PING:
            return len(decode_ping(packet.payload)) <= 64
    except PacketError:
        return None
    return None  # a type that the board does not send


BOARD_DAMAGE: dict[str, Callable[[random.Random, bytes], bytes]] = {
    "burst": lambda source, wire: burst(source, wire, source.random() < 0.5),
    "scattered_bits": scattered,
    "cut_and_joined": cut_and_joined,
    "noise": noise,
}


def fuzz_board(count: int, seed: int) -> dict[str, Any]:
    """Damage packets and invent intact ones; tell what the decoder and the payload readers took."""
    source, decoder = random.Random(seed), PacketDecoder()
    originals = [random_packet(source) for _ in range(2000)]
    wires = [encode_packet(packet) for packet in originals]
    known = set(originals)
    false_accepts = intact = invented = taken = refused = out_of_range = 0
    kinds = [*BOARD_DAMAGE, "made_up"]
    for index in range(count):
        kind = kinds[index % len(kinds)]
        wire = made_up(source) if kind == "made_up" else BOARD_DAMAGE[kind](source, source.choice(wires))
        for packet in decoder.feed(b"\0" + wire + b"\0"):
            if kind == "made_up":
                invented += 1
            else:
                intact += packet in known
                false_accepts += packet not in known
            judged = meaning_in_range(packet)
            refused += judged is None
            taken += judged is not None
            out_of_range += judged is False
    counters = decoder.counters
    return {
        "packets": count,
        "false_accepts": false_accepts,
        "undamaged_after_all": intact,
        "made_up_and_intact": invented,
        "payloads_taken": taken,
        "payloads_refused": refused,
        "out_of_range": out_of_range,
        "damaged": counters.damaged,
        "other_version": counters.version_errors,
        "reserved_not_0": counters.header_errors,
    }


def fuzz_instructions(count: int, seed: int) -> dict[str, Any]:
    """Damage instructions to a servo as the emulator reads them."""
    source, parser = random.Random(seed), InstructionParser(protocol_1=True)
    found = Counter({True: 0, False: 0})
    kinds = list(SERVO_DAMAGE.values())
    for index in range(count):
        head = b"\xff\xff\xfd\x00" + bytes((SERVO, 7, 0, READ)) + struct.pack("<HH", READ_ADDRESS, READ_LENGTH)
        wire = kinds[index % len(kinds)](source, head + crc16(head).to_bytes(2, "little"))
        found.update(instruction.intact for instruction in parser.feed(wire, float(index)))
    return {"packets": count, "intact": found[True], "bad_checksum": found[False]}


def broken_promises(result: dict[str, Any]) -> list[str]:
    servo, board, bursts = result["servo_reply"], result["board_link"], result["every_burst"]
    broken = []
    if servo["false_accepts"]["burst_packet_order"] or bursts["packet_order"]["in_the_snapshot"]:
        broken.append("a burst of up to 16 bits in packet order reached the snapshot")
    for kind, rate in servo["false_accepts_per_million"].items():
        if rate > ALLOWED_PER_MILLION:
            broken.append(f"{kind}: {rate:.1f} false replies per million, allowed {ALLOWED_PER_MILLION:.0f}")
    if board["false_accepts"]:
        broken.append(f"{board['false_accepts']} false packets passed CRC-32")
    if servo["out_of_range"] or board["out_of_range"]:
        broken.append("an accepted packet carries a value out of range")
    return broken


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--packets", type=int, default=1_000_000, help="per codec (default 1000000)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="one JSON object instead of text")
    arguments = parser.parse_args()
    if arguments.packets < len(SERVO_DAMAGE):
        parser.error(f"--packets must be at least {len(SERVO_DAMAGE)}")
    started = time.monotonic()
    result: dict[str, Any] = {
        "servo_reply": fuzz_servo(arguments.packets, arguments.seed),
        "every_burst": exhaust_bursts(arguments.seed),
        "board_link": fuzz_board(arguments.packets, arguments.seed),
        "servo_instruction": fuzz_instructions(arguments.packets, arguments.seed),
    }
    result["seconds"] = round(time.monotonic() - started, 1)
    result["broken"] = broken_promises(result)
    if arguments.json:
        print(json.dumps(result))
    else:
        for name, figures in result.items():
            print(f"{name}: {json.dumps(figures, indent=2) if isinstance(figures, dict) else figures}")
    return 1 if result["broken"] else 0


if __name__ == "__main__":
    sys.exit(main())
