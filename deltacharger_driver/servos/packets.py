# SPDX-License-Identifier: Apache-2.0
"""Packets of Protocol 2.0, and a part of 1.0, on the servo's side: instructions in, status packets out. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from deltacharger_driver.servos.protocol import HEADER, PLAIN, STATUS, crc16, packet

BROADCAST = 254
STUFFED = PLAIN + b"\xfd"

PING, READ, WRITE, REG_WRITE, ACTION, REBOOT = 1, 2, 3, 4, 5, 8
SYNC_READ, SYNC_WRITE = 0x82, 0x83

_LONGEST = 1024  # bytes of a packet; a longer length is noise
_SILENCE = 0.02  # s without a byte after which an incomplete packet is discarded


@dataclass(frozen=True)
class Instruction:
    """One instruction packet.

    Attributes:
        servo: id of the addressed servo, or BROADCAST.
        code: instruction.
        parameters: unstuffed.
        intact: whether its checksum is right.
        size: bytes on the wire.
        protocol: 1 or 2.
    """

    servo: int
    code: int
    parameters: bytes
    intact: bool
    size: int
    protocol: int = 2


def status(servo: int, error: int, parameters: bytes = b"") -> bytes:
    """Return the status packet (Protocol 2.0) of a servo."""
    return packet(servo, bytes((STATUS, error)) + parameters)


def status_1(servo: int, error: int, parameters: bytes = b"") -> bytes:
    """Return the status packet (Protocol 1.0) of a servo."""
    body = bytes((servo, len(parameters) + 2, error)) + parameters
    return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))


def _interrupted(body: bytearray) -> bool:
    """Return whether an unstuffed header precedes the checksum: a servo restarts its parser there."""
    if PLAIN not in body:
        return False
    at = body.replace(STUFFED, b"\0\0\0\0").find(PLAIN)
    return 0 <= at < len(body) - 4


class InstructionParser:
    """Finds instruction packets in a stream of bytes; skips anything else, as a servo does.

    Attributes:
        protocol_1: whether to recognise Protocol 1.0 too.
    """

    def __init__(self, protocol_1: bool = False) -> None:
        self.protocol_1 = protocol_1
        self._buffer = bytearray()
        self._heard = 0.0

    def feed(self, data: bytes, now: float) -> list[Instruction]:
        """Take `data`, received at `now` (s), and return the packets completed by it."""
        if now - self._heard > _SILENCE:
            self._buffer.clear()
        self._heard = now
        self._buffer += data
        found = []
        while (instruction := self._next()) is not None:
            found.append(instruction)
        return found

    def _next(self) -> Instruction | None:
        buffer = self._buffer
        while True:
            start = buffer.find(b"\xff\xff")
            if start < 0:
                del buffer[: max(len(buffer) - 1, 0)]
                return None
            del buffer[:start]
            if len(buffer) < 4:
                return None
            if buffer.startswith(HEADER):
                if len(buffer) < 10:
                    return None
                size = int.from_bytes(buffer[5:7], "little") + 7
                if 10 <= size <= _LONGEST and not _interrupted(buffer[7:size]):
                    return self._take(size) if len(buffer) >= size else None
            elif self.protocol_1 and buffer[2] < 0xFD and 2 <= buffer[3] <= 8:
                size = buffer[3] + 4
                return self._take_1(size) if len(buffer) >= size else None
            del buffer[0]

    def _take(self, size: int) -> Instruction:
        packet = bytes(self._buffer[:size])
        del self._buffer[:size]
        parameters = packet[8:-2]
        if STUFFED in packet:
            parameters = packet[7:-2].replace(STUFFED, PLAIN)[1:]
        intact = crc16(packet[:-2]) == int.from_bytes(packet[-2:], "little")
        return Instruction(packet[4], packet[7], parameters, intact, size)

    def _take_1(self, size: int) -> Instruction:
        packet = bytes(self._buffer[:size])
        del self._buffer[:size]
        intact = (~sum(packet[2:-1]) & 0xFF) == packet[-1]
        return Instruction(packet[2], packet[4], packet[5:-1], intact, size, protocol=1)
