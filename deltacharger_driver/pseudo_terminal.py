# SPDX-License-Identifier: Apache-2.0
"""A pseudo-terminal that serves an emulated serial device."""

from __future__ import annotations

import contextlib
import os
import select
import termios
import threading
import time
import tty
from pathlib import Path
from typing import Protocol

from deltacharger_driver.servos.mx64 import SPEEDS

_LONGEST_WAIT = 0.5  # s; stop() works even if the wake-up pipe fails


_SPEEDS = tuple(SPEEDS.values())


def _speed_of(descriptor: int) -> int:
    code = termios.tcgetattr(descriptor)[5]
    return next((speed for speed in _SPEEDS if getattr(termios, f"B{speed}", None) == code), 0)


class ByteDevice(Protocol):
    """A serial device as bytes in and bytes out, without port and clock."""

    def receive(self, data: bytes, now: float) -> bytes:
        """Take bytes from the host at `now` (s, monotonic) and return the answer, possibly empty."""

    def poll(self, now: float) -> bytes:
        """Return bytes that the device sends without a request at `now` (s, monotonic); may be empty."""

    def next_event(self, now: float) -> float:
        """Return the seconds until the next call of `poll` is due; inf for never."""


class PseudoTerminal:
    """Serve a `ByteDevice` on a pseudo-terminal from one thread.

    The host opens `path` like any serial port. Once the kernel's buffer is full, bytes that the host does not read
    are dropped, as on a wire. The host may set any termios speed; `speed` returns it.

    Args:
        device: the emulated device.
        link: a symbolic link to create, replacing an older one: a stable name of the port.
    """

    def __init__(self, device: ByteDevice, link: Path | None = None) -> None:
        self._device = device
        self._link = link
        self._thread: threading.Thread | None = None
        self._master = self._slave = -1
        self._wake_reader = self._wake_writer = -1
        self._stopping = False
        self._wanted = True
        self._plugged = threading.Event()
        self._unplugged = threading.Event()
        self.path = self._terminal = ""
        self.error: BaseException | None = None

    def speed(self) -> int:
        """Return the speed that the host has set, bit/s; 0 if servos do not support it or the cable is out."""
        try:
            return _speed_of(self._slave) if self._slave >= 0 else 0
        except (OSError, termios.error):  # cable pulled
            return 0

    def start(self) -> PseudoTerminal:
        """Open the terminal, create the link and start the thread."""
        self._wake_reader, self._wake_writer = os.pipe()
        self._stopping = False
        self._wanted = True
        self._connect()
        self._thread = threading.Thread(target=self._serve, name=f"pty {os.ttyname(self._slave)}", daemon=True)
        self._thread.start()
        return self

    def stop(self) -> None:
        """Stop serving and close both ends; the host sees the cable pulled. Safe to call twice."""
        if self._thread is None:
            return
        self._stopping = True
        os.write(self._wake_writer, b"x")
        self._thread.join()
        self._thread = None
        self._disconnect()
        os.close(self._wake_reader)
        os.close(self._wake_writer)

    def unplug(self) -> None:
        """Pull the cable: the host loses its port, the device keeps running."""
        self._switch(False, self._unplugged)

    def replug(self) -> None:
        """Put the cable back; `path` changes unless there is a link."""
        self._switch(True, self._plugged)

    def wake(self) -> None:
        """Poll the device now, regardless of `next_event`; callable from any thread."""
        with contextlib.suppress(OSError):
            os.write(self._wake_writer, b"x")

    def _switch(self, wanted: bool, done: threading.Event) -> None:
        if self._thread is None:
            return
        self._wanted = wanted
        os.write(self._wake_writer, b"x")
        done.wait(_LONGEST_WAIT * 4)

    def _connect(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        terminal = os.ttyname(self._slave)
        self.path = self._terminal = terminal
        if self._link is not None:
            self._link.parent.mkdir(parents=True, exist_ok=True)
            if self._link.is_symlink():
                self._link.unlink()
            self._link.symlink_to(terminal)
            self.path = str(self._link)
        self._unplugged.clear()
        self._plugged.set()

    def _disconnect(self) -> None:
        if self._master >= 0:
            os.close(self._master)
            os.close(self._slave)
            self._master = self._slave = -1
        self._remove_link()
        self._plugged.clear()
        self._unplugged.set()

    def __enter__(self) -> PseudoTerminal:
        return self.start()

    def __exit__(self, *exception: object) -> None:
        self.stop()

    def _remove_link(self) -> None:
        """Remove the link, unless it points to another terminal."""
        if self._link is not None and self._link.is_symlink() and os.readlink(self._link) == self._terminal:
            self._link.unlink()

    def _serve(self) -> None:
        try:
            while not self._stopping:
                if self._wanted and self._master < 0:
                    self._connect()
                elif not self._wanted and self._master >= 0:
                    self._disconnect()
                self._exchange()
        except BaseException as error:
            self.error = error
            raise

    def _exchange(self) -> None:
        """Wait for bytes, the device's next event or a wake-up; then pass bytes on."""
        wait = min(max(self._device.next_event(time.monotonic()), 0.0), _LONGEST_WAIT)
        poller = select.poll()
        poller.register(self._wake_reader, select.POLLIN)
        if self._master >= 0:
            poller.register(self._master, select.POLLIN)
        ready = dict(poller.poll(wait * 1000.0))
        if self._wake_reader in ready:
            os.read(self._wake_reader, 64)
        if self._master in ready:
            data = os.read(self._master, 4096)
            self._send(self._device.receive(data, time.monotonic()))
        self._send(self._device.poll(time.monotonic()))

    def _send(self, data: bytes) -> None:
        while data and self._master >= 0:
            try:
                written = os.write(self._master, data)
            except BlockingIOError:
                self._drop_unread()
                continue
            data = data[written:]

    def _drop_unread(self) -> None:
        """Discard the oldest bytes that the host did not read, as a full receive buffer does."""
        with contextlib.suppress(BlockingIOError):
            os.set_blocking(self._slave, False)
            os.read(self._slave, 4096)
