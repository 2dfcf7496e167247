# SPDX-License-Identifier: Apache-2.0
"""Faults by request: every kind is caused and ended; silent clients delay nobody; clients trust no other program."""

import contextlib
import json
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from deltacharger_driver.servos.link import ServoLink
from deltacharger_sim.charger.fault_channel import ControlServer, answer, ask
from deltacharger_sim.charger.faults import KINDS, Faults, Hardware
from deltacharger_sim.emulators.servo_bus import ServoBusEmulator

from ..driver.board_bench import Bench
from ..driver.virtual_line import Clock, Line
from ..plants import BenchArm
from ..waiting import wait_until
from .fault_table import ROWS

BOUND = 5.0  # s; a client has 1 s, and one after the other a hundred have 100 s


class Plug:
    """A terminal that is plugged or not."""

    plugged = True

    def unplug(self) -> None:
        self.plugged = False

    def replug(self) -> None:
        self.plugged = True

    def change_target(self, values: dict[str, float]) -> dict[str, float]:
        return values


def test_the_table_has_every_kind() -> None:
    assert {row.kind for row in ROWS} == set(KINDS)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_caused_and_ended_by_request(kind: str) -> None:
    """On both emulators in virtual time."""
    clock, board, plug = Clock(), Bench(), Plug()
    servos = ServoBusEmulator(BenchArm(clock=clock))
    hardware: Any = Hardware(servos, board.board, plug, plug, plug)  # type: ignore[arg-type]
    faults = Faults((), hardware, clock)
    caused = answer(faults, {"command": "begin", "kind": kind})
    assert [each["kind"] for each in caused["active"]] == ([kind] if KINDS[kind].lasts else [])
    assert plug.plugged is not kind.endswith("unplugged")
    assert answer(faults, {"command": "clear"}) == {"success": True, "active": []}
    assert plug.plugged
    with Line(servos, clock) as line:
        clock.sleep(1.0)
        link = ServoLink(line.path, 1_000_000, handler=line.handler)
        link.open()
        assert [link.ping(servo) for servo in (1, 2, 3)] == [311] * 3
    count = len(board.packets)
    board.run(0.5)
    assert len(board.packets) > count


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)  # a socket's address is short
    return Path("control")


Handler = Callable[[Any], dict[str, Any]]


@pytest.fixture
def served(place: Path) -> Iterator[Callable[..., ControlServer]]:
    """Start a server, which by default repeats the request."""
    with contextlib.ExitStack() as running:

        def serve(handler: Handler = lambda request: {"success": True, "active": [], "asked": request}) -> Any:
            return running.enter_context(contextlib.closing(ControlServer(place, handler)))

        yield serve


def connected(place: Path, sent: bytes = b"") -> socket.socket:
    client = socket.socket(socket.AF_UNIX)
    wait_until(lambda: client.connect_ex(str(place)) == 0, "the connection to be accepted")
    client.settimeout(BOUND)
    client.sendall(sent)
    return client


def test_a_hundred_silent_clients_delay_neither_the_next_client_nor_the_end(place: Path, served: Any) -> None:
    with contextlib.ExitStack() as clients:
        server = served()
        assert place.stat().st_mode & 0o077 == 0
        for number in range(100):
            clients.enter_context(connected(place, b'{"command"'[:number]))
        assert ask(place, {"command": "active"}, BOUND)["asked"] == {"command": "active"}
        began = time.monotonic()
        server.close()
        assert time.monotonic() - began < BOUND
        assert not place.exists()


@pytest.mark.parametrize(
    ("sent", "noun"),
    [
        *((sent, "JSON") for sent in (b"{" * 20000, b"[" * 16000 + b"\n", b"\xff\xfe\n")),
        (b"[1]\n", "unknown command"),
        (b'{"command": "begin", "kind": "board_drop", "amount": 7}\n', "share"),
        (b'{"command": "defect"}\n', "KeyError"),
    ],
    ids=range(6),
)
def test_an_invalid_line_is_refused_and_the_next_one_is_served(
    place: Path, served: Any, sent: bytes, noun: str
) -> None:
    def handler(request: Any) -> dict[str, Any]:
        if request == {"command": "defect"}:
            raise KeyError("kind")
        return answer(faults, request)

    faults = Faults((), None, time.monotonic)  # type: ignore[arg-type]
    served(handler)
    with contextlib.suppress(OSError), connected(place, sent) as client:
        assert noun in json.loads(client.makefile("rb").readline())["error"]
    assert ask(place, {"command": "active"}, BOUND) == {"success": True, "active": []}
