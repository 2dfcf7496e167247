# SPDX-License-Identifier: Apache-2.0
"""Packets of the board link: framing, header, checksum, and the numbers both sides agree on
(docs/board-link.md).

Pure functions and a decoder; no port, no clock, no state of the board. What packets carry is in
payloads.py.
"""

from __future__ import annotations

import enum
import struct
import zlib
from dataclasses import dataclass
from typing import NamedTuple

from deltacharger_core.machine import COLUMNS, FRAME_RATE, ROWS
from deltacharger_driver.board import cobs
from deltacharger_driver.errors import DriverError

VERSION = 1
MINOR = 0
SERVO_MINOR = 1
"""Minor version of a board that carries the bytes of the servos' bus; one that does not says MINOR."""
TAXELS = ROWS * COLUMNS
FULL_SCALE = 10.0  # N, the code one below the top
DEFAULT_RATE = FRAME_RATE  # Hz, after every boot
POWER_RATE = 20.0  # Hz
HEARTBEAT_PERIOD = 0.020  # s
HEARTBEAT_TIMEOUT = 0.100  # s without one opens the contactor
PROBE_LIFETIME = 2.0  # s a probe answer allows a close
PROBE_DEADLINE = 0.250  # s until a probe is answered at the latest
SHORT_RESISTANCE = 1.0  # ohm, below it the electrodes are shorted
LONGEST_PING = 64  # bytes
LONGEST_SERVO = 128  # bytes of the servos' bus in one packet

_HEADER = struct.Struct("<BBHQBBH")
_CRC = struct.Struct("<I")


class PacketType(enum.IntEnum):
    """What a packet is."""

    TACTILE = 1
    POWER = 2
    HELLO = 3
    START = 4
    STOP = 5
    TARE = 6
    RATE = 7
    CONTACTOR = 8
    PING = 9
    ACK = 10
    PROBE = 11
    HEARTBEAT = 12
    SERVO = 13
    SERVO_SPEED = 14


class SampleFormat(enum.IntEnum):
    """How a taxel's force is written; the number is the header's format field."""

    NONE = 0
    U8 = 1
    U12 = 2
    U16 = 3

    @property
    def top(self) -> int:
        """The highest code, which means a dead taxel; one below it is full scale."""
        return {SampleFormat.U8: 0xFF, SampleFormat.U12: 0xFFF, SampleFormat.U16: 0xFFFF}[self]


class AckError(enum.IntEnum):
    """The board's answer to a command."""

    DONE = 0
    BAD_PAYLOAD = 1
    UNKNOWN = 2
    INTERLOCK = 3
    NOT_NOW = 4


class BoardFault(enum.IntEnum):
    """Why the board opened the contactor by itself; latched until the next opening command."""

    NONE = 0
    NO_CHARGE_CURRENT = 1
    SHORT_CIRCUIT = 2
    STALE = 3
    REVERSE_POLARITY = 4
    VOLTAGE_OUT_OF_RANGE = 5
    REVERSE_CURRENT = 6
    CONTACTOR_WELDED = 7
    HEARTBEAT_LOST = 8
    OVER_CURRENT = 9


FLAG_TARED = 1
FLAG_OVERRUN = 2

_ALL_FLAGS = FLAG_TARED | FLAG_OVERRUN
_SAMPLE_FORMATS = (SampleFormat.U8, SampleFormat.U12, SampleFormat.U16)

_FROM_BOARD = frozenset(
    {PacketType.TACTILE, PacketType.POWER, PacketType.HELLO, PacketType.PING, PacketType.ACK, PacketType.SERVO}
)


class PacketError(DriverError, ValueError):
    """A packet's payload is not what its type demands. Example: a TACTILE packet of 12 bytes.

    Args:
        type: number of the packet's type.
        reason: what is wrong with it.
    """

    def __init__(self, type: int, reason: str) -> None:
        self.type = type
        self.reason = reason
        super().__init__(f"{type_name(type)} packet: {reason}; check that both sides speak version {VERSION}")


def type_name(type: int) -> str:
    """Return the name of a packet type, also of one that is not known."""
    try:
        return PacketType(type).name
    except ValueError:
        return f"type {type}"


def fault_name(fault: int) -> str:
    """Return a fault in words, also one that is not known."""
    try:
        return BoardFault(fault).name.lower().replace("_", " ")
    except ValueError:
        return f"fault {fault}"


class Packet(NamedTuple):
    """One packet as it stands on the wire, its checksum verified.

    Attributes:
        type: number of its type, possibly an unknown one.
        payload: the bytes after the header.
        sequence: counts packets per direction and type, modulo 65536.
        device_time_us: us since the board booted; 0 from the host.
        flags: FLAG_TARED, FLAG_OVERRUN.
        format: sample format of a TACTILE payload, else 0.
    """

    type: int
    payload: bytes = b""
    sequence: int = 0
    device_time_us: int = 0
    flags: int = 0
    format: int = 0


def encode_packet(packet: Packet, version: int = VERSION) -> bytes:
    """Return the bytes on the wire, delimiters included.

    Args:
        packet: what to send.
        version: major version to claim; only tests and the emulator's fault hooks claim another.

    Raises:
        struct.error: a field does not fit.
    """
    header = _HEADER.pack(version, packet.type, packet.sequence, packet.device_time_us, packet.flags, packet.format, 0)
    body = header + packet.payload
    return b"\0" + cobs.encode(body + _CRC.pack(zlib.crc32(body))) + b"\0"


@dataclass
class DecoderCounters:
    """What a decoder met so far. Every number only rises."""

    bytes: int = 0
    packets: int = 0
    cobs_errors: int = 0
    crc_errors: int = 0
    length_errors: int = 0
    version_errors: int = 0
    header_errors: int = 0  # intact packets whose reserved bytes are not 0
    refused_version: int | None = None  # the last one refused

    @property
    def damaged(self) -> int:
        """Pieces between delimiters that were no intact packet."""
        return self.cobs_errors + self.crc_errors + self.length_errors


class PacketDecoder:
    """Cuts a byte stream into packets, however it is chopped and whatever lies between them.

    A piece that is not an intact packet of this version is counted and dropped; the next delimiter starts afresh.
    The memory is bounded by `longest` plus what one call is given. Flags and format are the receiver's to judge
    (`check_header`), for they depend on the type.

    Args:
        longest: longest stuffed packet in bytes; the longest of version 1 has 422.
    """

    def __init__(self, longest: int = 1024) -> None:
        self.counters = DecoderCounters()
        self._longest = longest
        self._rest = b""
        self._overlong = False

    def feed(self, data: bytes) -> list[Packet]:
        """Take the next bytes of the stream and return the packets that they complete."""
        self.counters.bytes += len(data)
        pieces = (self._rest + data).split(b"\0")
        self._rest = pieces.pop()
        packets = [packet for piece in pieces if (packet := self._decode(piece)) is not None]
        if len(self._rest) > self._longest:
            self._rest = b""
            self._overlong = True  # what follows up to the next delimiter belongs to the same damage
        return packets

    def _decode(self, piece: bytes) -> Packet | None:
        if self._overlong or len(piece) > self._longest:
            self._overlong = False
            self.counters.length_errors += 1
            return None
        packet = self._packet(piece) if piece else None
        self.counters.packets += packet is not None
        return packet

    def _packet(self, piece: bytes) -> Packet | None:
        try:
            data = cobs.decode(piece)
        except cobs.CobsError:
            self.counters.cobs_errors += 1
            return None
        if len(data) < _HEADER.size + _CRC.size:
            self.counters.length_errors += 1
            return None
        body = data[: -_CRC.size]
        if zlib.crc32(body) != _CRC.unpack(data[-_CRC.size :])[0]:
            self.counters.crc_errors += 1
            return None
        version, kind, sequence, device_time, flags, sample_format, reserved = _HEADER.unpack_from(body)
        if version != VERSION:
            self.counters.version_errors += 1
            self.counters.refused_version = version
            return None
        if reserved:
            self.counters.header_errors += 1
            return None
        return Packet(kind, body[_HEADER.size :], sequence, device_time, flags, sample_format)


def check_header(packet: Packet) -> None:
    """Check what a packet's header says beside its type: only TACTILE has a sample format and flags.

    Raises:
        PacketError: it says something that version 1 does not know.
    """
    tactile = packet.type == PacketType.TACTILE
    formats = _SAMPLE_FORMATS if tactile else (SampleFormat.NONE,)
    if packet.format not in formats:
        raise PacketError(packet.type, f"sample format {packet.format} does not belong to it")
    if packet.flags & ~(_ALL_FLAGS if tactile else 0):
        raise PacketError(packet.type, f"flags {packet.flags:#04x} do not belong to it")


def is_from_board(type: int) -> bool:
    """Whether the board sends packets of this type."""
    return type in _FROM_BOARD
