# SPDX-License-Identifier: Apache-2.0
"""Fault requests are served despite silent clients, and clients do not trust the answering program."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from deltacharger_sim.charger.fault_channel import ControlServer, Registration, ask

from ..bringup.command import run
from ..waiting import wait_until

BOUND = 5.0  # s; a client has 1 s, and one after the other a hundred have 100 s


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)  # a socket's address is short
    return Path("control")


@contextlib.contextmanager
def served(place: Path) -> Iterator[ControlServer]:
    server = ControlServer(place, lambda request: {"success": True, "active": [], "asked": request})
    try:
        yield server
    finally:
        server.close()


def connected(place: Path, sent: bytes = b"") -> socket.socket:
    client = socket.socket(socket.AF_UNIX)
    wait_until(lambda: client.connect_ex(str(place)) == 0, "the connection to be accepted")
    client.settimeout(BOUND)
    client.sendall(sent)
    return client


def test_a_hundred_silent_clients_delay_neither_the_next_client_nor_the_end(place: Path) -> None:
    with contextlib.ExitStack() as clients, served(place) as server:
        for number in range(100):
            clients.enter_context(connected(place, b'{"command"'[:number]))
        assert ask(place, {"command": "active"}, BOUND)["asked"] == {"command": "active"}
        for _ in range(10):
            clients.enter_context(connected(place))
        began = time.monotonic()
        server.close()
        assert time.monotonic() - began < BOUND
        assert not place.exists()


def test_a_client_that_sends_single_bytes_is_dropped(place: Path) -> None:
    with served(place), connected(place) as client:
        client.settimeout(0.05)

        def is_dropped() -> bool:
            try:
                client.sendall(b" ")
                return client.recv(1) == b""
            except TimeoutError:
                return False
            except OSError:
                return True

        wait_until(is_dropped, "its end")


@pytest.mark.parametrize("sent", [b"{" * 20000, b"[" * 16000 + b"\n", b"9" * 16000 + b"\n", b"\xff\xfe\n", b"\n"])
def test_an_invalid_line_is_refused_and_the_next_one_is_served(place: Path, sent: bytes) -> None:
    with served(place):
        with contextlib.suppress(OSError), connected(place, sent) as client:
            reply = client.makefile("rb").readline()
            assert json.loads(reply)["success"] is (sent[0] == b"9") or b"JSON" in reply
        assert ask(place, {"command": "active"}, BOUND)["success"]


def test_an_error_in_one_request_does_not_stop_the_server(place: Path) -> None:
    def defect(request: object) -> dict[str, object]:
        raise KeyError("kind")

    server = ControlServer(place, defect)
    try:
        for _ in range(2):
            assert ask(place, {}, BOUND) == {"success": False, "error": "KeyError: 'kind'"}
    finally:
        server.close()


@contextlib.contextmanager
def other_program(place: Path, parts: list[bytes], pause: float) -> Iterator[None]:
    """A program that sends `parts` to each client, the last of them forever."""
    listener, ending = socket.socket(socket.AF_UNIX), threading.Event()
    listener.bind(str(place))
    listener.listen()

    def serve() -> None:
        while not ending.is_set():
            client, _ = listener.accept()
            with contextlib.suppress(OSError), client:
                client.recv(1000)
                for part in parts:
                    client.sendall(part)
                while pause and not ending.wait(pause):
                    client.sendall(parts[-1])

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        with contextlib.suppress(OSError), connected(place):
            pass
        thread.join(BOUND)
        listener.close()


@pytest.mark.parametrize("part", [b"x", b"x" * 100_000])
def test_an_endless_answer_is_given_up(place: Path, part: bytes) -> None:
    with other_program(place, [part], 0.01):
        began = time.monotonic()
        with pytest.raises(TimeoutError):
            ask(place, {"command": "active"}, timeout=0.5)
        assert time.monotonic() - began < BOUND


@pytest.mark.parametrize(
    "reply",
    [
        b"nonsense\n",
        b"[" * 50_000 + b"\n",
        b"[]\n",
        b"{}\n",
        b'{"success": true}\n',
        b'{"success": false, "error": {}}\n',
        b'{"success": true, "active": [{"kind": "board_drop"}]}\n',
        b'{"success": true, "active": [{"kind": "a", "servo": 1, "amount": "much"}]}\n',
    ],
)
def test_another_answering_program_is_reported(place: Path, capsys: pytest.CaptureFixture[str], reply: bytes) -> None:
    with other_program(place, [reply], 0.0):
        code, out, err = run(capsys, "fault", "--clear", "--directory", ".")
    assert (code, out) == (1, "")
    assert "not a charger" in err


def test_a_hanging_charger_keeps_its_name(place: Path, tmp_path: Path) -> None:
    name = tmp_path / "run" / "charger"
    with socket.socket(socket.AF_UNIX) as hangs, contextlib.ExitStack() as waiting:
        hangs.bind(str(place))
        hangs.listen(0)
        Registration(name, place)
        waiting.enter_context(connected(place))  # the one client that the system queues
        with pytest.raises(FileExistsError, match="another running charger"):
            Registration(name, Path("other"))
