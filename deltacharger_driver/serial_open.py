# SPDX-License-Identifier: Apache-2.0
"""Open a serial port exclusively; each kind of failure has its own error."""

from __future__ import annotations

import errno
import os
import stat
import termios
from pathlib import Path

import serial

from deltacharger_driver.errors import PortBusy, PortDenied, PortError, PortMissing, PortNotSerial

HANG_UPS = (serial.SerialException, OSError, termios.error, ValueError, TypeError)
"""Errors of a vanished port, depending on the call; the last two if pyserial has dropped its descriptor."""

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
        return serial.Serial(path, baud, timeout=0, exclusive=True)
    except HANG_UPS as error:
        raise _explain(path, error) from error


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
        return PortBusy(path)
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
