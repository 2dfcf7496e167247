"""The vendor's dynamixel-sdk with its traps closed: a port that sleeps and can be unplugged, a protocol that checks.

The classes below are the SDK's own with single methods replaced; docs/servos.md lists each trap and its test.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import termios
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import serial
from dynamixel_sdk.port_handler import PortHandler
from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler
from dynamixel_sdk.robotis_def import (
    BROADCAST_ID,
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    INST_ACTION,
    INST_PING,
    INST_READ,
)

from .errors import PortBusy, PortDenied, PortError, PortGone, PortMissing

REPLY_MARGIN = 0.02
"""s beyond wire time and USB latency until a reply counts as missing. A healthy servo answers in 1 ms, so this costs
nothing until something fails, and it rides over the scheduling hiccups of an ordinary kernel."""
USB_LATENCY = 1e-3  # s, one USB frame; where the adapter's driver names no latency timer
_DRAIN_LONGEST = 0.02  # s
_HANG_UPS = (serial.SerialException, OSError, termios.error, ValueError, TypeError)
"""What a vanished port raises, by the call and the moment; the last two where pyserial has dropped its descriptor."""

_ID, _LENGTH, _INSTRUCTION, _ERROR, _PARAMETERS = 4, 5, 7, 8, 9


def latency_timer(port: str) -> float:
    """Return how long the adapter on `port` may hold received bytes back, s: the kernel's latency_timer of an FTDI
    chip (16 ms unless a udev rule sets 1), one USB frame for any other."""
    setting = Path("/sys/class/tty") / Path(os.path.realpath(port)).name / "device" / "latency_timer"
    try:
        return int(setting.read_text()) * 1e-3
    except (OSError, ValueError):
        return USB_LATENCY


class ServoPort(PortHandler):  # type: ignore[misc]
    """The SDK's port handler: waits in `select`, keeps time by the monotonic clock, and reports a pulled cable.

    Args:
        port: path, e.g. /dev/ttyUSB0.
        baud_rate: bit/s.
        reply_margin: s, see `REPLY_MARGIN`.
    """

    def __init__(self, port: str, baud_rate: int = 1_000_000, reply_margin: float = REPLY_MARGIN) -> None:
        super().__init__(port)
        self.is_open: bool = False
        self.ser: serial.Serial | None = None
        self.baudrate = baud_rate
        self.latency = USB_LATENCY
        self._margin = reply_margin
        self._descriptor = -1
        self._buffer = bytearray()

    def setupPort(self, cflag_baud: int) -> bool:  # noqa: N802
        """Open the port for this process alone, or change the speed of the open port.

        Raises:
            PortMissing, PortBusy, PortDenied, PortError: it cannot be opened, and why.
            PortGone: it was open and vanished.
        """
        if self.ser is not None and self.is_open:
            try:
                self.ser.baudrate = cflag_baud
            except _HANG_UPS as error:
                raise self._gone(error) from error
        else:
            self.ser = self._open(cflag_baud)
            self._descriptor = self.ser.fileno()
            self.latency = latency_timer(self.port_name)
            self.is_open = True
        self.is_using = False
        self.tx_time_per_byte = 10_000.0 / cflag_baud
        self.clearPort()
        return True

    def closePort(self) -> None:  # noqa: N802
        """Release the port. Never raises."""
        if self.ser is not None:
            with contextlib.suppress(*_HANG_UPS):
                self.ser.close()
        self._descriptor = -1
        self._buffer.clear()
        self.is_open = self.is_using = False

    def clearPort(self) -> None:  # noqa: N802
        """Discard what has been received.

        Raises:
            PortGone: the port vanished.
        """
        self._buffer.clear()
        try:
            termios.tcflush(self._descriptor, termios.TCIFLUSH)
        except _HANG_UPS as error:
            raise self._gone(error) from error

    @property
    def reply_timeout(self) -> float:
        """How long a short reply is waited for, s."""
        return 2.0 * self.latency + self._margin

    def drain(self) -> None:
        """Discard what is still on its way, until the line is quiet: a late reply must not answer the next question.

        Raises:
            PortGone: the port vanished.
        """
        end = time.monotonic() + _DRAIN_LONGEST
        quiet = 2.0 * self.latency
        while self._wait(min(quiet, end - time.monotonic())):
            self._buffer.clear()
        self._buffer.clear()

    def readPort(self, length: int) -> bytes:  # noqa: N802
        """Return up to `length` bytes; sleep for the first of them, at most until the packet's timeout.

        Raises:
            PortGone: the port vanished.
        """
        if length <= 0:
            return b""
        if not self._buffer:
            self._wait(max(self.packet_timeout - self.getTimeSinceStart(), 0.0) * 1e-3)
        data = bytes(self._buffer[:length])
        del self._buffer[:length]
        return data

    def writePort(self, packet: Sequence[int]) -> int:  # noqa: N802
        """Send `packet` and return how many bytes the kernel took.

        Raises:
            PortGone: the port vanished.
        """
        try:
            return os.write(self._descriptor, bytes(packet))
        except BlockingIOError:
            return 0
        except _HANG_UPS as error:
            raise self._gone(error) from error

    def getBytesAvailable(self) -> int:  # noqa: N802
        """Return how many bytes wait to be read."""
        self._wait(0.0)
        return len(self._buffer)

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        """Allow `packet_length` bytes their wire time, the adapter its latency both ways, and the margin."""
        self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + self.reply_timeout * 1e3)

    def getCurrentTime(self) -> float:  # noqa: N802
        """Return the monotonic time in milliseconds, as the SDK counts."""
        return time.monotonic() * 1e3

    def _wait(self, timeout: float) -> bool:
        """Wait at most `timeout` s and take what has come into the buffer; return whether anything has."""
        try:
            if not select.select((self._descriptor,), (), (), max(timeout, 0.0))[0]:
                return False
            data = os.read(self._descriptor, 4096)
        except BlockingIOError:
            return False
        except _HANG_UPS as error:
            raise self._gone(error) from error
        if not data:
            raise self._gone("end of file")
        self._buffer += data
        return True

    def _gone(self, reason: object) -> PortGone:
        self.is_using = False
        self._buffer.clear()
        return PortGone(str(self.port_name), str(reason))

    def _open(self, baud_rate: int) -> serial.Serial:
        port = str(self.port_name)
        try:
            return serial.Serial(port, baud_rate, timeout=0, exclusive=True)
        except _HANG_UPS as error:
            number = getattr(error, "errno", None)
            if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
                raise PortMissing(port) from error
            if number in (errno.EACCES, errno.EPERM):
                raise PortDenied(port) from error
            if number in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in str(error):
                raise PortBusy(port) from error
            raise PortError(port, str(error)) from error


@dataclass
class LinkCounters:
    """What went wrong on the wire since the port was opened.

    Attributes:
        timeouts: replies that did not come.
        corrupt: replies with a bad checksum or cut short.
        late: valid replies to another question, discarded.
    """

    timeouts: int = 0
    corrupt: int = 0
    late: int = 0


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


class ServoProtocol(Protocol2PacketHandler):  # type: ignore[misc]
    """The SDK's Protocol 2.0: stuffs what it sends, and takes a reply only where servo and length are those asked for.

    Attributes:
        counters: what went wrong so far.
    """

    def __init__(self) -> None:
        super().__init__()
        self.counters = LinkCounters()
        self._suspect = False

    def updateCRC(self, crc_accum: int, data_blk_ptr: Sequence[int], data_blk_size: int) -> int:  # noqa: N802
        """Return the checksum of the first `data_blk_size` bytes."""
        return crc16(data_blk_ptr[:data_blk_size], crc_accum)

    def addStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802
        """Double the FD of every FF FF FD behind the length, in place (the SDK changes a copy and loses it)."""
        body: list[int] = []
        for byte in packet[_INSTRUCTION:-2]:
            body.append(byte)
            if byte == 0xFD and body[-3:-1] == [0xFF, 0xFF]:
                body.append(0xFD)
        packet[_INSTRUCTION:-2] = body
        packet[_LENGTH : _LENGTH + 2] = (len(body) + 2).to_bytes(2, "little")
        return packet

    def removeStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802
        """Undo the stuffing and cut the packet to its length (the SDK shifts bytes under its own comparison)."""
        end = int.from_bytes(bytes(packet[_LENGTH : _LENGTH + 2]), "little") + _INSTRUCTION - 2
        body = bytes(packet[_INSTRUCTION:end]).replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        packet[_INSTRUCTION:end] = body
        packet[_LENGTH : _LENGTH + 2] = (len(body) + 2).to_bytes(2, "little")
        del packet[_INSTRUCTION + len(body) + 2 :]
        return packet

    def txPacket(self, port: ServoPort, txpacket: list[int]) -> int:  # noqa: N802
        """Send an instruction; after a failure, wait for the line to fall silent first."""
        if self._suspect:
            self._suspect = False
            port.drain()
        return int(super().txPacket(port, txpacket))

    def rxPacket(self, port: ServoPort, fast_option: bool = False) -> tuple[list[int], int]:  # noqa: N802
        """Receive one packet of whichever servo, and count what goes wrong."""
        packet, result = super().rxPacket(port, fast_option)
        if result == COMM_RX_TIMEOUT:
            self.counters.timeouts += 1
        elif result != COMM_SUCCESS:
            self.counters.corrupt += 1
        self._suspect = self._suspect or result != COMM_SUCCESS
        return packet, int(result)

    def txRxPacket(self, port: ServoPort, txpacket: list[int]) -> tuple[list[int] | None, int, int]:  # noqa: N802
        """Send an instruction and return (reply, result, error byte).

        Another servo's reply, or one of another length, is discarded: it is a late answer to an older question.
        """
        servo, instruction = txpacket[_ID], txpacket[_INSTRUCTION]
        expected = 0
        if instruction == INST_READ:
            expected = txpacket[_PARAMETERS + 1] | txpacket[_PARAMETERS + 2] << 8
        elif instruction == INST_PING:
            expected = 3
        result = self.txPacket(port, txpacket)
        if result != COMM_SUCCESS:
            return None, result, 0
        if servo == BROADCAST_ID or instruction == INST_ACTION:
            port.is_using = False
            return None, result, 0
        port.setPacketTimeout(expected + 11)
        while True:
            reply, result = self.rxPacket(port)
            if result != COMM_SUCCESS:
                return reply, result, 0
            if self._answers(reply, servo, expected):
                return reply, result, reply[_ERROR]

    def sync_read(
        self, port: ServoPort, servos: Sequence[int], address: int, length: int
    ) -> dict[int, tuple[int, bytes]]:
        """Ask several servos for the same registers at once.

        The SDK's GroupSyncRead gives up at the first missing reply, hides the error byte and returns 0 for what it
        does not have; here a servo that gave no good reply is simply absent.

        Args:
            port: an open port.
            servos: ids, in the order in which they shall answer. By the protocol each waits for the one before, so
                those behind a missing servo stay silent.
            address: of the first register.
            length: bytes.

        Returns:
            error byte and data of each servo that answered.

        Raises:
            PortGone: the port vanished.
        """
        replies: dict[int, tuple[int, bytes]] = {}
        if self.syncReadTx(port, address, length, list(servos), len(servos), False) != COMM_SUCCESS:
            return replies
        while len(replies) < len(servos):
            packet, result = self.rxPacket(port)
            if result == COMM_SUCCESS:
                servo = packet[_ID]
                if servo in servos and servo not in replies and self._answers(packet, servo, length):
                    replies[servo] = (packet[_ERROR], bytes(packet[_PARAMETERS : _PARAMETERS + length]))
            elif result == COMM_RX_TIMEOUT or port.packet_timeout == 0:
                break
        return replies

    def _answers(self, reply: list[int], servo: int, expected: int) -> bool:
        """Return whether `reply` is the answer of `servo` with `expected` bytes, or its refusal, which has none."""
        length = len(reply) - 11
        refused = length == 0 and reply[_ERROR] & 0x7F
        if reply[_ID] == servo and (length == expected or refused):
            return True
        self.counters.late += 1
        self._suspect = True
        return False
