# SPDX-License-Identifier: Apache-2.0
"""Laws of a healthy board's answers to unknown, wrong, damaged and split packets."""

from __future__ import annotations

import itertools
import time
import zlib
from collections.abc import Callable, Iterator

import pytest

from deltacharger_driver.board import cobs
from deltacharger_driver.board.errors import CommandRefused
from deltacharger_driver.board.payloads import Ack, decode_ack, encode_rate
from deltacharger_driver.board.port import BoardPort
from deltacharger_driver.board.protocol import (
    LONGEST_PING,
    VERSION,
    AckError,
    Packet,
    PacketDecoder,
    PacketType,
    encode_packet,
)

from .sites import BoardSite

UNKNOWN_TYPE = 200
STOP = encode_packet(Packet(PacketType.STOP, sequence=9))
DAMAGES: list[tuple[str, Callable[[bytes], bytes]]] = [
    ("a bit flipped", lambda wire: wire[:5] + bytes((wire[5] ^ 1,)) + wire[6:]),
    ("the end missing", lambda wire: wire[:-6]),
    ("the beginning missing", lambda wire: wire[6:]),
    ("noise before it", lambda wire: bytes(range(1, 256)) * 2 + wire[1:]),
    ("longer than any packet", lambda wire: wire[:-1] + b"\1" * 2000 + b"\0"),
]


class Wire:
    """A port without a driver on it."""

    def __init__(self, path: str) -> None:
        self.port = BoardPort(path, 1_000_000)
        self._decoder = PacketDecoder()
        self._numbers = itertools.count()
        self._packets: list[Packet] = []  # received but not checked yet

    def exchange(self, *data: bytes) -> list[Packet]:
        """Send bytes, then a PING, and return all packets before its return, except POWER."""
        end = f"end {next(self._numbers)}".encode()
        self.port.write(b"".join(data) + encode_packet(Packet(PacketType.PING, end)))
        found: list[Packet] = []
        deadline = time.monotonic() + 20.0
        while time.monotonic() < deadline:
            self._packets += self._decoder.feed(self.port.read(0.5))
            while self._packets:
                packet = self._packets.pop(0)
                if packet.type == PacketType.PING and packet.payload == end:
                    return found
                if packet.type not in (PacketType.POWER, PacketType.TACTILE):
                    found.append(packet)
        pytest.fail(f"the board did not return a PING; it sent {found}")

    def is_silent_on(self, *data: bytes) -> bool:
        """Return whether these bytes get no answer, neither before the PING behind them nor before a later one."""
        return self.exchange(*data) + self.exchange() == []

    def acks(self, *data: bytes) -> list[Ack]:
        """Do the same and return the answers, which must all be ACKs."""
        return [decode_ack(packet.payload) for packet in self.exchange(*data)]


@pytest.fixture
def wire(board_site: BoardSite) -> Iterator[Wire]:
    wire = Wire(board_site.path)
    wire.exchange(encode_packet(Packet(PacketType.STOP)))
    yield wire
    wire.port.close()


def test_an_unknown_command_is_answered_as_unknown(wire: Wire) -> None:
    (ack,) = wire.acks(encode_packet(Packet(UNKNOWN_TYPE, b"whatever", sequence=4711)))
    assert ack == Ack(UNKNOWN_TYPE, AckError.UNKNOWN, 4711)
    assert "unknown command" in str(CommandRefused(ack.type, ack.error))


@pytest.mark.parametrize(
    "packet",
    [
        Packet(PacketType.RATE, b"\0\0\xf0", 5),
        Packet(PacketType.RATE, b"\0\0\xc0\x7f", 5),  # NaN
        Packet(PacketType.START, b"\1", 5),
        Packet(PacketType.STOP, b"\0", 5),
        Packet(PacketType.HELLO, b"hello", 5),
        Packet(PacketType.TARE, b"\0", 5),
        Packet(PacketType.PROBE, bytes(8), 5),
        Packet(PacketType.CONTACTOR, b"", 5),
        Packet(PacketType.CONTACTOR, b"\0\0", 5),
    ],
    ids=lambda packet: f"{PacketType(packet.type).name} {packet.payload.hex()}",
)
def test_a_command_with_a_wrong_payload_is_refused(wire: Wire, packet: Packet) -> None:
    assert wire.acks(encode_packet(packet)) == [Ack(packet.type, AckError.BAD_PAYLOAD, 5)]


def test_another_version_gets_no_answer(wire: Wire) -> None:
    packet = encode_packet(Packet(PacketType.HELLO), version=VERSION + 1)
    assert wire.is_silent_on(packet)


def test_reserved_bytes_that_are_not_zero_get_no_answer(wire: Wire) -> None:
    packet = cobs.decode(STOP.strip(b"\0"))
    body = packet[:14] + b"\1\0" + packet[16:-4]
    assert wire.is_silent_on(b"\0" + cobs.encode(body + zlib.crc32(body).to_bytes(4, "little")) + b"\0")


def test_pings_return_their_bytes(wire: Wire) -> None:
    for data in (b"", bytes(LONGEST_PING), bytes(range(192, 256)), b"\0\xff" * 20):
        (back,) = wire.exchange(encode_packet(Packet(PacketType.PING, data)))
        assert (back.type, back.payload) == (PacketType.PING, data)
    assert wire.is_silent_on(encode_packet(Packet(PacketType.PING, bytes(LONGEST_PING + 1))))


def test_commands_sent_together_are_answered_in_order(wire: Wire) -> None:
    rates = [30.0, 60.0, 120.0]
    packets = [encode_packet(Packet(PacketType.RATE, encode_rate(rate), n)) for n, rate in enumerate(rates)]
    packets.append(encode_packet(Packet(PacketType.STOP, sequence=3)))
    assert [(ack.type, ack.sequence) for ack in wire.acks(*packets)] == [
        (PacketType.RATE, 0),
        (PacketType.RATE, 1),
        (PacketType.RATE, 2),
        (PacketType.STOP, 3),
    ]


@pytest.mark.parametrize("damage", [damage for _, damage in DAMAGES], ids=[name for name, _ in DAMAGES])
def test_a_damaged_packet_loses_only_itself(wire: Wire, damage: Callable[[bytes], bytes]) -> None:
    assert wire.acks(damage(STOP), encode_packet(Packet(PacketType.STOP, sequence=10))) == [
        Ack(PacketType.STOP, AckError.DONE, 10)
    ]


def test_a_packet_may_arrive_byte_by_byte(wire: Wire) -> None:
    for byte in STOP:
        wire.port.write(bytes((byte,)))
    assert wire.acks() == [Ack(PacketType.STOP, AckError.DONE, 9)]


def test_packets_of_the_board_are_numbered_by_type_and_stamped_in_order(wire: Wire) -> None:
    answers = [wire.exchange(encode_packet(Packet(PacketType.STOP))) for _ in range(5)]
    packets = [packet for (packet,) in answers]
    assert [(packet.sequence - packets[0].sequence) % 65536 for packet in packets] == list(range(5))
    times = [packet.device_time_us for packet in packets]
    assert times == sorted(times)
    assert all((packet.flags, packet.format) == (0, 0) for packet in packets)
