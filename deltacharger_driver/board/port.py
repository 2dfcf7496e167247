# SPDX-License-Identifier: Apache-2.0
"""The board's serial port: each failure to open has its own error; a vanished port raises `PortGone`."""

from __future__ import annotations

import contextlib
import os
import select

from deltacharger_driver.errors import PortGone
from deltacharger_driver.serial_open import HANG_UPS, open_serial

_WRITE_TIMEOUT = 0.2  # s; a port that accepts no bytes for this time counts as unplugged


class BoardPort:
    """An open serial port, read by `poll` and `os.read`: 1 % of a core at 120 Hz; pyserial's own read takes 25 %.

    One thread reads; any may write, one at a time.

    Args:
        port: path, e.g. /dev/ttyACM0.
        baud_rate: speed on a UART; any on USB.

    Raises:
        PortMissing, PortNotSerial, PortBusy, PortDenied, PortError: the port cannot be opened.
    """

    def __init__(self, port: str, baud_rate: int) -> None:
        self.port = port
        self._serial = open_serial(port, baud_rate)
        self._descriptor = int(self._serial.fileno())
        self._wake_reader, self._wake_writer = os.pipe()
        self._poller = select.poll()
        self._poller.register(self._descriptor, select.POLLIN)
        self._poller.register(self._wake_reader, select.POLLIN)

    def set_speed(self, baud_rate: int) -> None:
        """Change the speed, bit/s; unread bytes are discarded.

        Raises:
            PortGone: the port vanished, or its adapter does not support this speed.
        """
        try:
            self._serial.baudrate = baud_rate
            self._serial.reset_input_buffer()
        except HANG_UPS as error:
            raise PortGone(self.port, str(error)) from error

    def read(self, timeout: float) -> bytes:
        """Wait at most `timeout` s for bytes; return b'' if none arrived or `wake` was called.

        Raises:
            PortGone: the port vanished.
        """
        try:
            ready = dict(self._poller.poll(timeout * 1000.0))
            if self._wake_reader in ready:
                os.read(self._wake_reader, 64)
            if self._descriptor not in ready:
                return b""
            data = os.read(self._descriptor, 4096)
        except BlockingIOError:
            return b""
        except HANG_UPS as error:
            raise PortGone(self.port, str(error)) from error
        if not data:
            raise PortGone(self.port, "end of file")
        return data

    def write(self, data: bytes) -> None:
        """Send all of `data`.

        Raises:
            PortGone: the port vanished or accepts no bytes.
        """
        rest = memoryview(data)
        try:
            while rest:
                try:
                    rest = rest[os.write(self._descriptor, rest) :]
                except BlockingIOError:
                    self._wait_writable()
        except HANG_UPS as error:
            raise PortGone(self.port, str(error)) from error

    def _wait_writable(self) -> None:
        poller = select.poll()
        poller.register(self._descriptor, select.POLLOUT)
        if not poller.poll(_WRITE_TIMEOUT * 1000.0):
            raise OSError(f"it accepted no bytes for {_WRITE_TIMEOUT} s")

    def wake(self) -> None:
        """End a `read` waiting in another thread."""
        with contextlib.suppress(OSError):
            os.write(self._wake_writer, b"x")

    def close(self) -> None:
        """Release the port; no thread may be reading. Never raises."""
        with contextlib.suppress(*HANG_UPS):
            self._serial.close()
        for descriptor in (self._wake_reader, self._wake_writer):
            with contextlib.suppress(OSError):
                os.close(descriptor)
