# SPDX-License-Identifier: Apache-2.0
"""The port handler of the vendor's dynamixel-sdk without its pitfalls: it waits without polling, and it survives
an unplugged cable.

It is the SDK's class with single methods replaced; docs/servos.md lists each trap and its test.
"""

from __future__ import annotations

import contextlib
import os
import select
import termios
import time
from collections.abc import Sequence
from pathlib import Path

import serial
from dynamixel_sdk.port_handler import PortHandler

from deltacharger_core.machine import BAUD_RATE
from deltacharger_driver.board.protocol import PacketDecoder
from deltacharger_driver.errors import PortGone, WrongDevice
from deltacharger_driver.parameters import REPLY_MARGIN
from deltacharger_driver.serial_open import HANG_UPS, open_serial

PATIENCE = 0.1
"""s, like `parameters.REPLY_MARGIN`, outside the cycle, when only the set-up waits for the reply."""
USB_LATENCY = 1e-3  # s, one USB frame; used if the adapter's driver has no latency timer
_DRAIN_LONGEST = 0.02  # s
_SUSPECT_BYTES = 4096
"""Number of first bytes that are searched for the board's packets. It sends POWER 20 times a second, so the wait of a
ping receives one; with its 32-bit checksum no servo is mistaken for a board."""


def latency_timer(port: str) -> float:
    """Return how long the adapter on `port` may hold received bytes back, s: the kernel's latency_timer of an FTDI
    chip (16 ms unless a udev rule sets 1), one USB frame for any other."""
    setting = Path("/sys/class/tty") / Path(os.path.realpath(port)).name / "device" / "latency_timer"
    try:
        return int(setting.read_text()) * 1e-3
    except (OSError, ValueError):
        return USB_LATENCY


class ServoPort(PortHandler):  # type: ignore[misc]
    """The SDK's port handler: waits in `poll`, keeps time by the monotonic clock, and reports a pulled cable.

    It is also the clock of everything that uses it, so that emulated servos can be driven in virtual time.

    Every method that receives raises `WrongDevice` if the first bytes after opening are the board's.

    Args:
        port: path, e.g. /dev/ttyUSB0.
        baud_rate: bit/s.
        reply_margin: s, see `parameters.REPLY_MARGIN`.

    Attributes:
        margin: reply margin of the next packets, s.
    """

    def __init__(self, port: str, baud_rate: int = BAUD_RATE, reply_margin: float = REPLY_MARGIN) -> None:
        super().__init__(port)
        self.is_open: bool = False
        self.ser: serial.Serial | None = None
        self.baudrate = baud_rate
        self.latency = USB_LATENCY
        self.margin = reply_margin
        self._descriptor = -1
        self._poller = select.poll()
        self._buffer = bytearray()
        self._board: PacketDecoder | None = None

    def setupPort(self, cflag_baud: int) -> bool:  # noqa: N802
        """Open the port exclusively, or change the speed of the open port.

        Raises:
            PortMissing, PortNotSerial, PortBusy, PortDenied, PortError: it cannot be opened.
            PortGone: it was open and vanished.
        """
        if self.ser is not None and self.is_open:
            try:
                self.ser.baudrate = cflag_baud
            except HANG_UPS as error:
                raise self._gone(error) from error
        else:
            self.ser = open_serial(str(self.port_name), cflag_baud)
            self._descriptor = self.ser.fileno()
            self._poller = select.poll()
            self._poller.register(self._descriptor, select.POLLIN)
            self._board = PacketDecoder()
            self.latency = latency_timer(self.port_name)
            self.is_open = True
        self.is_using = False
        self.tx_time_per_byte = 10_000.0 / cflag_baud
        self.clearPort()
        return True

    def closePort(self) -> None:  # noqa: N802
        """Release the port. Never raises."""
        if self.ser is not None:
            with contextlib.suppress(*HANG_UPS):
                self.ser.close()
        self._descriptor = -1
        self._buffer.clear()
        self.is_open = self.is_using = False

    def clearPort(self) -> None:  # noqa: N802
        """Discard received bytes.

        Raises:
            PortGone: the port vanished.
        """
        self._buffer.clear()
        try:
            termios.tcflush(self._descriptor, termios.TCIFLUSH)
        except HANG_UPS as error:
            raise self._gone(error) from error

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
        """Send `packet` and return the number of bytes that the kernel accepted.

        Raises:
            PortGone: the port vanished.
        """
        try:
            return os.write(self._descriptor, bytes(packet))
        except BlockingIOError:
            return 0
        except HANG_UPS as error:
            raise self._gone(error) from error

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
        try:
            if not self._poller.poll(max(timeout, 0.0) * 1e3):
                return False
            data = os.read(self._descriptor, 4096)
        except BlockingIOError:
            return False
        except HANG_UPS as error:
            raise self._gone(error) from error
        if not data:
            raise self._gone("end of file")
        self._buffer += data
        if self._board is not None:
            self._refuse_board(self._board, data)
        return True

    def _refuse_board(self, decoder: PacketDecoder, data: bytes) -> None:
        decoder.feed(data)
        counters = decoder.counters
        if counters.packets or counters.version_errors:
            self.is_using = False
            raise WrongDevice(str(self.port_name), "the servos", "the board with the pads and the power stage")
        if counters.bytes >= _SUSPECT_BYTES:
            self._board = None

    def _gone(self, reason: object) -> PortGone:
        self.is_using = False
        self._buffer.clear()
        return PortGone(str(self.port_name), str(reason))
