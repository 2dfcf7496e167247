# SPDX-License-Identifier: Apache-2.0
"""Reads and writes servo registers by name over one serial port, with bounded retries and specific errors."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any

from dynamixel_sdk.protocol1_packet_handler import Protocol1PacketHandler
from dynamixel_sdk.robotis_def import COMM_RX_TIMEOUT, COMM_SUCCESS, INST_WRITE

from deltacharger_driver.errors import CorruptReply, DriverError, NoAnswer, ServoFault, WrongThread
from deltacharger_driver.parameters import REPLY_MARGIN, STALL_MARGIN
from deltacharger_driver.servos.mx64 import ALERT, REGISTERS, SPEEDS, describe_status_error
from deltacharger_driver.servos.port import PATIENCE, ServoPort
from deltacharger_driver.servos.protocol import ServoProtocol, instruction_packet

ATTEMPTS = 3
"""Attempts before a read or write fails; register accesses may be repeated without harm."""


class ServoLink:
    """An open port with servos on it. Only the thread that opened it may use it.

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
        self._handler = self.clock = handler(port, baud_rate, reply_margin)
        self._protocol = ServoProtocol()
        self.counters = self._protocol.counters
        self._protocol_1 = Protocol1PacketHandler()
        self._owner: threading.Thread | None = None

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return bool(self._handler.is_open)

    def open(self) -> None:
        """Open the port; the calling thread owns it.

        Raises:
            PortMissing, PortBusy, PortDenied, PortError: it cannot be opened.
        """
        self._owner = threading.current_thread()
        self._handler.baudrate = self.baud_rate
        if not self._handler.openPort():
            speeds = ", ".join(map(str, SPEEDS.values()))
            raise DriverError(f"{self.port}: servos have no speed of {self.baud_rate} bit/s; give one of {speeds}")

    def close(self) -> None:
        """Release the port. Never raises; works from any thread."""
        self._handler.closePort()
        self._owner = None

    def set_speed(self, baud_rate: int) -> None:
        """Change the speed of the port, not of the servos.

        Raises:
            PortGone: the port vanished.
        """
        self._check_owner()
        self._handler.setBaudRate(baud_rate)

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

    def ping_protocol_1(self, servo: int) -> bool:
        """Return whether a servo with this id speaks Protocol 1.0 at this speed.

        Raises:
            PortGone: the port vanished.
        """
        self._begin(hurry=False)
        _, result, _ = self._protocol_1.ping(self._handler, servo)
        return bool(result == COMM_SUCCESS)

    def read(self, servo: int, name: str, hurry: bool = False) -> int:
        """Return the register `name` of a servo.

        Args:
            servo: its id.
            name: key of `mx64.REGISTERS`.
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
            name: key of `mx64.REGISTERS`.
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
        self._begin(hurry=True)
        if len(servos) > 1:
            self._handler.margin += STALL_MARGIN
        return self._protocol.sync_read(self._handler, servos, address, length, ahead)

    def send(self, packets: bytes) -> None:
        """Send packets that get no reply (`protocol.sync_write_packet`).

        Raises:
            PortGone: the port vanished or accepts no bytes.
        """
        self._check_owner()
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
        self._begin(hurry)
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

    def _begin(self, hurry: bool) -> None:
        """Check the calling thread and set the reply timeout."""
        self._check_owner()
        self._handler.margin = self._margin if hurry else max(self._margin, PATIENCE)

    def _check_owner(self) -> None:
        caller = threading.current_thread()
        if self._owner is not caller:
            raise WrongThread(self._owner.name if self._owner else "none (it is closed)", caller.name)

    def _failure(self, servo: int, action: str, result: int, attempts: int) -> DriverError:
        device = f"servo {servo}"
        if result == COMM_RX_TIMEOUT:
            return NoAnswer(device, action, attempts * self._handler.reply_timeout)
        return CorruptReply(device, action, self._protocol.getTxRxResult(result).removeprefix("[TxRxResult] "))
