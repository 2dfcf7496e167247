# SPDX-License-Identifier: Apache-2.0
"""The packets of docs/board-link.md: golden bytes, headers, COBS, recovery from wire faults; times and numbers."""

import contextlib
import itertools
import math
import random
import struct
import zlib

import pytest

from deltacharger_core import machine, real_time
from deltacharger_driver.board import protocol
from deltacharger_driver.board.receiver import BoardReceiver, BoardRequests, DeviceClock, SequenceUnwrapper
from deltacharger_driver.packets import CobsError, Packet, PacketDecoder, cobs_decode, cobs_encode, encode_packet

from .virtual_line import Clock

# Made with an independent encoder (bitwise CRC, byte-by-byte COBS).
GOLDEN = [
    (Packet(12), "0003010c01010101010101010101010101052073260700"),
    (Packet(3, b"", 5), "000401030501010101010101010101010105d0de0dd700"),
    (
        Packet(8, protocol.encode_close(machine.ChargeLimits(18.0, 29.4)), 0x1234),
        "00050108341201010101010101010101010201010101010790413333eb41010b4040cdcc4c3e9915839f00",
    ),
    (Packet(8, protocol.encode_limit(5.0), 7), "000401080701010101010101010101010102030107a040459c409600"),
    (Packet(7, protocol.encode_rate(60.0), 1), "000401070101010101010101010101010101010770422bc4337800"),
    (
        Packet(2, protocol.encode_power(protocol.Power(26.5, 24.0, math.nan, True, 0)), 7, 1_500_000),
        "00040102070460e3160101010101010101010103d4410103c0410104c07f010101010107c07faede622e00",
    ),
    (
        Packet(3, protocol.encode_hello(protocol.Hello(1, 2, 10, 10, 0xDEADBEEF, 120.0, True, 29.4))),
        "00030103010101010101010101010101010901020a0aefbeadde0104f042010101093333eb41f838e13f00",
    ),
    (
        Packet(10, protocol.encode_ack(protocol.Ack(11, 0, 9, protocol.encode_probe(25.5, 24.0))), 3, 2_000_000),
        "0004010a030480841e0101010101010101020b0209010103cc410107c041e651230c00",
    ),
    (
        Packet(10, protocol.encode_ack(protocol.Ack(8, 3, 1)), 0, 1),
        "0003010a010201010101010101010101010408030105d98d266700",
    ),
]


GOOD = bytes.fromhex(GOLDEN[3][1])


@pytest.mark.parametrize(("packet", "wire"), GOLDEN)
def test_golden_bytes(packet: Packet, wire: str) -> None:
    assert encode_packet(packet).hex() == wire
    assert PacketDecoder().feed(bytes.fromhex(wire)) == [packet]


@pytest.mark.parametrize("garbage", [b"", bytes(range(256)), b"\1" * 3000, GOOD[:-9], GOOD[3:]])
@pytest.mark.parametrize("step", [1, 7, 64])
def test_garbage_never_outlasts_the_next_packet_however_it_is_split(garbage: bytes, step: int) -> None:
    decoder = PacketDecoder()
    decoder.feed(garbage)
    stream = b"\0" + GOOD
    found = [packet for at in range(0, len(stream), step) for packet in decoder.feed(stream[at : at + step])]
    assert found == [GOLDEN[3][0]]


def test_memory_is_bounded_without_a_delimiter() -> None:
    decoder = PacketDecoder(longest=500)
    for _ in range(1000):
        decoder.feed(b"\1" * 400)
    assert len(decoder._rest) <= 900
    packet = Packet(protocol.PacketType.PING, b"alive")
    assert decoder.feed(encode_packet(packet)) == [packet]
    assert decoder.counters.damaged == 1


@pytest.mark.parametrize("at", [14, 15])
def test_reserved_bytes_of_the_header_must_be_zero(at: int) -> None:
    body = bytearray(cobs_decode(encode_packet(Packet(protocol.PacketType.POWER, bytes(16)))[1:-1])[:-4])
    body[at] = 1
    decoder = PacketDecoder()
    assert decoder.feed(b"\0" + cobs_encode(bytes(body) + struct.pack("<I", zlib.crc32(body))) + b"\0") == []
    assert (decoder.counters.packets, decoder.counters.damaged) == (0, 1)


@pytest.mark.parametrize("type", list(protocol.PacketType))
def test_only_tactile_has_format_and_flags(type: protocol.PacketType) -> None:
    for sample_format, flags in itertools.product((0, 2, 3), (0, 3, 4)):
        allowed = sample_format == flags == 0
        if type is protocol.PacketType.TACTILE:
            allowed = sample_format == 2 and flags <= 3
        with contextlib.nullcontext() if allowed else pytest.raises(protocol.PacketError):
            protocol.check_header(Packet(type, flags=flags, format=sample_format))


@pytest.mark.parametrize("data", [b"", b"\0", b"\1" * 253, b"\1" * 254, b"\1" * 508, b"\1" * 254 + b"\0", b"\0" * 600])
def test_round_trip_without_zeros_and_with_bounded_overhead(data: bytes) -> None:
    stuffed = cobs_encode(data)
    assert 0 not in stuffed
    assert cobs_decode(stuffed) == data
    assert len(data) + 1 <= len(stuffed) + (len(data) % 254 == 0 and len(data) > 0)
    assert len(stuffed) <= len(data) + 1 + len(data) // 254


@pytest.mark.parametrize("noise", [b"", b"\0", b"\3\1\0", b"\3\1"])
def test_what_no_encoder_produces_is_refused(noise: bytes) -> None:
    with pytest.raises(CobsError):
        cobs_decode(noise)


POWER = struct.pack("<fffBBHf", 26.5, math.nan, 2.0, 1, 9, 0, 1.5)


def spoiled(payload: bytes, at: int, data: bytes) -> bytes:
    return payload[:at] + data + payload[at + len(data) :]


def test_impossible_numbers_are_refused() -> None:
    assert protocol.decode_probe(protocol.encode_probe(math.inf, 0.0)) == (
        math.inf,
        0.0,
    )  # only an open circuit is infinite
    assert all(map(math.isnan, protocol.decode_probe(protocol.encode_probe(math.nan, math.nan))))
    for resistance, voltage in ((-math.inf, 0.0), (25.0, math.inf), (25.0, -math.inf), (math.inf, math.inf)):
        with pytest.raises(protocol.PacketError):
            protocol.decode_probe(protocol.encode_probe(resistance, voltage))
    for rate in (math.inf, -math.inf, math.nan, -1.0):
        with pytest.raises(protocol.PacketError):
            protocol.decode_rate(protocol.encode_rate(rate))
        with pytest.raises(protocol.PacketError):
            protocol.decode_hello(protocol.encode_hello(protocol.Hello(1, 0, 10, 10, 1, rate)))


def bad_packets(time: int) -> list[Packet]:
    """Intact packets with impossible content."""
    return [
        Packet(protocol.PacketType.POWER, spoiled(POWER, 13, b"\x0a"), 1, time),
        Packet(protocol.PacketType.POWER, POWER, 2, time, format=1),
        Packet(protocol.PacketType.HELLO, protocol.encode_hello(protocol.Hello(1, 0, 10, 10, 99, math.inf)), 0, time),
        Packet(protocol.PacketType.ACK, b"\1", 0, time),
        Packet(protocol.PacketType.TACTILE, bytes(200), 0, time),
    ]


def test_an_impossible_packet_is_only_counted() -> None:
    powers, boots = [], []
    receiver = BoardReceiver(BoardRequests(), None, powers.append, lambda: boots.append(True))
    hello = protocol.encode_hello(protocol.Hello(1, 0, 10, 10, 7, 120.0))
    receiver.take_packet(Packet(protocol.PacketType.HELLO, hello, 0, 5_000_000), 100.0)
    for packet in bad_packets(0) + bad_packets(2**63):  # a clock that fell, which is a reboot, and one far ahead
        receiver.take_packet(packet, 100.0)
    assert receiver.snapshot().bad_payloads == 10
    assert (powers, boots, receiver.snapshot().reboots) == ([], [], 0)
    receiver.take_packet(Packet(protocol.PacketType.POWER, POWER, 0, 5_100_000), 100.1)
    assert powers[0].time == pytest.approx(100.1)
    assert receiver.snapshot().lost_power == 0


@pytest.mark.parametrize("drift", [100e-6, -100e-6])
def test_the_offset_is_found_under_jitter_and_drift(drift: float) -> None:
    clock, delay = DeviceClock(), random.Random(1)
    for number in range(12 * 120):
        true = number / 120.0
        received = true + 1234.5 + delay.expovariate(1.0 / 0.002)
        stamp = clock.update(true * (1.0 + drift), received)
        assert stamp <= received
        assert number < 600 or stamp == pytest.approx(true + 1234.5, abs=1e-3)
    clock.reset()
    assert clock.update(0.0, 6.5) == 6.5


def test_a_stalled_host_does_not_move_the_clock() -> None:
    clock = DeviceClock()
    for number in range(1200):
        late = 0.3 if 600 <= number < 640 else 0.0  # packets that waited in the kernel's buffer
        stamp = clock.update(number / 120.0, number / 120.0 + 50.0 + late)
        assert stamp == pytest.approx(number / 120.0 + 50.0, abs=1e-4)


def test_a_repeated_packet_is_not_a_frame_and_numbers_rise_beyond_16_bits() -> None:
    counter = SequenceUnwrapper()
    assert [counter.update(number % 65536) for number in range(0, 200_000, 30_000)] == list(range(0, 200_000, 30_000))
    counter = SequenceUnwrapper()
    assert [counter.update(n) for n in (5, 5, 6)] == [5, None, 6]
    assert (counter.lost, counter.duplicates) == (0, 1)


def test_a_reboot_continues_above_and_counts_missed_packets() -> None:
    counter = SequenceUnwrapper()
    counter.update(100)
    counter.reboot()
    assert [counter.update(n) for n in (2, 3)] == [103, 104]
    assert counter.lost == 2


def test_the_rate_counts_since_the_last_call() -> None:
    clock = Clock()
    meter = real_time.RateMeter(clock)
    for number in range(50):
        meter.count(late=number % 25 == 0)
    clock.now += 0.5
    assert meter.rate() == pytest.approx(100.0)
    clock.now += 2.0
    assert meter.rate() == 0.0
    meter.count()
    clock.now += 0.1
    assert meter.rate() == pytest.approx(10.0)
    assert meter.late == 2  # since the start
