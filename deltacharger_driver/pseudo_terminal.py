"""A pseudo-terminal that serves an emulated serial device: the far end of a cable, without the cable."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
import tty
from pathlib import Path
from types import TracebackType
from typing import Protocol

_LONGEST_WAIT = 0.5  # s, so that stop() is noticed even where the wake-up pipe fails


class ByteDevice(Protocol):
    """A serial device as bytes in and bytes out; it owns no port and no clock."""

    def receive(self, data: bytes, now: float) -> bytes:
        """Take bytes from the host at `now` (s, monotonic) and return the answer, possibly empty."""

    def poll(self, now: float) -> bytes:
        """Return what the device sends unasked at `now` (s, monotonic), possibly empty."""

    def next_event(self, now: float) -> float:
        """Return the seconds until `poll` wants to be called again; inf for never."""


class PseudoTerminal:
    """Serve a `ByteDevice` on a pseudo-terminal from one thread.

    The host opens `path` like any serial port. Bytes that the host does not read are dropped once the kernel's
    buffer is full, as they would be on a wire; termios speed settings are accepted and ignored.

    Args:
        device: the emulated device.
        link: a symbolic link to create (replacing an older one) so that the port has a stable name.
    """

    def __init__(self, device: ByteDevice, link: Path | None = None) -> None:
        self._device = device
        self._link = link
        self._thread: threading.Thread | None = None
        self._master = self._slave = -1
        self._wake_reader = self._wake_writer = -1
        self.path = ""
        self.error: BaseException | None = None

    def start(self) -> PseudoTerminal:
        """Open the terminal, create the link and begin to serve."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._wake_reader, self._wake_writer = os.pipe()
        terminal = os.ttyname(self._slave)
        self.path = terminal
        if self._link is not None:
            self._link.parent.mkdir(parents=True, exist_ok=True)
            self._remove_link()
            self._link.symlink_to(terminal)
            self.path = str(self._link)
        self._thread = threading.Thread(target=self._serve, name=f"pty {terminal}", daemon=True)
        self._thread.start()
        return self

    def stop(self) -> None:
        """Stop serving and close both ends; the host sees the cable pulled. Safe to call twice."""
        if self._thread is None:
            return
        os.write(self._wake_writer, b"x")
        self._thread.join()
        self._thread = None
        for descriptor in (self._master, self._slave, self._wake_reader, self._wake_writer):
            os.close(descriptor)
        if self._link is not None:
            self._remove_link()

    def __enter__(self) -> PseudoTerminal:
        return self.start()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    def _remove_link(self) -> None:
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()

    def _serve(self) -> None:
        poller = select.poll()
        poller.register(self._master, select.POLLIN)
        poller.register(self._wake_reader, select.POLLIN)
        try:
            while True:
                wait = min(max(self._device.next_event(time.monotonic()), 0.0), _LONGEST_WAIT)
                ready = dict(poller.poll(wait * 1000.0))
                if self._wake_reader in ready:
                    return
                if self._master in ready:
                    data = os.read(self._master, 4096)
                    self._send(self._device.receive(data, time.monotonic()))
                self._send(self._device.poll(time.monotonic()))
        except BaseException as error:
            self.error = error
            raise

    def _send(self, data: bytes) -> None:
        while data:
            try:
                written = os.write(self._master, data)
            except BlockingIOError:
                self._drop_unread()
                continue
            data = data[written:]

    def _drop_unread(self) -> None:
        """Make room by discarding what the host never read, the oldest first, as a full receive buffer would."""
        with contextlib.suppress(BlockingIOError):
            os.set_blocking(self._slave, False)
            os.read(self._slave, 4096)
