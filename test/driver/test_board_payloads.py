# SPDX-License-Identifier: Apache-2.0
"""Payloads of packets: samples, power, hello, probes; round trips, bounds and impossible values."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltacharger_driver.board.payloads import (
    Hello,
    Power,
    decode_ack,
    decode_hello,
    decode_ping,
    decode_power,
    decode_probe,
    decode_rate,
    decode_samples,
    encode_hello,
    encode_power,
    encode_probe,
    encode_rate,
    encode_samples,
)
from deltacharger_driver.board.protocol import FULL_SCALE, Packet, PacketError, PacketType, SampleFormat
from deltacharger_driver.board.receiver import BoardReceiver
from deltacharger_driver.board.requests import BoardRequests

FORMATS = [SampleFormat.U8, SampleFormat.U12, SampleFormat.U16]


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


@settings(max_examples=40)
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


@pytest.mark.parametrize("at", [14, 15])
def test_reserved_bytes_of_power_must_be_zero(at: int) -> None:
    assert decode_power(POWER).fault == 9
    with pytest.raises(PacketError):
        decode_power(spoiled(POWER, at, b"\1"))


def test_impossible_numbers_are_refused() -> None:
    assert decode_probe(encode_probe(math.inf, 0.0)) == (math.inf, 0.0)  # only an open circuit is infinite
    assert all(map(math.isnan, decode_probe(encode_probe(math.nan, math.nan))))
    for resistance, voltage in ((-math.inf, 0.0), (25.0, math.inf), (25.0, -math.inf), (math.inf, math.inf)):
        with pytest.raises(PacketError):
            decode_probe(encode_probe(resistance, voltage))
    for rate in (math.inf, -math.inf, math.nan, -1.0):
        with pytest.raises(PacketError):
            decode_rate(encode_rate(rate))
        with pytest.raises(PacketError):
            decode_hello(encode_hello(Hello(1, 0, 10, 10, 1, rate)))


def test_a_ping_carries_at_most_64_bytes() -> None:
    assert decode_ping(bytes(64)) == bytes(64)
    with pytest.raises(PacketError, match="65"):
        decode_ping(bytes(65))


def bad_packets(time: int) -> list[Packet]:
    """Intact packets with impossible content."""
    return [
        Packet(PacketType.POWER, spoiled(POWER, 13, b"\x0a"), 1, time),
        Packet(PacketType.POWER, POWER, 2, time, format=1),
        Packet(PacketType.HELLO, encode_hello(Hello(1, 0, 10, 10, 99, math.inf)), 0, time),
        Packet(PacketType.ACK, b"\1", 0, time),
        Packet(PacketType.PING, bytes(65), 0, time),
        Packet(PacketType.TACTILE, bytes(200), 0, time),
    ]


def test_an_impossible_packet_is_only_counted() -> None:
    powers, boots = [], []
    receiver = BoardReceiver(BoardRequests(), None, powers.append, lambda: boots.append(True))
    hello = encode_hello(Hello(1, 0, 10, 10, 7, 120.0))
    receiver.take(Packet(PacketType.HELLO, hello, 0, 5_000_000), 100.0)
    for packet in bad_packets(0) + bad_packets(2**63):  # a clock that fell, which is a reboot, and one far ahead
        receiver.take(packet, 100.0)
    assert receiver.snapshot().bad_payloads == 12
    assert (powers, boots, receiver.snapshot().reboots) == ([], [], 0)
    receiver.take(Packet(PacketType.POWER, POWER, 0, 5_100_000), 100.1)
    assert powers[0].time == pytest.approx(100.1)
    assert receiver.snapshot().lost_power == 0


def test_payloads_of_the_wrong_length_or_format_are_refused() -> None:
    for decode in (decode_power, decode_hello, decode_ack, decode_probe, decode_rate):
        with pytest.raises(PacketError):
            decode(b"\1\2")
    for length, sample_format in ((300, 1), (299, 2), (200, 3), (200, 0), (200, 9)):
        with pytest.raises(PacketError):
            decode_samples(bytes(length), sample_format)
