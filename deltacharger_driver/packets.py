# SPDX-License-Identifier: Apache-2.0
"""Packets of both serial links, as bytes: the board's in COBS with CRC-32, the servos' in Protocol 2.0 with CRC-16.

What they mean is in board/protocol.py and servos/. Here is what a listener needs to tell which device is on a line.
"""

import functools
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

_LONGEST_RUN = 254
VERSION = 1
_HEADER = struct.Struct("<BBHQBBH")
_CRC = struct.Struct("<I")

BROADCAST = 254
PING, READ, WRITE, REBOOT = 1, 2, 3, 8
SYNC_READ, SYNC_WRITE = 0x82, 0x83
HEADER = b"\xff\xff\xfd\0"
STATUS = 0x55  # the instruction byte of a servo's answer
PLAIN = b"\xff\xff\xfd"  # inside a packet another FD follows it, so that it starts none


class CobsError(ValueError):
    """Bytes that no encoder produces."""


def cobs_encode(data: bytes) -> bytes:
    """Return `data` without zeros: one byte longer, plus one for every 254 bytes in a row without a zero.

    Consistent overhead byte stuffing (Cheshire and Baker, 1999): a zero on the wire always marks the start or end of a
    packet, so a reader resynchronises at the next zero after any garbage.

    Args:
        data: any bytes; may be empty.

    Returns:
        The stuffed bytes, without delimiters; never empty.
    """
    out = bytearray()
    for run in data.split(b"\0"):
        while len(run) >= _LONGEST_RUN:
            out += b"\xff" + run[:_LONGEST_RUN]
            run = run[_LONGEST_RUN:]
        out.append(len(run) + 1)
        out += run
    if not run and data and data[-1]:
        del out[-1]  # a full run at the very end needs no closing code
    return bytes(out)


def cobs_decode(data: bytes) -> bytes:
    """Return the bytes that `cobs_encode` was given.

    Args:
        data: stuffed bytes without delimiters.

    Raises:
        CobsError: `data` is empty, contains a zero or ends inside a run.
    """
    if not data or 0 in data:
        raise CobsError("no bytes, or a zero among them")
    runs = []
    position, end = 0, len(data)
    while True:
        code = data[position]
        following = position + code
        runs.append(data[position + 1 : following])
        if following >= end:
            break
        if code != 0xFF:
            runs.append(b"\0")
        position = following
    if following > end:
        raise CobsError("it ends inside a run")
    return b"".join(runs)


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
    return b"\0" + cobs_encode(body + _CRC.pack(zlib.crc32(body))) + b"\0"


@dataclass
class DecoderCounters:
    """Counts of a decoder; they only rise."""

    bytes: int = 0
    packets: int = 0
    damaged: int = 0  # pieces between delimiters that were not an intact packet, or have reserved bytes that are not 0
    version_errors: int = 0
    refused_version: int | None = None  # the last one refused


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
            self.counters.damaged += 1
            return None
        return self._packet(piece) if piece else None

    def _packet(self, piece: bytes) -> Packet | None:
        try:
            data = cobs_decode(piece)
        except CobsError:
            data = b""
        body = data[: -_CRC.size]
        if len(body) < _HEADER.size or zlib.crc32(body) != _CRC.unpack(data[-_CRC.size :])[0]:
            self.counters.damaged += 1
            return None
        version, kind, sequence, device_time, flags, sample_format, reserved = _HEADER.unpack_from(body)
        if version != VERSION:
            self.counters.version_errors += 1
            self.counters.refused_version = version
            return None
        if reserved:
            self.counters.damaged += 1
            return None
        self.counters.packets += 1
        return Packet(kind, body[_HEADER.size :], sequence, device_time, flags, sample_format)


def _crc_table() -> tuple[int, ...]:
    """Return the table of CRC-16/UMTS (polynomial 0x8005, start 0), the checksum of Protocol 2.0."""
    table = []
    for value in range(256):
        crc = value << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005) & 0xFFFF if crc & 0x8000 else crc << 1
        table.append(crc)
    return tuple(table)


_CRC_TABLE = _crc_table()


def crc16(data: Sequence[int], crc: int = 0) -> int:
    """Return the checksum of `data` as Protocol 2.0 computes it, continuing from `crc`."""
    table = _CRC_TABLE
    for byte in data:
        crc = (crc << 8 & 0xFFFF) ^ table[crc >> 8 ^ byte]
    return crc


def servo_packet(servo: int, body: bytes) -> bytes:
    """Return the packet to or from a servo, its instruction first in `body`, stuffed and with its checksum."""
    body = body.replace(PLAIN, PLAIN + b"\xfd")
    head = HEADER + struct.pack("<BH", servo, len(body) + 2) + body
    return head + struct.pack("<H", crc16(head))


def instruction_packet(servo: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return an instruction as bytes for the wire."""
    return servo_packet(servo, bytes((instruction,)) + parameters)


def sync_write_packet(address: int, length: int, rows: Sequence[tuple[int, bytes]]) -> bytes:
    """Return the instruction that writes `length` bytes to several servos, given as (id, data), at once."""
    data = b"".join(bytes((servo,)) + values for servo, values in rows)
    return instruction_packet(BROADCAST, SYNC_WRITE, struct.pack("<HH", address, length) + data)


@functools.cache
def sync_read_packet(address: int, length: int, servos: tuple[int, ...]) -> bytes:
    """Return the instruction that reads the same registers of several servos."""
    return instruction_packet(BROADCAST, SYNC_READ, struct.pack("<HH", address, length) + bytes(servos))
