"""The bytes of docs/board-link.md: golden vectors, round trips, and recovery from everything a wire can do."""

from __future__ import annotations

import math
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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
    decode_rate,
    decode_samples,
    encode_ack,
    encode_hello,
    encode_power,
    encode_probe,
    encode_rate,
    encode_samples,
    probe_problem,
)
from deltacharger_driver.board_protocol import (
    FULL_SCALE,
    Packet,
    PacketDecoder,
    PacketError,
    PacketType,
    SampleFormat,
    check_header,
    encode_packet,
)
from deltacharger_driver.board_receiver import BoardReceiver
from deltacharger_driver.board_requests import Requests

FORMATS = [SampleFormat.U8, SampleFormat.U12, SampleFormat.U16]

# Made with an encoder that shares no line with the driver's (bitwise CRC, byte-by-byte COBS).
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


def test_header_layout() -> None:
    wire = encode_packet(Packet(0xA2, b"xyz", 0xB4B3, 0xC8C7C6C5C4C3C2C1, 0xD1, 0xD2))
    assert wire[0] == wire[-1] == 0
    plain = cobs.decode(wire[1:-1])
    assert plain[:-4].hex() == "01a2b3b4c1c2c3c4c5c6c7c8d1d20000" + b"xyz".hex()
    assert plain[-4:] == struct.pack("<I", zlib.crc32(plain[:-4]))


@given(st.lists(packets, max_size=5), st.integers(1, 64))
def test_packets_survive_any_chopping(sent: list[Packet], step: int) -> None:
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
def test_a_truncated_packet_costs_only_itself(packet: Packet, data: st.DataObject) -> None:
    """The leading delimiter of the next packet ends the damaged one."""
    wire = encode_packet(packet)
    cut = data.draw(st.integers(0, len(wire) - 2))
    decoder = PacketDecoder()
    follower = Packet(PacketType.PING, b"next", 1)
    assert decoder.feed(wire[:cut] + encode_packet(follower)) == [follower]


@settings(max_examples=200)
@given(packets, st.data())
def test_a_flipped_bit_is_noticed(packet: Packet, data: st.DataObject) -> None:
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
    assert decoder.counters.version_errors == 1
    assert decoder.counters.refused_version == version


def test_u12_puts_two_samples_into_three_bytes() -> None:
    left = np.full((10, 10), np.nan)
    right = np.zeros((10, 10))
    left[0, 0], left[0, 1] = 0xABC * FULL_SCALE / 4094, 0x123 * FULL_SCALE / 4094
    payload = encode_samples(left, right, SampleFormat.U12)
    assert payload[:3].hex() == "bc3a12"
    assert payload[3:150] == b"\xff" * 147
    assert payload[150:] == bytes(150)


@pytest.mark.parametrize("sample_format", FORMATS)
def test_top_code_is_dead_and_one_below_is_full_scale(sample_format: SampleFormat) -> None:
    left = np.zeros((10, 10))
    left[0, :4] = [np.nan, 10.0, 25.0, -3.0]
    back, _ = decode_samples(encode_samples(left, left, sample_format), sample_format)
    assert math.isnan(back[0, 0])
    assert back[0, 1:4].tolist() == [10.0, 10.0, 0.0]
    assert back.dtype == np.float32
    assert back.shape == (10, 10)


@pytest.mark.parametrize(
    ("sample_format", "sizes"),
    [(SampleFormat.U8, {223}), (SampleFormat.U12, {323, 324}), (SampleFormat.U16, {423, 424})],
)
def test_sizes_on_the_wire(sample_format: SampleFormat, sizes: set[int]) -> None:
    random = np.random.default_rng(1)
    seen = set()
    for scale in (0.0, 1.0, 12.0):
        for _ in range(20):
            pads = random.uniform(0.0, scale, (2, 10, 10))
            payload = encode_samples(pads[0], pads[1], sample_format)
            seen.add(len(encode_packet(Packet(1, payload, 0xFFFF, 2**40, 1, sample_format))))
    assert seen <= sizes


@pytest.mark.parametrize("sample_format", FORMATS)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_samples_round_trip_within_half_a_code(sample_format: SampleFormat, seed: int) -> None:
    random = np.random.default_rng(seed)
    pads = random.uniform(0.0, FULL_SCALE, (2, 10, 10))
    dead = random.random(pads.shape) < 0.1
    pads[dead] = np.nan
    back = np.stack(decode_samples(encode_samples(pads[0], pads[1], sample_format), sample_format))
    assert np.array_equal(np.isnan(back), dead)
    assert np.nanmax(np.abs(back - pads)) <= FULL_SCALE / (sample_format.top - 1) / 2 + 1e-6


measured = st.floats(width=32, allow_infinity=False)


@given(measured, measured, measured, st.booleans(), st.integers(0, 9))
def test_power_round_trip(battery: float, target: float, current: float, closed: bool, fault: int) -> None:
    back = decode_power(encode_power(Power(battery, target, current, closed, fault)))
    np.testing.assert_equal(
        [back.battery_voltage, back.target_voltage, back.charge_current], [battery, target, current]
    )
    assert (back.contactor_closed, back.fault) == (closed, fault)


POWER = struct.pack("<fffBBH", 26.5, math.nan, 2.0, 1, 9, 0)


def spoiled(payload: bytes, at: int, data: bytes) -> bytes:
    return payload[:at] + data + payload[at + len(data) :]


@pytest.mark.parametrize(
    ("at", "data", "told"),
    [
        (0, struct.pack("<f", math.inf), "battery_V is inf"),
        (4, struct.pack("<f", -math.inf), "target_V is -inf"),
        (8, struct.pack("<f", math.inf), "charge_A is inf"),
        (12, b"\2", "contactor is 2"),
        (12, b"\7", "contactor is 7"),
        (13, b"\x0a", "fault 10"),
        (13, b"\xff", "fault 255"),
        (14, b"\1", "are 1 instead of 0"),
        (15, b"\x80", "are 32768 instead of 0"),
    ],
)
def test_a_power_that_no_board_reports_is_refused_by_name(at: int, data: bytes, told: str) -> None:
    assert decode_power(POWER).fault == 9
    with pytest.raises(PacketError, match=told):
        decode_power(spoiled(POWER, at, data))


@pytest.mark.parametrize("rate", [math.inf, -math.inf, math.nan, -1.0])
def test_a_rate_is_finite_and_not_negative(rate: float) -> None:
    with pytest.raises(PacketError, match="Hz"):
        decode_rate(encode_rate(rate))
    with pytest.raises(PacketError, match="Hz"):
        decode_hello(encode_hello(Hello(1, 0, 10, 10, 1, rate)))


def test_a_probe_may_find_an_open_circuit_or_nothing_but_no_other_infinity() -> None:
    assert decode_probe(encode_probe(math.inf, 0.0)) == (math.inf, 0.0)
    assert all(map(math.isnan, decode_probe(encode_probe(math.nan, math.nan))))
    for resistance, voltage in ((-math.inf, 0.0), (25.0, math.inf), (25.0, -math.inf), (math.inf, math.inf)):
        with pytest.raises(PacketError):
            decode_probe(encode_probe(resistance, voltage))


def test_a_ping_carries_at_most_64_bytes() -> None:
    assert decode_ping(bytes(64)) == bytes(64)
    with pytest.raises(PacketError, match="65"):
        decode_ping(bytes(65))


@pytest.mark.parametrize("at", [14, 15])
def test_reserved_bytes_of_the_header_must_be_zero(at: int) -> None:
    body = bytearray(cobs.decode(encode_packet(Packet(PacketType.POWER, POWER))[1:-1])[:-4])
    body[at] = 1
    wire = b"\0" + cobs.encode(bytes(body) + struct.pack("<I", zlib.crc32(body))) + b"\0"
    decoder = PacketDecoder()
    assert decoder.feed(wire) == []
    assert (decoder.counters.header_errors, decoder.counters.packets, decoder.counters.damaged) == (1, 0, 0)


@pytest.mark.parametrize("type", list(PacketType))
@pytest.mark.parametrize("sample_format", range(6))
@pytest.mark.parametrize("flags", [0, 1, 2, 3, 4, 128])
def test_only_tactile_has_format_and_flags(type: PacketType, sample_format: int, flags: int) -> None:
    packet = Packet(type, flags=flags, format=sample_format)
    tactile = type is PacketType.TACTILE
    allowed = (sample_format in (1, 2, 3) and flags <= 3) if tactile else sample_format == flags == 0
    if allowed:
        check_header(packet)
    else:
        with pytest.raises(PacketError, match="not belong to it"):
            check_header(packet)


def bad_packets(time: int) -> list[Packet]:
    """Intact packets that no board sends."""
    return [
        Packet(PacketType.POWER, spoiled(POWER, 13, b"\x0a"), 1, time),
        Packet(PacketType.POWER, POWER, 2, time, format=1),
        Packet(PacketType.HELLO, encode_hello(Hello(1, 0, 10, 10, 99, math.inf)), 0, time),
        Packet(PacketType.ACK, b"\1", 0, time),
        Packet(PacketType.PING, bytes(65), 0, time),
        Packet(PacketType.TACTILE, bytes(200), 0, time),
    ]


def test_a_packet_that_no_board_sends_leaves_no_trace_but_a_count() -> None:
    powers, boots = [], []
    receiver = BoardReceiver(Requests(), None, powers.append, lambda: boots.append(True))
    hello = encode_hello(Hello(1, 0, 10, 10, 7, 120.0))
    receiver.take(Packet(PacketType.HELLO, hello, 0, 5_000_000), 100.0)
    for packet in bad_packets(0) + bad_packets(2**63):  # a clock that fell, which is a reboot, and one far ahead
        receiver.take(packet, 100.0)
    assert receiver.snapshot().bad_payloads == 12
    assert (powers, boots, receiver.snapshot().reboots) == ([], [], 0)
    receiver.take(Packet(PacketType.POWER, POWER, 0, 5_100_000), 100.1)
    assert powers[0].time == pytest.approx(100.1)
    assert receiver.snapshot().lost_power == 0


def test_other_payloads_round_trip() -> None:
    hello = Hello(1, 3, 10, 10, 2**32 - 1, 120.0)
    assert decode_hello(encode_hello(hello)) == hello
    ack = Ack(11, 4, 65535, b"data")
    assert decode_ack(encode_ack(ack)) == ack
    assert decode_probe(encode_probe(math.inf, -24.0)) == (math.inf, -24.0)
    assert decode_rate(encode_rate(60.0)) == 60.0


@pytest.mark.parametrize("decode", [decode_power, decode_hello, decode_ack, decode_probe, decode_rate])
def test_payloads_of_the_wrong_length_are_refused(decode: object) -> None:
    with pytest.raises(PacketError, match="bytes instead of"):
        decode(b"\1\2")  # type: ignore[operator]


@pytest.mark.parametrize(("length", "sample_format"), [(300, 1), (299, 2), (200, 3), (200, 0), (200, 9)])
def test_samples_of_the_wrong_length_or_format_are_refused(length: int, sample_format: int) -> None:
    with pytest.raises(PacketError):
        decode_samples(bytes(length), sample_format)


@pytest.mark.parametrize(
    ("resistance", "voltage", "word"),
    [
        (25.0, 24.0, ""),
        (1.0, 0.0, ""),
        (0.99, 24.0, "short"),
        (0.0, 0.0, "short"),
        (math.inf, 0.0, "open circuit"),
        (math.inf, math.nan, "open circuit"),
        (5.0, -0.1, "polarity"),
        (math.nan, 24.0, "nothing"),
        (5.0, math.nan, "nothing"),
    ],
)
def test_what_a_probe_allows(resistance: float, voltage: float, word: str) -> None:
    problem = probe_problem(resistance, voltage)
    assert word in problem
    assert bool(problem) == bool(word)
