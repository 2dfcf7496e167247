# SPDX-License-Identifier: Apache-2.0
"""`deltacharger view --web`: only this computer gets the page and the data, until the command ends."""

from __future__ import annotations

import contextlib
import signal
import socket
import urllib.request
from collections.abc import Callable
from urllib.parse import unquote

import pytest

from ..chargers import Process, new_namespace, wait_until

pytestmark = pytest.mark.ros

pytest.importorskip("rerun", reason="`deltacharger view` needs deltacharger[view]")

Start = Callable[..., Process]


@pytest.fixture
def port() -> int:
    """Return a port that is free together with the next one."""
    for candidate in range(20000, 30000, 2):
        with (
            contextlib.suppress(OSError),
            socket.create_server(("", candidate)),
            socket.create_server(("", candidate + 1)),
        ):
            break
    return candidate


def _serves(port: int, host: str = "127.0.0.1") -> bool:
    with contextlib.suppress(OSError), socket.create_connection((host, port), timeout=5.0):
        return True
    return False


def test_the_page_is_served_only_on_this_computer_until_the_end(
    start: Start, deltacharger: tuple[str, ...], port: int
) -> None:
    process = start(*deltacharger, "view", "--namespace", new_namespace(), "--web", f"127.0.0.1:{port}")
    process.wait_for_line("open http", process.err)
    page = next(line for line in process.err if "open http" in line).split()[-1]
    with urllib.request.urlopen(page, timeout=10.0) as answer:
        assert b"rerun" in answer.read().lower()
    assert unquote(page).endswith(f"127.0.0.1:{port}/?url=rerun+http://127.0.0.1:{port + 1}/proxy")
    assert _serves(port + 1)
    assert not _serves(port, "127.0.0.2")
    assert not _serves(port + 1, "127.0.0.2")
    assert process.end(signal.SIGINT) == 130
    wait_until(lambda: not _serves(port) and not _serves(port + 1), "both ports closed")


@pytest.mark.parametrize("offset", [0, 1])
def test_a_port_in_use_is_reported(start: Start, deltacharger: tuple[str, ...], port: int, offset: int) -> None:
    with socket.create_server(("127.0.0.1", port + offset)):
        process = start(*deltacharger, "view", "--web", f"127.0.0.1:{port}")
        assert process.end() == 1
    assert f"port {port + offset} of 127.0.0.1 cannot be used" in process.err[-1]


@pytest.mark.parametrize("address", ["here", "1.2.3", "127.0.0.1:0", "127.0.0.1:65535", "127.0.0.1:x", ":9090"])
def test_an_invalid_address_is_refused(start: Start, deltacharger: tuple[str, ...], address: str) -> None:
    process = start(*deltacharger, "view", "--web", address)
    assert process.end() == 2
    assert f"'{address}' is not an IP address" in process.err[-1]
