# SPDX-License-Identifier: Apache-2.0
"""Damaged packets of the board, and intact packets that no board sends, decoded by the driver."""

from __future__ import annotations

import math
import random
import struct
import zlib
from typing import Any

import numpy as np
from fuzz_wire import BOARD_DAMAGE

from deltacharger_driver.board import cobs
from deltacharger_driver.board.payloads import (
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
from deltacharger_driver.board.protocol import (
    Packet,
    PacketDecoder,
    PacketError,
    PacketType,
    SampleFormat,
    check_header,
    encode_packet,
)


def random_payload(source: random.Random, kind: PacketType) -> tuple[bytes, int]:
    """Return a payload of the board and its sample format."""
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
    """Return an intact packet with a random header and payload."""
    size = source.choice((0, 1, 4, 8, 12, 16, 20, 64, 200, 300, 400, source.randrange(500)))
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
    """Decode a packet as the receiver does; None if it is refused, else whether all values are valid."""
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


def fuzz_board(count: int, seed: int) -> dict[str, Any]:
    """Damage packets and make up intact ones; count what the decoder and the payload readers accept."""
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
