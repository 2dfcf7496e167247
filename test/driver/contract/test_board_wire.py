# SPDX-License-Identifier: Apache-2.0
"""Laws of a healthy board's answers to unknown, wrong, damaged and split packets."""

import itertools
import time
import zlib
from collections.abc import Iterator

import pytest

from deltacharger_driver.board import protocol
from deltacharger_driver.board.protocol import Ack, AckError, PacketType, decode_ack, encode_rate
from deltacharger_driver.packets import Packet, PacketDecoder, cobs_decode, cobs_encode, encode_packet
from deltacharger_driver.ports import RawPort

from .sites import BoardSite

UNKNOWN_TYPE = 200
STOP = encode_packet(Packet(PacketType.STOP, sequence=9))
DAMAGES = {
    "a bit flipped": STOP[:5] + bytes((STOP[5] ^ 1,)) + STOP[6:],
    "the end missing": STOP[:-6],
    "the beginning missing": STOP[6:],
    "noise before it": bytes(range(1, 256)) * 2 + STOP[1:],
    "longer than any packet": STOP[:-1] + b"\1" * 2000 + b"\0",
}


class Wire:
    """A port without a driver on it."""

    def __init__(self, path: str) -> None:
        self.port = RawPort(path, 1_000_000)
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


def test_a_command_with_a_wrong_payload_is_refused(wire: Wire) -> None:
    for type, payload in (
        (PacketType.RATE, b"\0\0\xf0"),
        (PacketType.RATE, b"\0\0\xc0\x7f"),  # NaN
        (PacketType.START, b"\1"),
        (PacketType.STOP, b"\0"),
        (PacketType.HELLO, b"hello"),
        (PacketType.TARE, b"\0"),
        (PacketType.PROBE, bytes(8)),
        (PacketType.CONTACTOR, b""),
        (PacketType.CONTACTOR, b"\0\0"),
    ):
        assert wire.acks(encode_packet(Packet(type, payload, 5))) == [Ack(type, AckError.BAD_PAYLOAD, 5)]


def test_another_version_and_reserved_bytes_that_are_not_zero_get_no_answer(wire: Wire) -> None:
    assert wire.is_silent_on(encode_packet(Packet(PacketType.HELLO), version=protocol.VERSION + 1))
    packet = cobs_decode(STOP.strip(b"\0"))
    body = packet[:14] + b"\1\0" + packet[16:-4]
    assert wire.is_silent_on(b"\0" + cobs_encode(body + zlib.crc32(body).to_bytes(4, "little")) + b"\0")


def test_pings_return_their_bytes(wire: Wire) -> None:
    for data in (b"", bytes(protocol.LONGEST_PING), bytes(range(192, 256)), b"\0\xff" * 20):
        (back,) = wire.exchange(encode_packet(Packet(PacketType.PING, data)))
        assert (back.type, back.payload) == (PacketType.PING, data)
    assert wire.is_silent_on(encode_packet(Packet(PacketType.PING, bytes(protocol.LONGEST_PING + 1))))


def test_commands_sent_together_are_answered_in_order(wire: Wire) -> None:
    packets = [encode_packet(Packet(PacketType.RATE, encode_rate(rate), n)) for n, rate in enumerate((30.0, 60.0))]
    acks = wire.acks(*packets, STOP)
    assert [(a.type, a.sequence) for a in acks] == [(PacketType.RATE, 0), (PacketType.RATE, 1), (PacketType.STOP, 9)]


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_packet_loses_only_itself(wire: Wire, damage: str) -> None:
    acks = wire.acks(DAMAGES[damage], encode_packet(Packet(PacketType.STOP, sequence=10)))
    assert acks == [Ack(PacketType.STOP, AckError.DONE, 10)]


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
