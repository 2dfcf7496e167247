# SPDX-License-Identifier: Apache-2.0
"""Every failure to open a port has its own error and advice, the same for servos and board."""

import errno
import fcntl
import os
import termios
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import serial

from deltacharger_core.servo_types import SPEEDS
from deltacharger_driver import errors, packets, port_identity, ports
from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.board.protocol import PacketType
from deltacharger_driver.servos.link import ServoLink
from deltacharger_sim.emulators.servo_bus import ServoBusEmulator

from ..emulated_ports import Babbler, use_protocol_1, written
from ..plants import BenchArm

_TIOCGEXCL = 0x80045440  # <asm-generic/ioctls.h>; Python's termios lacks it


def hung_up_terminal(path: Path) -> None:
    master, slave = os.openpty()
    path.symlink_to(os.ttyname(slave))
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (Path.mkdir, errors.PortNotSerial, "not a serial port"),
        (lambda path: path.symlink_to(os.devnull), errors.PortNotSerial, "not a serial port"),
        (lambda path: None, errors.PortMissing, "no such port"),
        (hung_up_terminal, errors.PortMissing, "no such port"),
    ],
)
def test_a_path_that_is_not_a_port_is_named(
    tmp_path: Path, make: Callable[[Path], object], error: type[errors.PortError], words: str
) -> None:
    path = tmp_path / "port"
    make(path)
    with pytest.raises(errors.PortError, match=words) as caught:
        ports.open_serial(str(path), 1_000_000)
    assert type(caught.value) is error
    assert caught.value.port == str(path)


@pytest.mark.parametrize("link", [BoardLink, lambda path: ServoLink(path, 1_000_000)], ids=["board", "servos"])
def test_a_port_in_use_is_busy_for_both_drivers(link: Callable[[str], Any], board_port: str) -> None:
    with ports.open_serial(board_port, 115200), pytest.raises(errors.PortBusy, match=f"process {os.getpid()}"):
        link(board_port).open()


def test_programs_that_ask_for_no_lock_cannot_open_a_port_either(
    board_port: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Root can. A pseudo-terminal would stay closed after its holder was killed."""
    with ports.open_serial(board_port, 115200) as line:
        assert not is_exclusive(line)
    monkeypatch.setattr(ports, "_PSEUDO_TERMINALS", ())
    with ports.open_serial(board_port, 115200) as line:
        assert is_exclusive(line)
        fcntl.ioctl(line.fileno(), termios.TIOCNXCL)


def is_exclusive(line: serial.Serial) -> bool:
    return any(fcntl.ioctl(line.fileno(), _TIOCGEXCL, bytes(4)))


@pytest.mark.parametrize(
    ("failure", "error", "words"),
    [
        ([serial.SerialException(errno.EACCES, "denied")], errors.PortDenied, "dialout"),
        ([serial.SerialException(errno.EBUSY, "busy")], errors.PortBusy, "in use"),
        (
            [serial.SerialException("cannot configure"), termios.error(errno.EIO, "I/O")],
            errors.PortMissing,
            "no such port",
        ),
        (
            [serial.SerialException("cannot configure"), termios.error(errno.ENOTTY, "")],
            errors.PortNotSerial,
            "not a serial",
        ),
    ],
)
def test_the_systems_error_number_decides(
    board_port: str,
    monkeypatch: pytest.MonkeyPatch,
    failure: list[Exception],
    error: type[errors.PortError],
    words: str,
) -> None:
    def refuse(*arguments: object, **options: object) -> None:
        """Fail like pyserial: with its own error, caused by the system's."""
        raise failure[0] from (failure[1] if len(failure) > 1 else None)

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(errors.PortError, match=words) as caught:
        ports.open_serial(board_port, 1_000_000)
    assert type(caught.value) is error


def test_servos_are_found_at_the_speed_of_each(servos: ServoBusEmulator, servo_port: str) -> None:
    speeds = (3, 1, 3)
    for servo, speed in enumerate(speeds, 1):
        servos.servo(servo).table.set("baud", speed)
    servos.faults.inject("drop", 1, 1)  # a lost reply loses no servo
    before = written(servos)
    found = port_identity.identify(servo_port)
    assert found.kind == "servos"
    assert {(s.servo, s.speed, s.protocol, s.model, s.garbled) for s in found.servos} == {
        (servo, SPEEDS[speed], 2, 311, False) for servo, speed in enumerate(speeds, 1)
    }
    assert all(f"id {servo}" in found.details for servo in (1, 2, 3))
    assert written(servos) == before


def test_old_firmware_and_two_servos_with_one_id_are_found() -> None:
    servos = ServoBusEmulator(BenchArm(), ids=(1, 2, 2))
    with ports.PseudoTerminal(servos) as terminal:
        use_protocol_1(servos, 1)
        found = port_identity.identify(terminal.path, speeds=(1_000_000,))
    assert [s.protocol for s in found.servos if s.servo == 1] == [1]
    twins = [s for s in found.servos if s.servo == 2]
    assert len(twins) > 1 or twins[0].garbled


def test_a_board_is_identified_without_changing_its_state(board_port: str) -> None:
    found = port_identity.identify(board_port)
    assert (found.kind, found.servos) == ("board", ())
    with BoardLink(board_port) as link:
        assert link.counters.tactile == 0  # the stream was not started
        link.tare()


@pytest.mark.parametrize(
    ("answer", "kind"),
    [
        (packets.encode_packet(packets.Packet(PacketType.POWER, bytes(16)), version=3), "board"),
        (b"", "silent"),
        (b"login: ", "other"),
    ],
)
def test_other_devices_are_reported(answer: bytes, kind: str) -> None:
    with ports.PseudoTerminal(Babbler(answer)) as terminal:
        found = port_identity.identify(terminal.path, speeds=(1_000_000,))
    assert (found.kind, found.servos) == (kind, ())
