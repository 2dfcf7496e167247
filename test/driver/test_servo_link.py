# SPDX-License-Identifier: Apache-2.0
"""Access to single servos: opening, repeated requests, and no wrong values."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest
import serial

from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.errors import CorruptReply, DriverError, NoAnswer, PortBusy, PortDenied, PortError, PortMissing
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.servos.link import ServoLink


def test_a_second_program_finds_the_port_busy(terminal: PseudoTerminal, link: ServoLink) -> None:
    with pytest.raises(PortBusy, match="in use"):
        ServoLink(terminal.path, 1_000_000).open()


def test_each_failure_to_open_has_its_own_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(PortMissing, match="no such port") as caught:
        ServoLink(str(tmp_path / "nothing"), 1_000_000).open()
    assert isinstance(caught.value, ConnectionError)
    plain = tmp_path / "file"
    plain.write_text("not a port")
    with pytest.raises(PortError):
        ServoLink(str(plain), 1_000_000).open()

    def refuse(*arguments: object, **options: object) -> None:
        raise serial.SerialException(errno.EACCES, "permission denied")

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(PortDenied, match="dialout"):
        ServoLink(str(plain), 1_000_000).open()


def test_a_speed_that_servos_lack_is_refused(terminal: PseudoTerminal) -> None:
    with pytest.raises(DriverError, match="12345"):
        ServoLink(terminal.path, 12345).open()


def test_requests_with_corrupt_replies_are_repeated(link: ServoLink, emulator: ServoBusEmulator) -> None:
    emulator.faults.next_reply("corrupt", 1, 2)
    assert link.read(1, "input_voltage") == 120
    assert link.counters.corrupt + link.counters.timeouts == link.counters.retries == 2


def test_garbled_replies_are_distinguished_from_silence(link: ServoLink, emulator: ServoBusEmulator) -> None:
    emulator.faults.rate["corrupt"] = 1.0
    with pytest.raises((CorruptReply, NoAnswer)):
        link.read(1, "input_voltage")
    emulator.faults.rate.clear()
    emulator.faults.missing = {1}
    with pytest.raises(NoAnswer, match="servo 1") as caught:
        link.read(1, "input_voltage")
    assert isinstance(caught.value, TimeoutError)


@pytest.mark.parametrize("fault", ["drop", "corrupt", "truncate", "duplicate", "garbage"])
def test_no_wire_fault_gives_a_wrong_value(link: ServoLink, emulator: ServoBusEmulator, fault: str) -> None:
    emulator.faults.rate[fault] = 0.3
    good = 0
    for _ in range(40):
        try:
            assert link.read(2, "input_voltage") == 120
            good += 1
        except (NoAnswer, CorruptReply):
            continue
    assert good > 25
    emulator.faults.rate.clear()
    assert link.read(2, "temperature") == 30
