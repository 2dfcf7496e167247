# SPDX-License-Identifier: Apache-2.0
"""Protocol 2.0 of the vendor's dynamixel-sdk without its pitfalls: it stuffs what it sends and checks every reply.

It is the SDK's class with single methods replaced; docs/servos.md lists each trap and its test.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler
from dynamixel_sdk.robotis_def import (
    BROADCAST_ID,
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    INST_PING,
    INST_READ,
    INST_SYNC_READ,
    INST_SYNC_WRITE,
)

from deltacharger_driver.errors import PortGone
from deltacharger_driver.servos.port import ServoPort

_ID, _LENGTH, _INSTRUCTION, _ERROR, _PARAMETERS = 4, 5, 7, 8, 9
HEADER = b"\xff\xff\xfd\0"
STATUS = 0x55  # the instruction byte of a servo's answer
PLAIN = b"\xff\xff\xfd"  # inside a packet another FD follows it, so that it starts none
_SHORTEST = 11  # bytes of a status packet without parameters


@dataclass
class ServoLinkCounters:
    """Communication errors since the port was opened.

    Attributes:
        timeouts: replies that did not arrive.
        corrupt: replies with a bad checksum or cut short.
        late: valid replies to another request, discarded.
        implausible: intact replies with an impossible value, discarded.
        retries: requests repeated because the first reply was not good.
    """

    timeouts: int = 0
    corrupt: int = 0
    late: int = 0
    implausible: int = 0
    retries: int = 0


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


def packet(servo: int, body: bytes) -> bytes:
    """Return the packet to or from a servo, its instruction first in `body`, stuffed and with its checksum."""
    body = body.replace(PLAIN, PLAIN + b"\xfd")
    head = HEADER + struct.pack("<BH", servo, len(body) + 2) + body
    return head + struct.pack("<H", crc16(head))


def instruction_packet(servo: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return an instruction as bytes for the wire."""
    return packet(servo, bytes((instruction,)) + parameters)


def sync_write_packet(address: int, length: int, rows: Sequence[tuple[int, bytes]]) -> bytes:
    """Return the instruction that writes `length` bytes to several servos, given as (id, data), at once."""
    data = b"".join(bytes((servo,)) + values for servo, values in rows)
    return instruction_packet(BROADCAST_ID, INST_SYNC_WRITE, struct.pack("<HH", address, length) + data)


@functools.lru_cache(maxsize=16)
def sync_read_packet(address: int, length: int, servos: tuple[int, ...]) -> bytes:
    """Return the instruction that reads the same registers of several servos."""
    return instruction_packet(BROADCAST_ID, INST_SYNC_READ, struct.pack("<HH", address, length) + bytes(servos))


class ServoProtocol(Protocol2PacketHandler):  # type: ignore[misc]
    """The SDK's Protocol 2.0: stuffs what it sends, and accepts only replies of the right servo and length.

    Attributes:
        counters: communication errors so far.
    """

    def __init__(self) -> None:
        super().__init__()
        self.counters = ServoLinkCounters()
        self._suspect = False

    def updateCRC(self, crc_accum: int, data_blk_ptr: Sequence[int], data_blk_size: int) -> int:  # noqa: N802
        """Return the checksum of the first `data_blk_size` bytes."""
        return crc16(data_blk_ptr[:data_blk_size], crc_accum)

    def removeStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802
        """Undo the stuffing and cut the packet to its length (the SDK shifts bytes under its own comparison)."""
        end = int.from_bytes(bytes(packet[_LENGTH : _LENGTH + 2]), "little") + _INSTRUCTION - 2
        body = bytes(packet[_INSTRUCTION:end]).replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        packet[_INSTRUCTION:end] = body
        packet[_LENGTH : _LENGTH + 2] = (len(body) + 2).to_bytes(2, "little")
        del packet[_INSTRUCTION + len(body) + 2 :]
        return packet

    def send(self, port: ServoPort, packets: bytes) -> None:
        """Send whole packets in one write. First discard older bytes; after a failure, wait until the line is quiet.

        Raises:
            PortGone: the port vanished or accepts no bytes.
        """
        if self._suspect:
            self._suspect = False
            port.drain()
        port.clearPort()
        if port.writePort(packets) != len(packets):
            raise PortGone(str(port.port_name), "it accepts no more bytes")

    def rxPacket(self, port: ServoPort) -> tuple[Sequence[int], int]:  # noqa: N802
        """Receive one packet from any servo, and count errors."""
        intact = self._take_intact(port)
        if intact:
            return intact, COMM_SUCCESS
        receive = super().rxPacket
        packet, result = receive(port, *[False] * (receive.__code__.co_argcount - 2))  # `fast_option`, since SDK 3.8
        if result == COMM_RX_TIMEOUT:
            self.counters.timeouts += 1
        elif result != COMM_SUCCESS:
            self.counters.corrupt += 1
        self._suspect = self._suspect or result != COMM_SUCCESS
        return packet, int(result)

    @staticmethod
    def _take_intact(port: ServoPort) -> bytes:
        """Return the received packet if nothing precedes it and it has no stuffing; else b''.

        All other cases are left to the SDK, which handles each byte separately and costs ten times as much.
        """
        data = port.received()
        end = _INSTRUCTION + int.from_bytes(data[_LENGTH:_INSTRUCTION], "little")
        if len(data) < max(end, _SHORTEST) or not data.startswith(HEADER) or data[_INSTRUCTION] != STATUS:
            return b""
        packet = bytes(data[:end])
        if packet.find(PLAIN, _INSTRUCTION) >= 0 or crc16(packet[:-2]) != packet[-2] | packet[-1] << 8:
            return b""
        port.discard(end)
        return packet

    def txRxPacket(self, port: ServoPort, txpacket: list[int]) -> tuple[Sequence[int] | None, int, int]:  # noqa: N802
        """Send an instruction, stuffed unlike the SDK's own, and return (reply, result, error byte).

        A reply of another servo or length is discarded: it is a late answer to an older request.
        """
        servo, instruction = txpacket[_ID], txpacket[_INSTRUCTION]
        expected = 0
        if instruction == INST_READ:
            expected = txpacket[_PARAMETERS + 1] | txpacket[_PARAMETERS + 2] << 8
        elif instruction == INST_PING:
            expected = 3
        self.send(port, instruction_packet(servo, instruction, bytes(txpacket[_INSTRUCTION + 1 : -2])))
        port.setPacketTimeout(expected + 11)
        while True:
            reply, result = self.rxPacket(port)
            if result != COMM_SUCCESS:
                return reply, result, 0
            if self._answers(reply, servo, expected):
                return reply, result, reply[_ERROR]

    def sync_read(
        self, port: ServoPort, servos: Sequence[int], address: int, length: int, ahead: bytes = b""
    ) -> dict[int, tuple[int, bytes]]:
        """Read the same registers of several servos at once.

        The SDK's GroupSyncRead gives up at the first missing reply, hides the error byte and returns 0 for missing
        values. Here a servo without a good reply is absent from the result.

        Args:
            port: an open port.
            servos: ids, in the order of their replies. By the protocol each waits for the one before, so those behind
                a missing servo stay silent.
            address: of the first register.
            length: bytes.
            ahead: packets without reply, sent in one write with the request: a second write would cost more than the
                packets themselves.

        Returns:
            Error byte and data of each servo that answered.

        Raises:
            PortGone: the port vanished.
        """
        replies: dict[int, tuple[int, bytes]] = {}
        self.send(port, ahead + sync_read_packet(address, length, tuple(servos)))
        port.setPacketTimeout((_SHORTEST + length) * len(servos))
        while len(replies) < len(servos):
            packet, result = self.rxPacket(port)
            if result == COMM_SUCCESS:
                servo = packet[_ID]
                if servo in servos and servo not in replies and self._answers(packet, servo, length):
                    replies[servo] = (packet[_ERROR], bytes(packet[_PARAMETERS : _PARAMETERS + length]))
            elif result == COMM_RX_TIMEOUT or port.packet_timeout == 0:
                break
        return replies

    def _answers(self, reply: Sequence[int], servo: int, expected: int) -> bool:
        """Return whether `reply` is the answer of `servo` with `expected` bytes, or its rejection without data."""
        length = len(reply) - 11
        refused = length == 0 and reply[_ERROR] & 0x7F
        if reply[_ID] == servo and (length == expected or refused):
            return True
        self.counters.late += 1
        self._suspect = True
        return False
