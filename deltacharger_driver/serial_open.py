# SPDX-License-Identifier: Apache-2.0
"""Open a serial port exclusively; each kind of failure has its own error."""

from __future__ import annotations

import errno
import fcntl
import os
import stat
import termios
from pathlib import Path

import serial

from deltacharger_driver.errors import PortBusy, PortDenied, PortError, PortMissing, PortNotSerial

HANG_UPS = (serial.SerialException, OSError, termios.error, ValueError, TypeError)
"""Errors of a vanished port, depending on the call; the last two if pyserial has dropped its descriptor."""

_PSEUDO_TERMINALS = range(136, 144)  # major numbers of devices
_ABSENT = (errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.EIO, errno.ENOTDIR, errno.ELOOP)
_KINDS = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISREG, "an ordinary file"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISBLK, "a disk"),
)


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
    """Return the visible processes that have opened a port; if any locked it, only these.

    Args:
        path: of the port, or of a link to it.
    """
    target = os.path.realpath(path)
    locked: list[str] = []
    opened: list[str] = []
    for process in sorted(Path("/proc").glob("[0-9]*"), key=lambda folder: int(folder.name)):
        descriptors = [link for link in _links(process / "fd") if _target(link) == target]
        if descriptors:
            name = _name(process)
            opened.append(name)
            if any("lock:" in _text(process / "fdinfo" / link.name) for link in descriptors):
                locked.append(name)
    return locked or opened


def _explain(path: str, error: BaseException) -> PortError:
    number = _number(error)
    if number in (errno.EACCES, errno.EPERM):
        return PortDenied(path, _ownership(path))
    kind = _kind(path)
    if kind or number == errno.ENOTTY:
        return PortNotSerial(path, kind or "a device without a serial line")
    if number in _ABSENT:
        return PortMissing(path, _absence(path))
    if number in (errno.EBUSY, errno.EAGAIN):
        return PortBusy(path, ", ".join(holders(path)))
    return PortError(path, str(error))


def _number(error: BaseException) -> int:
    """Return the system's error number; after a failed set-up, only the cause of pyserial's error has it."""
    link: BaseException | None = error
    while link is not None:
        if isinstance(link, OSError) and link.errno:
            return link.errno
        if isinstance(link, termios.error) and link.args and isinstance(link.args[0], int):
            return link.args[0]
        link = link.__cause__ or link.__context__
    return 0


def _kind(path: str) -> str:
    """Return what a path is if it cannot be a serial port, else ''."""
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return ""
    return next((name for test, name in _KINDS if test(mode)), "")


def _absence(path: str) -> str:
    """Return why a port is missing although its name may exist."""
    if os.path.exists(path):
        return "the name exists, but no device answers there"
    if os.path.islink(path):
        return f"the name links to {os.path.realpath(path)}, which does not exist"
    return ""


def _ownership(path: str) -> str:
    """Return who may open a port, as `ls -l` shows it; '' if that cannot be read."""
    port = Path(path)
    try:
        status = port.stat()
    except OSError:
        return ""
    try:
        owner = f"{port.owner()} {port.group()}"
    except KeyError:  # the ids have no names, as in a container
        owner = f"{status.st_uid} {status.st_gid}"
    return f"{stat.filemode(status.st_mode)} {owner}"


def _links(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []


def _target(link: Path) -> str:
    try:
        return os.readlink(link)
    except OSError:
        return ""


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""


def _name(process: Path) -> str:
    """Return the shortened command line of a process, and its number."""
    command = _text(process / "cmdline").replace("\0", " ").strip() or _text(process / "comm").strip()
    shown = command if len(command) <= 80 else command[:77] + "..."
    return f"'{shown}' (process {process.name})"
