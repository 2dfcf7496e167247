# SPDX-License-Identifier: Apache-2.0
"""Serial ports: open one exclusively, read and write it, or serve an emulated device on a pseudo-terminal."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import stat
import termios
import threading
import time
import tty
from pathlib import Path
from typing import Protocol

import serial

from deltacharger_core.servo_types import SPEEDS
from deltacharger_driver.errors import PortBusy, PortDenied, PortError, PortGone, PortMissing, PortNotSerial

USB_LATENCY = 1e-3  # s, one USB frame; used if the adapter's driver has no latency timer
HANG_UPS = (serial.SerialException, OSError, termios.error, ValueError, TypeError)
"""Errors of a vanished port, depending on the call; the last two if pyserial has dropped its descriptor."""
_PSEUDO_TERMINALS = range(136, 144)  # major numbers of devices
_ABSENT = (errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.EIO, errno.ENOTDIR, errno.ELOOP)

_WRITE_TIMEOUT = 0.2  # s; a port that accepts no bytes for this time counts as unplugged

_LONGEST_WAIT = 0.5  # s; stop() works even if the wake-up fails


def latency_timer(port: str) -> float:
    """Return how long the adapter on `port` may hold received bytes back, s: the kernel's latency_timer of an FTDI
    chip (16 ms unless a udev rule sets 1), one USB frame for any other."""
    setting = Path("/sys/class/tty") / Path(os.path.realpath(port)).name / "device" / "latency_timer"
    try:
        return int(setting.read_text()) * 1e-3
    except (OSError, ValueError):
        return USB_LATENCY


def open_serial(path: str, baud: int) -> serial.Serial:
    """Open a serial port: raw, non-blocking, locked against other programs.

    Two locks, since neither holds everyone off: flock programs that ask for it, also of root; TIOCEXCL all of others.
    A pseudo-terminal has only the first: it would keep the second after its holder was killed, until its other end
    closes.

    Args:
        path: of the device, or of a link to it.
        baud: speed, bit/s.

    Raises:
        PortMissing: the path does not exist, or no device answers there.
        PortNotSerial: a directory, a file, a device without a serial line.
        PortDenied: this user may not open it.
        PortBusy: another program has it open.
        PortError: anything else, such as a speed that the adapter does not support.
    """
    try:
        line = serial.Serial(path, baud, timeout=0, exclusive=True)
        if os.major(os.fstat(line.fileno()).st_rdev) not in _PSEUDO_TERMINALS:
            fcntl.ioctl(line.fileno(), termios.TIOCEXCL)
    except HANG_UPS as error:
        raise _explain(path, error) from error
    return line


def holders(path: str) -> list[str]:
    """Return the visible processes that have opened a port, as "'COMMAND' (process N)".

    Args:
        path: of the port, or of a link to it.
    """
    target = os.path.realpath(path)
    found = []
    for process in sorted(Path("/proc").glob("[0-9]*"), key=lambda folder: int(folder.name)):
        with contextlib.suppress(OSError):  # another user's, or it has ended
            if target in map(os.readlink, (process / "fd").iterdir()):
                command = (process / "cmdline").read_text(errors="replace").replace("\0", " ").strip()
                found.append(f"'{command if len(command) <= 80 else f'{command[:77]}...'}' (process {process.name})")
    return found


def _explain(path: str, error: BaseException) -> PortError:
    number = _number(error)
    if number in (errno.EACCES, errno.EPERM):
        return PortDenied(path, str(error))
    if number == errno.ENOTTY or (os.path.exists(path) and not stat.S_ISCHR(os.stat(path).st_mode)):
        return PortNotSerial(path)
    if number in _ABSENT:
        return PortMissing(path, str(error))
    if number in (errno.EBUSY, errno.EAGAIN):
        return PortBusy(path, ", ".join(holders(path)))
    return PortError(path, str(error))


def _number(error: BaseException | None) -> int:
    """Return the system's error number; after a failed set-up, only the cause of pyserial's error has it."""
    while error is not None:
        number = error.args[0] if isinstance(error, termios.error) and error.args else getattr(error, "errno", None)
        if isinstance(number, int):
            return number
        error = error.__cause__ or error.__context__
    return 0


class RawPort:
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
        self._waker = os.eventfd(0)
        self._poller = select.poll()
        self._poller.register(self._descriptor, select.POLLIN)
        self._poller.register(self._waker, select.POLLIN)

    def set_speed(self, baud_rate: int) -> None:
        """Change the speed, bit/s; unread bytes are discarded.

        Raises:
            PortGone: the port vanished, or its adapter does not support this speed.
        """
        try:
            self._serial.baudrate = baud_rate
        except HANG_UPS as error:
            raise PortGone(self.port, str(error)) from error
        self.flush()

    def flush(self) -> None:
        """Discard unread bytes.

        Raises:
            PortGone: the port vanished.
        """
        try:
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
            if self._waker in ready:
                os.eventfd_read(self._waker)
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
            os.eventfd_write(self._waker, 1)

    def close(self) -> None:
        """Release the port; no thread may be reading. Never raises."""
        with contextlib.suppress(*HANG_UPS):
            self._serial.close()
        with contextlib.suppress(OSError):
            os.close(self._waker)


def _speed_of(descriptor: int) -> int:
    code = termios.tcgetattr(descriptor)[5]
    return next((speed for speed in SPEEDS.values() if getattr(termios, f"B{speed}", None) == code), 0)


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
        self._waker = -1
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
        self._waker = os.eventfd(0)
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
        os.eventfd_write(self._waker, 1)
        self._thread.join()
        self._thread = None
        self._disconnect()
        os.close(self._waker)

    def unplug(self) -> None:
        """Pull the cable: the host loses its port, the device keeps running."""
        self._switch(False, self._unplugged)

    def replug(self) -> None:
        """Put the cable back; `path` changes unless there is a link."""
        self._switch(True, self._plugged)

    def wake(self) -> None:
        """Poll the device now, regardless of `next_event`; callable from any thread."""
        with contextlib.suppress(OSError):
            os.eventfd_write(self._waker, 1)

    def _switch(self, wanted: bool, done: threading.Event) -> None:
        if self._thread is None:
            return
        self._wanted = wanted
        os.eventfd_write(self._waker, 1)
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
        poller.register(self._waker, select.POLLIN)
        if self._master >= 0:
            poller.register(self._master, select.POLLIN)
        ready = dict(poller.poll(wait * 1000.0))
        if self._waker in ready:
            os.eventfd_read(self._waker)
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
