# SPDX-License-Identifier: Apache-2.0
"""Packets of the board link: framing, header, checksum and constants of the protocol (docs/board-link.md).

Pure functions and a decoder, without port, clock or state of the board. payloads.py has the payloads.
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
MINOR = 2
"""Minor version from which a close carries limits; older boards are refused."""
SERVO_MINOR = 3
"""Minor version of a board that passes the bytes of the servos' bus; other boards report MINOR."""
TAXELS = ROWS * COLUMNS
FULL_SCALE = 10.0  # N, the code one below the top
DEFAULT_RATE = FRAME_RATE  # Hz, after every boot
POWER_RATE = 20.0  # Hz
HEARTBEAT_PERIOD = 0.020  # s
HEARTBEAT_TIMEOUT = 0.100  # s without one opens the contactor
PROBE_LIFETIME = 2.0  # s; a close needs a probe younger than this
PROBE_TIMEOUT = 0.250  # s; longest time until a probe is answered
ZERO_CURRENT = 0.5  # A, below it no current flows through an open contactor
DEAD_VOLTAGE = 5.0  # V, below it the electrodes are dead
OPEN, CLOSE, CLEAR_WELD, LIMIT = 0, 1, 2, 3  # the first byte of CONTACTOR
LONGEST_PING = 64  # bytes
LONGEST_SERVO = 128  # bytes of the servos' bus in one packet

_HEADER = struct.Struct("<BBHQBBH")
_CRC = struct.Struct("<I")


class PacketType(enum.IntEnum):
    """Type of a packet."""

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
    """Encoding of a taxel's force; the number is the header's format field."""

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
    """Why the board opened the contactor on its own; latched until the next opening command, a weld until cleared."""

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
    """A packet's payload or header is invalid for its type. Example: a TACTILE packet of 12 bytes.

    Args:
        type: number of the packet's type.
        reason: what is wrong.
    """

    def __init__(self, type: int, reason: str) -> None:
        self.type = type
        self.reason = reason
        super().__init__(f"{type_name(type)} packet: {reason}; check that both sides use version {VERSION}")


def type_name(type: int) -> str:
    """Return the name of a packet type; works for unknown numbers too."""
    try:
        return PacketType(type).name
    except ValueError:
        return f"type {type}"


def fault_name(fault: int) -> str:
    """Return a fault in words; works for unknown numbers too."""
    try:
        return BoardFault(fault).name.lower().replace("_", " ")
    except ValueError:
        return f"fault {fault}"


def clearing(fault: int) -> str:
    """Return how a person clears a latched fault."""
    if fault == BoardFault.CONTACTOR_WELDED:
        return (
            "switch the battery off, replace the contactor, then call set_contactor with clear_weld true, or "
            "'deltacharger doctor --clear-weld'"
        )
    return "remove the cause, then open the contactor to clear it (set_contactor with close false)"


class Packet(NamedTuple):
    """One packet of the wire; its checksum is verified.

    Attributes:
        type: number of its type; may be unknown.
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
        packet: to encode.
        version: major version in the header; only tests and the emulator's fault hooks change it.

    Raises:
        struct.error: a field does not fit.
    """
    header = _HEADER.pack(version, packet.type, packet.sequence, packet.device_time_us, packet.flags, packet.format, 0)
    body = header + packet.payload
    return b"\0" + cobs.encode(body + _CRC.pack(zlib.crc32(body))) + b"\0"


@dataclass
class DecoderCounters:
    """Counts of a decoder; they only rise."""

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
        """Number of pieces between delimiters that were not an intact packet."""
        return self.cobs_errors + self.crc_errors + self.length_errors


class PacketDecoder:
    """Cuts a byte stream into packets, however it is split and whatever lies between them.

    A piece that is not an intact packet of this version is counted and dropped; decoding resumes at the next delimiter.
    Memory is bounded by `longest` plus the data of one call. The receiver checks flags and format with `check_header`,
    because they depend on the type.

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
            self._overlong = True  # bytes up to the next delimiter belong to the same damaged packet
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
    """Check sample format and flags of a packet; only TACTILE has them.

    Raises:
        PacketError: a value that version 1 does not define for this type.
    """
    tactile = packet.type == PacketType.TACTILE
    formats = _SAMPLE_FORMATS if tactile else (SampleFormat.NONE,)
    if packet.format not in formats:
        raise PacketError(packet.type, f"sample format {packet.format} is invalid for this type")
    if packet.flags & ~(_ALL_FLAGS if tactile else 0):
        raise PacketError(packet.type, f"flags {packet.flags:#04x} are invalid for this type")


def is_from_board(type: int) -> bool:
    """Return whether the board sends packets of this type."""
    return type in _FROM_BOARD
