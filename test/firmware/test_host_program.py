# SPDX-License-Identifier: Apache-2.0
"""The host program in normal use: BoardLink over its own pseudo-terminal, in real time."""

from __future__ import annotations

import contextlib
import os
import pty
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.board.protocol import TactileSample

from ..waiting import wait_until

pytestmark = pytest.mark.witness


@contextlib.contextmanager
def running(program: Path, port: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """`board_host --pty`, which leaves no port and no message behind."""
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    process = subprocess.Popen([program / "board_host", *arguments, "--pty", str(port)], text=True, bufsize=1, **pipes)
    assert process.stdout is not None
    assert process.stdout.readline() == f"ready {port}\n"
    yield process
    _, errors = process.communicate("quit\n", timeout=10.0)
    assert (process.returncode, errors) == (0, "")
    assert not port.is_symlink()


def test_servos_that_are_unplugged_leave_a_silent_bus(programs: Path, tmp_path: Path) -> None:
    """A hung-up port is always readable, which must not keep a processor busy."""
    master, slave = pty.openpty()
    frames: list[TactileSample] = []
    with (
        running(programs, tmp_path / "board", "--servos", os.ttyname(slave)) as process,
        BoardLink(str(tmp_path / "board"), on_tactile=frames.append) as link,
    ):
        assert link.hello().carries_servos
        os.close(slave)
        os.close(master)
        link.send_to_servos(b"anybody?")
        link.start()
        stat = Path(f"/proc/{process.pid}/stat")
        before, began = sum(map(int, stat.read_text().split()[13:15])), time.monotonic()
        wait_until(lambda: len(frames) >= 60)
        used = (sum(map(int, stat.read_text().split()[13:15])) - before) / os.sysconf("SC_CLK_TCK")
        assert used < 0.5 * (time.monotonic() - began)
