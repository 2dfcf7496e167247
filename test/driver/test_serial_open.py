# SPDX-License-Identifier: Apache-2.0
"""Every failure to open a port has its own error and advice, the same for servos and board."""

from __future__ import annotations

import errno
import os
import socket
import stat
import termios
from collections.abc import Callable
from pathlib import Path

import pytest
import serial

from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.emulators.bench_plant import BenchPlant
from deltacharger_driver.emulators.board import BoardEmulator
from deltacharger_driver.errors import DriverError, PortBusy, PortDenied, PortError, PortMissing, PortNotSerial
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.serial_open import open_serial
from deltacharger_driver.servos.link import ServoLink


def open_servos(path: str) -> None:
    ServoLink(path, 1_000_000).open()


def open_board(path: str) -> None:
    BoardLink(path).open()


def directory(folder: Path) -> Path:
    return folder


def plain_file(folder: Path) -> Path:
    path = folder / "file"
    path.write_text("not a port")
    return path


def pipe(folder: Path) -> Path:
    path = folder / "pipe"
    os.mkfifo(path)
    return path


def unix_socket(folder: Path) -> Path:
    path = folder / "socket"
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
    return path


def null(folder: Path) -> Path:
    return Path(os.devnull)


def nothing(folder: Path) -> Path:
    return folder / "nothing"


def below_a_file(folder: Path) -> Path:
    return plain_file(folder) / "port"


def dangling_link(folder: Path) -> Path:
    path = folder / "link"
    path.symlink_to(folder / "ttyUSB7")
    return path


def hung_up_terminal(folder: Path) -> Path:
    master, slave = os.openpty()
    path = Path(os.ttyname(slave))
    os.close(master)
    os.close(slave)
    return path


SITUATIONS: list[tuple[Callable[[Path], Path], type[PortError], str]] = [
    (directory, PortNotSerial, "a directory"),
    (plain_file, PortNotSerial, "an ordinary file"),
    (pipe, PortNotSerial, "a named pipe"),
    (unix_socket, PortNotSerial, "a socket"),
    (null, PortNotSerial, "a device without a serial line"),
    (nothing, PortMissing, "no such port; plug the adapter in"),
    (below_a_file, PortMissing, "no such port"),
    (dangling_link, PortMissing, "ttyUSB7, which does not exist"),
    (hung_up_terminal, PortMissing, "no such port"),
]


@pytest.mark.parametrize("side", [open_servos, open_board])
@pytest.mark.parametrize(("situation", "error", "words"), SITUATIONS, ids=[s[0].__name__ for s in SITUATIONS])
def test_a_path_that_is_not_a_port_is_named(
    tmp_path: Path,
    side: Callable[[str], None],
    situation: Callable[[Path], Path],
    error: type[PortError],
    words: str,
) -> None:
    path = str(situation(tmp_path))
    with pytest.raises(PortError, match=words) as caught:
        side(path)
    assert type(caught.value) is error
    assert caught.value.port == path
    assert isinstance(caught.value, DriverError)
    assert isinstance(caught.value, ConnectionError)


@pytest.mark.parametrize("side", [open_servos, open_board])
def test_a_port_in_use_is_busy_for_both_drivers(side: Callable[[str], None]) -> None:
    with (
        PseudoTerminal(BoardEmulator(BenchPlant())) as cable,
        open_serial(cable.path, 115200),
        pytest.raises(PortBusy, match="another program"),
    ):
        side(cable.path)


def fail(*behind: BaseException) -> Callable[..., None]:
    """Return a serial.Serial that fails like pyserial: its own error, caused by the system's."""

    def refuse(*arguments: object, **options: object) -> None:
        try:
            raise behind[-1]
        except (OSError, termios.error) as cause:
            if len(behind) == 1:
                raise
            raise behind[0] from cause

    return refuse


@pytest.mark.parametrize(
    ("failure", "error", "words"),
    [
        ((serial.SerialException(errno.EACCES, "denied"),), PortDenied, "dialout"),
        ((serial.SerialException(errno.EPERM, "denied"),), PortDenied, "dialout"),
        ((serial.SerialException(errno.EBUSY, "busy"),), PortBusy, "in use"),
        ((serial.SerialException(errno.ENXIO, "no such address"),), PortMissing, "no device answers there"),
        ((serial.SerialException(errno.ENODEV, "no such device"),), PortMissing, "no device answers there"),
        (
            (serial.SerialException("Could not configure port"), termios.error(errno.EIO, "Input/output error")),
            PortMissing,
            "no device answers there",
        ),
        (
            (serial.SerialException("Could not configure port"), termios.error(errno.ENOTTY, "Inappropriate ioctl")),
            PortNotSerial,
            "without a serial line",
        ),
        ((OSError(errno.ENOMEM, "out of memory"),), PortError, "out of memory"),
    ],
)
def test_the_systems_error_number_decides(
    monkeypatch: pytest.MonkeyPatch, failure: tuple[Exception, ...], error: type[PortError], words: str
) -> None:
    with PseudoTerminal(BoardEmulator(BenchPlant())) as cable:
        monkeypatch.setattr(serial, "Serial", fail(*failure))
        with pytest.raises(PortError, match=words) as caught:
            open_serial(cable.path, 1_000_000)
    assert type(caught.value) is error


def test_a_forbidden_port_reports_its_owner(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = plain_file(tmp_path)
    path.chmod(0o640)
    monkeypatch.setattr(serial, "Serial", fail(serial.SerialException(errno.EACCES, "denied")))
    with pytest.raises(PortDenied, match="-rw-r-----") as caught:
        open_serial(str(path), 1_000_000)
    assert stat.filemode(path.stat().st_mode) in caught.value.reason


def test_an_impossible_path_is_refused() -> None:
    with pytest.raises(PortError, match="null byte"):
        open_serial("/dev/tty\0USB0", 1_000_000)
    with pytest.raises(PortMissing):
        open_serial("", 1_000_000)
