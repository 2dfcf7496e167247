# SPDX-License-Identifier: Apache-2.0
"""Servo registers by name over one serial port, with bounded retries and specific errors.

The vendor's dynamixel-sdk finds replies among noise. Of its port and protocol classes single methods are replaced: they
wait without polling, survive an unplugged cable and unstuff rightly. What is sent, and which reply counts, is decided
here.
"""

import struct
import time
from collections.abc import Sequence
from dataclasses import dataclass

from dynamixel_sdk.port_handler import PortHandler
from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler
from dynamixel_sdk.robotis_def import COMM_RX_TIMEOUT, COMM_SUCCESS

from deltacharger_core import machine, servo_types
from deltacharger_driver import errors, packets, parameters, ports
from deltacharger_driver.ports import USB_LATENCY
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

    def __init__(self, port: str, baud_rate: int = machine.BAUD_RATE) -> None:
        super().__init__(port)
        self.is_open: bool = False
        self.baudrate = baud_rate
        self.latency = USB_LATENCY
        self.margin = PATIENCE
        self._raw: ports.RawPort | None = None
        self._buffer = bytearray()

    def open(self) -> None:
        """Open the port exclusively.

        Raises:
            PortMissing, PortNotSerial, PortBusy, PortDenied, PortError: it cannot be opened.
        """
        self._raw = self.open_raw(str(self.port_name), self.baudrate)
        self.latency = ports.latency_timer(self.port_name)
        self.tx_time_per_byte = 10_000.0 / self.baudrate
        self.is_open = True
        self.clearPort()

    def open_raw(self, path: str, baud_rate: int) -> ports.RawPort:
        """Open the bytes of a port."""
        return ports.RawPort(path, baud_rate)

    def closePort(self) -> None:  # noqa: N802
        """Release the port. Never raises."""
        if self._raw is not None:
            self._raw.close()
        self._raw = None
        self._buffer.clear()
        self.is_open = False

    def _bytes(self) -> ports.RawPort:
        if self._raw is None:
            raise errors.PortGone(str(self.port_name), "it is closed")
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


class _Receiver(Protocol2PacketHandler):  # type: ignore[misc]
    """The SDK's receiver of packets."""

    def removeStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802
        """Undo the stuffing and cut the packet to its length (the SDK shifts bytes under its own comparison)."""
        end = int.from_bytes(bytes(packet[_LENGTH : _LENGTH + 2]), "little") + _INSTRUCTION - 2
        body = bytes(packet[_INSTRUCTION:end]).replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        packet[_INSTRUCTION:end] = body
        packet[_LENGTH : _LENGTH + 2] = (len(body) + 2).to_bytes(2, "little")
        del packet[_INSTRUCTION + len(body) + 2 :]
        return packet


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
        self,
        port: str,
        baud_rate: int,
        reply_margin: float = parameters.REPLY_MARGIN,
        handler: type[ServoPort] = ServoPort,
    ) -> None:
        self.port = port
        self.baud_rate = baud_rate
        self._margin = reply_margin
        self._handler = self.clock = handler(port, baud_rate)
        self._receiver = _Receiver()
        self.counters = ServoLinkCounters()
        self._suspect = False  # whether bytes of an older reply may still come

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return bool(self._handler.is_open)

    def open(self) -> None:
        """Open the port.

        Raises:
            PortMissing, PortBusy, PortDenied, PortError: it cannot be opened.
        """
        if self.baud_rate not in servo_types.SPEEDS.values():
            speeds = ", ".join(map(str, servo_types.SPEEDS.values()))
            raise errors.DriverError(
                f"{self.port}: servos have no speed of {self.baud_rate} bit/s; give one of {speeds}"
            )
        self._handler.open()

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
        return int.from_bytes(
            self._ask(servo, "ping", packets.instruction_packet(servo, packets.PING), 3, attempts)[:2], "little"
        )

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
        packet = packets.instruction_packet(servo, packets.READ, struct.pack("<HH", address, length))
        action = action or f"read {length} bytes at {address}"
        return self._ask(servo, action, packet, length, 1 if hurry else ATTEMPTS, hurry)

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
        packet = packets.instruction_packet(servo, packets.WRITE, address.to_bytes(2, "little") + data)
        self._ask(servo, action or f"write {len(data)} bytes at {address}", packet, 0, 1 if hurry else ATTEMPTS, hurry)

    def write_unanswered(self, servo: int, name: str, value: int) -> None:
        """Write a register without waiting for a reply; for a servo set to send none.

        Raises:
            PortGone: the port vanished.
        """
        register = REGISTERS[name]
        address = register.address.to_bytes(2, "little")
        self.send(packets.instruction_packet(servo, packets.WRITE, address + register.to_bytes(value)))

    def sync_read(
        self, servos: Sequence[int], address: int, length: int, ahead: bytes = b""
    ) -> dict[int, tuple[int, bytes]]:
        """Read the same registers of several servos at once.

        Args:
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
        self._handler.margin = self._margin + (parameters.STALL_MARGIN if len(servos) > 1 else 0.0)
        self.send(ahead + packets.sync_read_packet(address, length, tuple(servos)))
        self._handler.setPacketTimeout((_SHORTEST + length) * len(servos))
        while len(replies) < len(servos):
            packet, result = self._receive()
            if result == COMM_SUCCESS:
                servo = packet[_ID]
                if servo in servos and servo not in replies and self._answers(packet, servo, length):
                    replies[servo] = (packet[_ERROR], bytes(packet[_PARAMETERS : _PARAMETERS + length]))
            elif result == COMM_RX_TIMEOUT or self._handler.packet_timeout == 0:
                break
        return replies

    def send(self, data: bytes) -> None:
        """Send whole packets in one write. First discard older bytes; after a failure, wait until the line is quiet.

        Raises:
            PortGone: the port vanished or accepts no bytes.
        """
        if self._suspect:
            self._suspect = False
            self._handler.drain()
        self._handler.clearPort()
        self._handler.writePort(data)

    def reboot(self, servo: int) -> None:
        """Restart a servo: torque off, latched errors cleared, values outside EEPROM lost.

        Raises:
            NoAnswer, CorruptReply, ServoFault, PortGone: as in `write`, without a retry.
        """
        self._ask(servo, "reboot", packets.instruction_packet(servo, packets.REBOOT), 0, 1)

    def _ask(self, servo: int, action: str, packet: bytes, expected: int, attempts: int, hurry: bool = False) -> bytes:
        """Send a packet and return the `expected` bytes of its answer; retry until the reply is good.

        Raises:
            NoAnswer, CorruptReply, ServoFault, PortGone: as in `read`.
        """
        port = self._handler
        port.margin = self._margin if hurry else max(self._margin, PATIENCE)
        began, result = port.now(), COMM_RX_TIMEOUT
        for attempt in range(attempts):
            self.counters.retries += attempt > 0
            self.send(packet)
            port.setPacketTimeout(expected + _SHORTEST)
            reply, result = self._receive()
            while result == COMM_SUCCESS and not self._answers(reply, servo, expected):
                reply, result = self._receive()
            if result == COMM_SUCCESS:
                if attempt and expected:  # a late answer to an earlier attempt; more come. Writes are read back
                    port.drain(port.now() - began)
                if (code := reply[_ERROR]) & ~ALERT:
                    raise errors.ServoFault(servo, action, describe_status_error(code))
                return bytes(reply[_PARAMETERS : _PARAMETERS + expected])
        device = f"servo {servo}"
        if result == COMM_RX_TIMEOUT:
            raise errors.NoAnswer(device, action, attempts * port.reply_timeout)
        raise errors.CorruptReply(device, action, self._receiver.getTxRxResult(result).removeprefix("[TxRxResult] "))

    def _receive(self) -> tuple[Sequence[int], int]:
        """Receive one packet from any servo, and count errors; return it with the SDK's result."""
        intact = self._take_intact()
        if intact:
            return intact, COMM_SUCCESS
        receive = self._receiver.rxPacket
        options = [False] * (receive.__code__.co_argcount - 2)  # `fast_option`, since SDK 3.8
        packet, result = receive(self._handler, *options)
        if result == COMM_RX_TIMEOUT:
            self.counters.timeouts += 1
        elif result != COMM_SUCCESS:
            self.counters.corrupt += 1
        self._suspect = self._suspect or result != COMM_SUCCESS
        return packet, int(result)

    def _take_intact(self) -> bytes:
        """Return the received packet if nothing precedes it and it has no stuffing; else b''.

        All other cases are left to the SDK, which handles each byte separately and costs ten times as much.
        """
        data = self._handler.received()
        end = _INSTRUCTION + int.from_bytes(data[_LENGTH:_INSTRUCTION], "little")
        if (
            len(data) < max(end, _SHORTEST)
            or not data.startswith(packets.HEADER)
            or data[_INSTRUCTION] != packets.STATUS
        ):
            return b""
        packet = bytes(data[:end])
        if packet.find(packets.PLAIN, _INSTRUCTION) >= 0 or packets.crc16(packet[:-2]) != packet[-2] | packet[-1] << 8:
            return b""
        self._handler.discard(end)
        return packet

    def _answers(self, reply: Sequence[int], servo: int, expected: int) -> bool:
        """Return whether `reply` is the answer of `servo` with `expected` bytes, or its rejection without data.

        Another one is a late answer to an older request.
        """
        length = len(reply) - _SHORTEST
        refused = length == 0 and reply[_ERROR] & 0x7F
        if reply[_ID] == servo and (length == expected or refused):
            return True
        self.counters.late += 1
        self._suspect = True
        return False
