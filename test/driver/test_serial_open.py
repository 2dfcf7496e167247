# SPDX-License-Identifier: Apache-2.0
"""Every failure to open a port has its own error and advice, the same for servos and board."""

from __future__ import annotations

import errno
import os
import socket
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

SIDES: dict[str, Callable[[str], object]] = {
    "servos": lambda path: ServoLink(path, 1_000_000).open(),
    "board": lambda path: BoardLink(path).open(),
}


def unix_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))


def hung_up_terminal(path: Path) -> None:
    master, slave = os.openpty()
    path.symlink_to(os.ttyname(slave))
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (Path.mkdir, PortNotSerial, "a directory"),
        (Path.touch, PortNotSerial, "an ordinary file"),
        (os.mkfifo, PortNotSerial, "a named pipe"),
        (unix_socket, PortNotSerial, "a socket"),
        (lambda path: path.symlink_to(os.devnull), PortNotSerial, "serial line"),
        (lambda path: None, PortMissing, "no such port"),
        (lambda path: path.symlink_to("ttyUSB7"), PortMissing, "ttyUSB7"),
        (hung_up_terminal, PortMissing, "no such port"),
    ],
)
def test_a_path_that_is_not_a_port_is_named(
    tmp_path: Path, side: str, make: Callable[[Path], object], error: type[PortError], words: str
) -> None:
    path = tmp_path / "port"
    make(path)
    with pytest.raises(PortError, match=words) as caught:
        SIDES[side](str(path))
    assert type(caught.value) is error
    assert caught.value.port == str(path)
    assert isinstance(caught.value, DriverError)
    assert isinstance(caught.value, ConnectionError)


@pytest.mark.parametrize("side", SIDES)
def test_a_port_in_use_is_busy_for_both_drivers(side: str) -> None:
    with (
        PseudoTerminal(BoardEmulator(BenchPlant())) as cable,
        open_serial(cable.path, 115200),
        pytest.raises(PortBusy),
    ):
        SIDES[side](cable.path)


@pytest.mark.parametrize(
    ("failure", "error", "words"),
    [
        ([serial.SerialException(errno.EACCES, "denied")], PortDenied, "dialout"),
        ([serial.SerialException(errno.EPERM, "denied")], PortDenied, "dialout"),
        ([serial.SerialException(errno.EBUSY, "busy")], PortBusy, "in use"),
        ([serial.SerialException(errno.ENXIO, "no such address")], PortMissing, "no device"),
        ([serial.SerialException(errno.ENODEV, "no such device")], PortMissing, "no device"),
        ([serial.SerialException("cannot configure"), termios.error(errno.EIO, "I/O")], PortMissing, "no device"),
        ([serial.SerialException("cannot configure"), termios.error(errno.ENOTTY, "")], PortNotSerial, "serial line"),
        ([OSError(errno.ENOMEM, "out of memory")], PortError, "out of memory"),
    ],
)
def test_the_systems_error_number_decides(
    monkeypatch: pytest.MonkeyPatch, failure: list[Exception], error: type[PortError], words: str
) -> None:
    def refuse(*arguments: object, **options: object) -> None:
        """Fail like pyserial: with its own error, caused by the system's."""
        raise failure[0] from (failure[1] if len(failure) > 1 else None)

    with PseudoTerminal(BoardEmulator(BenchPlant())) as cable:
        monkeypatch.setattr(serial, "Serial", refuse)
        with pytest.raises(PortError, match=words) as caught:
            open_serial(cable.path, 1_000_000)
    assert type(caught.value) is error


def test_an_impossible_path_is_refused() -> None:
    with pytest.raises(PortError, match="null byte"):
        open_serial("/dev/tty\0USB0", 1_000_000)
    with pytest.raises(PortMissing):
        open_serial("", 1_000_000)
