# SPDX-License-Identifier: Apache-2.0
"""The host program in normal use: BoardLink over its own pseudo-terminal, in real time."""

from __future__ import annotations

import os
import pty
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.board.samples import TactileSample

from ..waiting import wait_until


class Program:
    """`board_host --pty` and a link to it."""

    def __init__(self, program: Path, port: Path, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [program, *arguments, "--pty", str(port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == f"ready {port}\n"
        self.frames: list[TactileSample] = []
        self.boots: list[int] = []
        self.link = BoardLink(
            str(port), on_tactile=self.frames.append, on_boot=lambda: self.boots.append(len(self.frames))
        )

    def command(self, line: str) -> str:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        return self.process.stdout.readline().rstrip("\n")

    def end(self) -> None:
        _, errors = self.process.communicate("quit\n" if self.process.poll() is None else None, timeout=10.0)
        assert self.process.returncode == 0, errors
        assert not errors, errors


@pytest.fixture
def program(programs: Path, tmp_path: Path) -> Iterator[Program]:
    program = Program(programs / "board_host", tmp_path / "board")
    yield program
    program.link.close()
    program.end()
    assert not (tmp_path / "board").is_symlink()


def test_a_reboot_is_detected(program: Program) -> None:
    with program.link as link:
        link.start()
        wait_until(lambda: program.frames)
        assert program.command("boot") == "ok"
        wait_until(lambda: program.boots)
        assert link.counters.reboots == 1


def test_servos_that_are_unplugged_leave_a_silent_bus(programs: Path, tmp_path: Path) -> None:
    """A hung-up port is always readable, which must not keep a processor busy."""
    master, slave = pty.openpty()
    program = Program(programs / "board_host", tmp_path / "board", "--servos", os.ttyname(slave))
    with program.link as link:
        assert link.hello().carries_servos
        os.close(slave)
        os.close(master)
        link.send_to_servos(b"anybody?")
        link.start()
        stat = Path(f"/proc/{program.process.pid}/stat")
        before, began = sum(map(int, stat.read_text().split()[13:15])), time.monotonic()
        wait_until(lambda: len(program.frames) >= 60)
        used = (sum(map(int, stat.read_text().split()[13:15])) - before) / os.sysconf("SC_CLK_TCK")
        assert used < 0.5 * (time.monotonic() - began)
    program.end()


def test_an_unknown_command_is_quoted(program: Program) -> None:
    assert program.command("presss 8") == "error: unknown command: presss 8"
    assert program.command("press x") == "error: unknown command: press x"
    assert program.command("advance 5") == "error: unknown command: advance 5"  # time is real


@pytest.mark.parametrize(
    "arguments", [[], ["--pti"], ["--step", "0", "x"], ["--seed", "--pty"], ["--servos", "x", "--step"]]
)
def test_wrong_usage_prints_the_usage(programs: Path, arguments: list[str]) -> None:
    ended = subprocess.run([programs / "board_host", *arguments], capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert "usage:" in ended.stderr
