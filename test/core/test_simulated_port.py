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


@contextlib.contextmanager
def terminal(port: Path) -> Iterator[str]:
    """Create a terminal with a link to it, and return its name."""
    master, slave = pty.openpty()
    port.symlink_to(os.ttyname(slave))
    try:
        yield os.ttyname(slave)
    finally:
        os.close(master)
        os.close(slave)


def test_only_a_terminal_beside_a_listening_simulated_charger_is_its_port(tmp_path: Path) -> None:
    port = tmp_path / "servo"
    with terminal(port) as name:
        assert not is_simulated(str(port)), "a cable passed on by a terminal is as real as any"
        server = ControlServer(tmp_path / CONTROL, lambda request: {})
        try:
            assert not is_simulated(str(port)), "a listener that does not list it"
        finally:
            server.close()
        served = ["/dev/pts/none", name]
        server = ControlServer(tmp_path / CONTROL, lambda request: {"success": True, "ports": served})
        try:
            assert is_simulated(str(port))
            served.pop()
            assert not is_simulated(str(port)), "its charger serves another one"
            served.append(name)
            device = tmp_path / "ttyUSB0"
            device.touch()
            assert not is_simulated(str(device)), "no terminal"
            assert not is_simulated(str(tmp_path / "gone"))
            assert not is_simulated("")
        finally:
            server.close()
        assert not is_simulated(str(port)), "its charger has gone"


class Answerer:
    """Listens in place of a charger and answers with one byte every `pause` s."""

    def __init__(self, path: Path, answer: bytes, pause: float = 0.0) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.bind(str(path))
        self._socket.listen()
        self._answer, self._pause = answer, pause
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        caller, _ = self._socket.accept()
        with caller, contextlib.suppress(OSError):  # the caller's timeout
            for index in range(len(self._answer)):
                time.sleep(self._pause)  # the answerer's pace
                caller.sendall(self._answer[index : index + 1])

    def close(self) -> None:
        self._thread.join()
        self._socket.close()


@pytest.mark.parametrize(
    "answer",
    [
        *(b"", b"\n", b"garbage\n", b"\xff\n", b"[" * 3000 + b"\n", b"null\n", b'{"ports": 5}\n', b'{"ports": true}\n'),
        *(b'{"ports": "TERMINAL"}\n', b'{"ports": "nothing of TERMINAL"}\n', b'{"ports": {"TERMINAL": 1}}\n'),
    ],
)
def test_an_answer_that_lists_no_ports_proves_nothing(tmp_path: Path, answer: bytes) -> None:
    with terminal(tmp_path / "servo") as name:
        answerer = Answerer(tmp_path / CONTROL, answer.replace(b"TERMINAL", name.encode()))
        try:
            assert not is_simulated(str(tmp_path / "servo"))
        finally:
            answerer.close()


def test_a_slow_answer_times_out(tmp_path: Path) -> None:
    with terminal(tmp_path / "servo") as name:
        answerer = Answerer(tmp_path / CONTROL, f'{{"ports": ["{name}"]}}\n'.encode(), 0.1)
        try:
            began = time.monotonic()
            assert not is_simulated(str(tmp_path / "servo"))
            assert time.monotonic() - began < 1.5, "each byte restarted the timeout"
        finally:
            answerer.close()


def test_a_charger_in_a_deep_folder_is_found(tmp_path: Path) -> None:
    folder = tmp_path / ("deep" * 30)
    folder.mkdir()
    with terminal(folder / "servo") as name:
        server = ControlServer(folder / CONTROL, lambda request: {"success": True, "ports": [name]})
        try:
            assert is_simulated(str(folder / "servo"))
        finally:
            server.close()


@pytest.mark.parametrize("port", ["a\0b", "x" * 5000])
def test_an_impossible_path_is_no_simulated_port(port: str) -> None:
    assert not is_simulated(port)
