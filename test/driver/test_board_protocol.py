# SPDX-License-Identifier: Apache-2.0
"""The packets of docs/board-link.md: golden bytes, headers, COBS, and recovery from wire faults."""

from __future__ import annotations

import contextlib
import itertools
import math
import struct
import zlib

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from deltacharger_driver.board import cobs
from deltacharger_driver.board.payloads import (
    Ack,
    Hello,
    Power,
    encode_ack,
    encode_hello,
    encode_power,
    encode_probe,
    encode_rate,
)
from deltacharger_driver.board.protocol import (
    Packet,
    PacketDecoder,
    PacketError,
    PacketType,
    check_header,
    encode_packet,
)

# Made with an independent encoder (bitwise CRC, byte-by-byte COBS).
GOLDEN = [
    (Packet(12), "0003010c01010101010101010101010101052073260700"),
    (Packet(3, b"", 5), "000401030501010101010101010101010105d0de0dd700"),
    (Packet(8, b"\1", 0x1234), "0005010834120101010101010101010101060154a95a8b00"),
    (Packet(7, encode_rate(60.0), 1), "000401070101010101010101010101010101010770422bc4337800"),
    (
        Packet(2, encode_power(Power(26.5, 24.0, math.nan, True, 0)), 7, 1_500_000),
        "00040102070460e3160101010101010101010103d4410103c0410104c07f01010105c33ed60300",
    ),
    (
        Packet(3, encode_hello(Hello(1, 0, 10, 10, 0xDEADBEEF, 120.0))),
        "00030103010101010101010101010101010201070a0aefbeadde0107f04236f06b1e00",
    ),
    (
        Packet(10, encode_ack(Ack(11, 0, 9, encode_probe(25.5, 24.0))), 3, 2_000_000),
        "0004010a030480841e0101010101010101020b0209010103cc410107c041e651230c00",
    ),
    (Packet(10, encode_ack(Ack(8, 3, 1)), 0, 1), "0003010a010201010101010101010101010408030105d98d266700"),
]


packets = st.builds(
    Packet,
    type=st.integers(0, 255),
    payload=st.binary(max_size=500),
    sequence=st.integers(0, 65535),
    device_time_us=st.integers(0, 2**64 - 1),
    flags=st.integers(0, 255),
    format=st.integers(0, 255),
)


@pytest.mark.parametrize(("packet", "wire"), GOLDEN)
def test_golden_bytes(packet: Packet, wire: str) -> None:
    assert encode_packet(packet).hex() == wire
    assert PacketDecoder().feed(bytes.fromhex(wire)) == [packet]


@settings(max_examples=40)
@given(st.lists(packets, max_size=5), st.integers(1, 64))
def test_packets_survive_any_splitting(sent: list[Packet], step: int) -> None:
    stream = b"".join(encode_packet(packet) for packet in sent)
    decoder = PacketDecoder()
    received = [p for i in range(0, len(stream), step) for p in decoder.feed(stream[i : i + step])]
    assert received == sent
    assert decoder.counters.packets == len(sent)
    assert decoder.counters.damaged == 0


@given(st.lists(st.binary(max_size=3000), max_size=8))
def test_garbage_never_raises_and_never_outlasts_the_next_packet(pieces: list[bytes]) -> None:
    decoder = PacketDecoder()
    for piece in pieces:
        decoder.feed(piece)
    decoder.feed(b"\0")
    good = Packet(PacketType.PING, b"hello")
    assert decoder.feed(encode_packet(good)) == [good]


@given(packets, st.data())
def test_a_truncated_packet_loses_only_itself(packet: Packet, data: st.DataObject) -> None:
    """The leading delimiter of the next packet ends the damaged one."""
    wire = encode_packet(packet)
    cut = data.draw(st.integers(0, len(wire) - 2))
    decoder = PacketDecoder()
    follower = Packet(PacketType.PING, b"next", 1)
    assert decoder.feed(wire[:cut] + encode_packet(follower)) == [follower]


@settings(max_examples=60)
@given(packets, st.data())
def test_a_flipped_bit_is_detected(packet: Packet, data: st.DataObject) -> None:
    wire = bytearray(encode_packet(packet))
    wire[data.draw(st.integers(1, len(wire) - 2))] ^= 1 << data.draw(st.integers(0, 7))
    decoder = PacketDecoder()
    assert decoder.feed(bytes(wire)) == []
    assert decoder.counters.damaged > 0


def test_noise_between_packets_is_counted_by_kind() -> None:
    decoder = PacketDecoder()
    short = cobs.encode(b"too short")
    body = b"\1" * 16
    wrong = cobs.encode(body + struct.pack("<I", zlib.crc32(body) ^ 1))
    decoder.feed(b"\0" + short + b"\0" + wrong + b"\0\xff\1\0" + b"\1" * 5000 + b"\0")
    counters = decoder.counters
    assert (counters.length_errors, counters.crc_errors, counters.cobs_errors, counters.packets) == (2, 1, 1, 0)


def test_memory_is_bounded_without_a_delimiter() -> None:
    decoder = PacketDecoder(longest=500)
    for _ in range(1000):
        decoder.feed(b"\1" * 400)
    assert len(decoder._rest) <= 900
    packet = Packet(PacketType.PING, b"alive")
    assert decoder.feed(encode_packet(packet)) == [packet]
    assert decoder.counters.length_errors == 1


@pytest.mark.parametrize("version", [0, 2, 255])
def test_another_major_version_is_refused_named_and_counted(version: int) -> None:
    decoder = PacketDecoder()
    assert decoder.feed(encode_packet(Packet(PacketType.POWER, b"x" * 16), version)) == []
    assert (decoder.counters.version_errors, decoder.counters.refused_version) == (1, version)


@pytest.mark.parametrize("at", [14, 15])
def test_reserved_bytes_of_the_header_must_be_zero(at: int) -> None:
    body = bytearray(cobs.decode(encode_packet(Packet(PacketType.POWER, bytes(16)))[1:-1])[:-4])
    body[at] = 1
    decoder = PacketDecoder()
    assert decoder.feed(b"\0" + cobs.encode(bytes(body) + struct.pack("<I", zlib.crc32(body))) + b"\0") == []
    assert (decoder.counters.header_errors, decoder.counters.packets, decoder.counters.damaged) == (1, 0, 0)


@pytest.mark.parametrize("type", list(PacketType))
def test_only_tactile_has_format_and_flags(type: PacketType) -> None:
    for sample_format, flags in itertools.product(range(6), (0, 1, 2, 3, 4, 128)):
        allowed = sample_format == flags == 0
        if type is PacketType.TACTILE:
            allowed = sample_format in (1, 2, 3) and flags <= 3
        with contextlib.nullcontext() if allowed else pytest.raises(PacketError):
            check_header(Packet(type, flags=flags, format=sample_format))


# From the table in the Wikipedia article on COBS, which follows Cheshire and Baker.
PUBLISHED = [
    ("", "01"),
    ("00", "0101"),
    ("0000", "010101"),
    ("00110000", "0102110101"),
    ("11220033", "0311220233"),
    ("11223344", "0511223344"),
    ("11000000", "0211010101"),
    (bytes(range(1, 255)).hex(), "ff" + bytes(range(1, 255)).hex()),
    (bytes(range(255)).hex(), "01ff" + bytes(range(1, 255)).hex()),
    (bytes(range(1, 256)).hex(), "ff" + bytes(range(1, 255)).hex() + "02ff"),
    ((bytes(range(2, 256)) + b"\0").hex(), "ff" + bytes(range(2, 256)).hex() + "0101"),
    ((bytes(range(3, 256)) + b"\0\1").hex(), "fe" + bytes(range(3, 256)).hex() + "0201"),
]


@pytest.mark.parametrize(("plain", "stuffed"), PUBLISHED)
def test_published_examples(plain: str, stuffed: str) -> None:
    data, expected = bytes.fromhex(plain), bytes.fromhex(stuffed)
    assert cobs.encode(data) == expected
    assert cobs.decode(expected) == data


@given(st.binary(max_size=1200))
@example(b"\1" * 254)
@example(b"\1" * 508)
@example(b"\1" * 254 + b"\0")
def test_round_trip_without_zeros_and_with_bounded_overhead(data: bytes) -> None:
    stuffed = cobs.encode(data)
    assert 0 not in stuffed
    assert cobs.decode(stuffed) == data
    assert len(data) + 1 <= len(stuffed) + (len(data) % 254 == 0 and len(data) > 0)
    assert len(stuffed) <= len(data) + 1 + len(data) // 254


def test_an_unnecessary_closing_code_is_accepted() -> None:
    """Some encoders end a full run of 254 bytes with 01."""
    assert cobs.decode(b"\xff" + b"\7" * 254 + b"\1") == b"\7" * 254


@pytest.mark.parametrize("stuffed", [b"", b"\0", b"\3\1\0", b"\2", b"\5\1\2\3", b"\xff\1\1"])
def test_invalid_bytes_are_refused(stuffed: bytes) -> None:
    with pytest.raises(cobs.CobsError):
        cobs.decode(stuffed)


@given(st.binary(max_size=600))
def test_accepted_bytes_round_trip(noise: bytes) -> None:
    end = 0
    while end < len(noise):  # from code to code; none is 0
        end += noise[end] or len(noise)
    if not noise or 0 in noise or end != len(noise):
        with pytest.raises(cobs.CobsError):
            cobs.decode(noise)
        return
    data = cobs.decode(noise)
    assert len(data) < len(noise)
    assert cobs.decode(cobs.encode(data)) == data
