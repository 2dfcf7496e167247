# SPDX-License-Identifier: Apache-2.0
"""A port belongs to a simulated charger only if the charger beside it lists the port in time."""

from __future__ import annotations

import contextlib
import os
import pty
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from deltacharger_core.runtime import CONTROL, is_simulated
from deltacharger_sim.charger.fault_channel import ControlServer

from ..waiting import host


@pytest.fixture
def port(tmp_path: Path) -> Iterator[tuple[Path, str]]:
    """A terminal's link in a deep folder, and the terminal's name."""
    folder = tmp_path / ("deep" * 30)
    folder.mkdir()
    master, slave = pty.openpty()
    (folder / "servo").symlink_to(os.ttyname(slave))
    yield folder / "servo", os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_only_a_terminal_beside_a_charger_that_lists_it_is_its_port(port: tuple[Path, str]) -> None:
    path, name = port
    device = path.with_name("ttyUSB0")
    device.touch()
    assert not is_simulated(str(path)), "a cable passed on by a terminal is as real as any"
    served = ["/dev/pts/none", name]
    for listed in ({}, {"success": True, "ports": served}):
        with contextlib.closing(ControlServer(path.with_name(CONTROL), lambda request, listed=listed: listed)):
            assert is_simulated(str(path)) == bool(listed)
            for other in (device, path.with_name("gone"), "", "a\0b", "x" * 5000):
                assert not is_simulated(str(other)), "no terminal"
            served.pop()
            assert not is_simulated(str(path)), "its charger serves another one"
            served.append(name)
    assert not is_simulated(str(path)), "its charger has gone"


@pytest.mark.parametrize(
    ("answer", "pause"),
    [
        *((answer, 0.0) for answer in ("", "\n", "garbage\n", "\udcff\n", "[" * 3000 + "\n", "null\n")),
        *((f'{{"ports": {ports}}}\n', 0.0) for ports in ("5", "true", '"TERMINAL"', '{"TERMINAL": 1}')),
        ('{"ports": ["TERMINAL"]}\n', 0.1),  # too slow: no byte restarts the timeout
    ],
)
def test_an_answer_that_lists_no_ports_in_time_proves_nothing(
    port: tuple[Path, str], monkeypatch: pytest.MonkeyPatch, answer: str, pause: float
) -> None:
    path, name = port
    monkeypatch.chdir(path.parent)  # a socket's path is short
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(CONTROL)
    listener.listen()

    def serve() -> None:
        caller, _ = listener.accept()
        with caller, contextlib.suppress(OSError):  # the caller's timeout
            for byte in answer.replace("TERMINAL", name).encode(errors="surrogateescape"):
                time.sleep(pause)  # the answerer's pace
                caller.sendall(bytes([byte]))

    thread = threading.Thread(target=serve)
    thread.start()
    began = time.monotonic()
    assert not is_simulated(str(path))
    assert time.monotonic() - began < host(1.5)
    thread.join()
    listener.close()
