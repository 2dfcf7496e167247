# SPDX-License-Identifier: Apache-2.0
"""Servo registers by name over one serial port, with bounded retries and specific errors.

Port and protocol are classes of the vendor's dynamixel-sdk with single methods replaced: they wait without polling,
survive an unplugged cable, stuff what they send and check every reply. docs/servos.md lists each trap and its test.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from dynamixel_sdk.port_handler import PortHandler
from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler
from dynamixel_sdk.robotis_def import COMM_RX_TIMEOUT, COMM_SUCCESS, INST_PING, INST_READ, INST_WRITE

from deltacharger_core.machine import BAUD_RATE
from deltacharger_core.servo_types import SPEEDS
from deltacharger_driver.errors import CorruptReply, DriverError, NoAnswer, PortGone, ServoFault
from deltacharger_driver.packets import HEADER, PLAIN, STATUS, crc16, instruction_packet, sync_read_packet
from deltacharger_driver.parameters import REPLY_MARGIN, STALL_MARGIN
from deltacharger_driver.ports import USB_LATENCY, RawPort, latency_timer
from deltacharger_driver.servos.registers import ALERT, REGISTERS, describe_status_error

PATIENCE = 0.1
"""s, like `parameters.REPLY_MARGIN`, outside the cycle, when only the set-up waits for the reply."""
_DRAIN_LONGEST = 0.02  # s
_ID, _LENGTH, _INSTRUCTION, _ERROR, _PARAMETERS = 4, 5, 7, 8, 9
_SHORTEST = 11  # bytes of a status packet without parameters

ATTEMPTS = 3
"""Attempts before a read or write fails; register accesses may be repeated without harm."""


class ServoPort(PortHandler):  # type: ignore[misc]
    """The SDK's port handler: waits in `poll`, keeps time by the monotonic clock, and reports a pulled cable.

    It is also the clock of everything that uses it, so that emulated servos can be driven in virtual time.

    Args:
        port: path, e.g. /dev/ttyUSB0.
        baud_rate: bit/s.

    Attributes:
        margin: reply margin of the next packets, s.
    """

    def __init__(self, port: str, baud_rate: int = BAUD_RATE) -> None:
        super().__init__(port)
        self.is_open: bool = False
        self.baudrate = baud_rate
        self.latency = USB_LATENCY
        self.margin = PATIENCE
        self._raw: RawPort | None = None
        self._buffer = bytearray()

    def setupPort(self, cflag_baud: int) -> bool:  # noqa: N802
        """Open the port exclusively, or change the speed of the open port.

        Raises:
            PortMissing, PortNotSerial, PortBusy, PortDenied, PortError: it cannot be opened.
            PortGone: it was open and vanished.
        """
        if self._raw is not None:
            self._raw.set_speed(cflag_baud)
        else:
            self._raw = self.open_raw(str(self.port_name), cflag_baud)
            self.latency = latency_timer(self.port_name)
            self.is_open = True
        self.tx_time_per_byte = 10_000.0 / cflag_baud
        self.clearPort()
        return True

    def open_raw(self, path: str, baud_rate: int) -> RawPort:
        """Open the bytes of a port."""
        return RawPort(path, baud_rate)

    def closePort(self) -> None:  # noqa: N802
        """Release the port. Never raises."""
        if self._raw is not None:
            self._raw.close()
        self._raw = None
        self._buffer.clear()
        self.is_open = False

    def _bytes(self) -> RawPort:
        if self._raw is None:
            raise PortGone(str(self.port_name), "it is closed")
        return self._raw

    def clearPort(self) -> None:  # noqa: N802
        """Discard received bytes.

        Raises:
            PortGone: the port vanished.
        """
        self._buffer.clear()
        self._bytes().flush()

    @property
    def reply_timeout(self) -> float:
        """Timeout of a short reply, s."""
        return 2.0 * self.latency + self.margin

    def drain(self, quiet: float = 0.0) -> None:
        """Discard bytes until none came for `quiet` s, at least two USB frames: a late reply must not answer another.

        Raises:
            PortGone: the port vanished.
        """
        end = self.now() + quiet + _DRAIN_LONGEST
        while self._wait(min(max(quiet, 2.0 * self.latency), end - self.now())):
            self._buffer.clear()

    def readPort(self, length: int) -> bytes:  # noqa: N802
        """Return up to `length` bytes; wait for the first one, at most until the packet's timeout.

        Raises:
            PortGone: the port vanished.
        """
        if length <= 0:
            return b""
        data = bytes(self.received()[:length])
        self.discard(len(data))
        return data

    def writePort(self, packet: Sequence[int]) -> int:  # noqa: N802
        """Send `packet` and return its length.

        Raises:
            PortGone: the port vanished or accepts no bytes.
        """
        self._bytes().write(bytes(packet))
        return len(packet)

    def received(self) -> bytes | bytearray:
        """Return the received bytes not yet taken; if there are none, wait like `readPort`.

        Raises:
            PortGone: the port vanished.
        """
        if not self._buffer:
            self._wait(max(self.packet_timeout - self.getTimeSinceStart(), 0.0) * 1e-3)
        return self._buffer

    def discard(self, length: int) -> None:
        """Remove the first `length` received bytes."""
        del self._buffer[:length]

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        """Set the timeout: wire time of `packet_length` bytes, the adapter's latency both ways, and the margin."""
        self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + self.reply_timeout * 1e3)

    def getCurrentTime(self) -> float:  # noqa: N802
        """Return the monotonic time in milliseconds, the SDK's unit."""
        return self.now() * 1e3

    def now(self) -> float:
        """Return the monotonic time, s."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Do nothing for a time."""
        time.sleep(seconds)

    def _wait(self, timeout: float) -> bool:
        """Wait at most `timeout` s for bytes and buffer them; return whether any arrived."""
        data = self._bytes().read(max(timeout, 0.0))
        self._buffer += data
        return bool(data)


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


class ServoProtocol(Protocol2PacketHandler):  # type: ignore[misc]
    """The SDK's Protocol 2.0: stuffs what it sends, and accepts only replies of the right servo and length.

    Attributes:
        counters: communication errors so far.
    """

    def __init__(self) -> None:
        super().__init__()
        self.counters = ServoLinkCounters()
        self._suspect = False

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
        port.writePort(packets)

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
        self.send(port, ahead + sync_read_packet(address, length, servos))
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


class ServoLink:
    """An open port with servos on it, for one thread.

    Args:
        port: path of the serial port.
        baud_rate: bit/s.
        reply_margin: s, for accesses with `hurry`, see `parameters.REPLY_MARGIN`.
        handler: class of the port.

    Attributes:
        counters: communication errors so far.
        clock: keeps the time.
    """

    def __init__(
        self, port: str, baud_rate: int, reply_margin: float = REPLY_MARGIN, handler: type[ServoPort] = ServoPort
    ) -> None:
        self.port = port
        self.baud_rate = baud_rate
        self._margin = reply_margin
        self._handler = self.clock = handler(port, baud_rate)
        self._protocol = ServoProtocol()
        self.counters = self._protocol.counters

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return bool(self._handler.is_open)

    def open(self) -> None:
        """Open the port.

        Raises:
            PortMissing, PortBusy, PortDenied, PortError: it cannot be opened.
        """
        self._handler.baudrate = self.baud_rate
        if not self._handler.openPort():
            speeds = ", ".join(map(str, SPEEDS.values()))
            raise DriverError(f"{self.port}: servos have no speed of {self.baud_rate} bit/s; give one of {speeds}")

    def close(self) -> None:
        """Release the port. Never raises; works from any thread."""
        self._handler.closePort()

    def ping(self, servo: int, attempts: int = 1) -> int:
        """Return the model number of a servo.

        Args:
            servo: its id.
            attempts: number of attempts.

        Raises:
            NoAnswer: no servo with this id answers at this speed.
            CorruptReply: replies arrive, but none is intact.
            PortGone: the port vanished.
        """
        return int(self._ask(servo, "ping", attempts, lambda: (*self._protocol.ping(self._handler, servo)[:2], 0)))

    def read(self, servo: int, name: str, hurry: bool = False) -> int:
        """Return the register `name` of a servo.

        Args:
            servo: its id.
            name: key of `registers.REGISTERS`.
            hurry: one attempt with the cycle's timeout.

        Raises:
            NoAnswer, CorruptReply: no good reply in `ATTEMPTS` attempts.
            ServoFault: the servo rejects it.
            PortGone: the port vanished.
        """
        register = REGISTERS[name]
        return register.from_bytes(self.read_bytes(servo, register.address, register.size, f"read {name}", hurry))

    def read_bytes(self, servo: int, address: int, length: int, action: str = "", hurry: bool = False) -> bytes:
        """Return `length` bytes from `address` of a servo; errors as in `read`."""
        action = action or f"read {length} bytes at {address}"
        attempts = 1 if hurry else ATTEMPTS

        def ask() -> tuple[Any, int, int]:
            return self._protocol.readTxRx(self._handler, servo, address, length)  # type: ignore[no-any-return]

        return bytes(self._ask(servo, action, attempts, ask, hurry))

    def write(self, servo: int, name: str, value: int, hurry: bool = False) -> None:
        """Write the register `name` of a servo.

        Args:
            servo: its id.
            name: key of `registers.REGISTERS`.
            value: in register units.
            hurry: one attempt with the cycle's timeout.

        Raises:
            RangeError: the register cannot hold `value`.
            NoAnswer, CorruptReply: no good reply in `ATTEMPTS` attempts.
            ServoFault: the servo rejects it.
            PortGone: the port vanished.
        """
        register = REGISTERS[name]
        self.write_bytes(servo, register.address, register.to_bytes(value), f"write {name} = {value}", hurry)

    def write_bytes(self, servo: int, address: int, data: bytes, action: str = "", hurry: bool = False) -> None:
        """Write `data` from `address` of a servo on; errors as in `write`."""
        action, values = action or f"write {len(data)} bytes at {address}", list(data)

        def send() -> tuple[None, int, int]:
            return None, *self._protocol.writeTxRx(self._handler, servo, address, len(values), values)

        self._ask(servo, action, 1 if hurry else ATTEMPTS, send, hurry)

    def write_unanswered(self, servo: int, name: str, value: int) -> None:
        """Write a register without waiting for a reply; for a servo set to send none.

        Raises:
            PortGone: the port vanished.
        """
        register = REGISTERS[name]
        address = register.address.to_bytes(2, "little")
        self.send(instruction_packet(servo, INST_WRITE, address + register.to_bytes(value)))

    def sync_read(
        self, servos: Sequence[int], address: int, length: int, ahead: bytes = b""
    ) -> dict[int, tuple[int, bytes]]:
        """Return error byte and data of each servo that answered; see `ServoProtocol.sync_read`."""
        self._handler.margin = self._margin + (STALL_MARGIN if len(servos) > 1 else 0.0)
        return self._protocol.sync_read(self._handler, servos, address, length, ahead)

    def send(self, packets: bytes) -> None:
        """Send packets that get no reply (`protocol.sync_write_packet`).

        Raises:
            PortGone: the port vanished or accepts no bytes.
        """
        self._protocol.send(self._handler, packets)

    def reboot(self, servo: int) -> None:
        """Restart a servo: torque off, latched errors cleared, values outside EEPROM lost.

        Raises:
            NoAnswer, CorruptReply, ServoFault, PortGone: as in `write`, without a retry.
        """
        self._ask(servo, "reboot", 1, lambda: (None, *self._protocol.reboot(self._handler, servo)))

    def _ask(
        self, servo: int, action: str, attempts: int, question: Callable[[], tuple[Any, int, int]], hurry: bool = False
    ) -> Any:
        """Return the data of `question`, which returns (data, result, error byte); retry until the reply is good.

        Raises:
            NoAnswer, CorruptReply, ServoFault, PortGone: as in `read`.
        """
        self._handler.margin = self._margin if hurry else max(self._margin, PATIENCE)
        began, result = self._handler.now(), COMM_RX_TIMEOUT
        for attempt in range(attempts):
            self.counters.retries += attempt > 0
            data, result, code = question()
            if result == COMM_SUCCESS:
                if attempt and data is not None:  # a late answer to an earlier attempt; more come. Writes are read back
                    self._handler.drain(self._handler.now() - began)
                if code & ~ALERT:
                    raise ServoFault(servo, action, describe_status_error(code), code)
                return data
        raise self._failure(servo, action, result, attempts)

    def _failure(self, servo: int, action: str, result: int, attempts: int) -> DriverError:
        device = f"servo {servo}"
        if result == COMM_RX_TIMEOUT:
            return NoAnswer(device, action, attempts * self._handler.reply_timeout)
        return CorruptReply(device, action, self._protocol.getTxRxResult(result).removeprefix("[TxRxResult] "))
