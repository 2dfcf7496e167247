# SPDX-License-Identifier: Apache-2.0
"""Findings of the doctor for ports that cannot be opened, and for ports that can."""

from __future__ import annotations

import errno
import grp
import os
import subprocess
import sys

import pytest
import serial

from deltacharger_bringup.doctor.ports import examine_port, holders
from deltacharger_driver.serial_open import open_serial

from .found import one


def test_a_busy_port_names_its_user(board_port: str) -> None:
    script = "import sys, serial; port = serial.Serial(sys.argv[1], exclusive=True); print('open', flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", script, board_port], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "open\n"
        found = list(examine_port("board port", board_port))
        named = holders(board_port)
        holder.communicate("\n")
    assert [finding.level for finding in found] == ["wrong"]
    assert f"process {holder.pid}" in found[0].message
    assert len(named) == 1  # the emulator's end of the terminal does not count


def test_a_process_that_opened_a_port_without_a_lock_is_named(silent_port: str) -> None:
    with open(silent_port, "rb"):
        assert any(f"process {os.getpid()}" in name for name in holders(silent_port))


@pytest.mark.parametrize(
    ("path", "words"),
    [("/dev/does-not-exist", "no such port"), ("/dev", "a directory"), ("/dev/null", "not a serial port")],
)
def test_a_path_that_is_no_port_is_wrong_with_a_remedy(path: str, words: str) -> None:
    found = list(examine_port("servo port", path))
    assert [finding.level for finding in found] == ["wrong"]
    assert words in found[0].message
    assert found[0].remedy


def test_a_forbidden_port_names_the_group(monkeypatch: pytest.MonkeyPatch, silent_port: str) -> None:
    def refuse(*arguments: object, **options: object) -> None:
        raise serial.SerialException(errno.EACCES, "Permission denied")

    monkeypatch.setattr(serial, "Serial", refuse)
    found = list(examine_port("servo port", silent_port))
    assert [finding.level for finding in found] == ["wrong"]
    assert "permission denied" in found[0].message
    assert f"usermod -aG {grp.getgrgid(os.stat(silent_port).st_gid).gr_name}" in found[0].remedy


def test_an_adapter_that_delays_bytes_gives_a_hint(monkeypatch: pytest.MonkeyPatch, silent_port: str) -> None:
    monkeypatch.setattr("deltacharger_driver.servos.port.latency_timer", lambda port: 16e-3)
    finding = one(examine_port("servo port", silent_port), "hint", "servo port")
    assert "16 ms" in finding.message
    assert "99-deltacharger.rules" in finding.remedy


def test_a_free_port_opens_and_is_closed_again(silent_port: str) -> None:
    assert [finding.level for finding in examine_port("servo port", silent_port)] == ["ok"]
    open_serial(silent_port, 1_000_000).close()
