# SPDX-License-Identifier: Apache-2.0
"""The host program as anybody would run it: BoardLink over its own pseudo-terminal, in real time."""

from __future__ import annotations

import math
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from deltacharger_driver.board.errors import CommandRefused
from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.board.protocol import BoardFault
from deltacharger_driver.board.samples import PowerSample, TactileSample
from deltacharger_driver.errors import PortGone

from ..waiting import wait_until

pytestmark = pytest.mark.realtime


class Program:
    """`board_host --pty` and a link to it."""

    def __init__(self, program: Path, port: Path) -> None:
        self.process = subprocess.Popen(
            [program, "--pty", str(port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == f"ready {port}\n"
        self.frames: list[TactileSample] = []
        self.powers: list[PowerSample] = []
        self.boots: list[int] = []
        self.link = BoardLink(
            str(port),
            on_tactile=self.frames.append,
            on_power=self.powers.append,
            on_boot=lambda: self.boots.append(len(self.frames)),
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


def twenty_in_a_row(program: Program) -> bool:
    lost, count = program.link.counters.lost_tactile, len(program.frames)
    wait_until(lambda: len(program.frames) >= count + 20)
    return program.link.counters.lost_tactile == lost


def test_the_driver_from_hello_to_a_lost_heartbeat(program: Program) -> None:
    with program.link as link:
        hello = link.hello()
        assert (hello.major, hello.rows, hello.columns, hello.rate) == (1, 10, 10, 120.0)
        assert link.ping() < 0.2
        link.tare()
        link.set_rate(200.0)
        link.start()
        assert program.command("press 8") == "ok"
        wait_until(lambda: len(program.frames) > 50 and program.frames[-1].pads[0].sum() > 5.0)
        assert program.frames[-1].tared
        result = link.probe()
        assert (result.resistance, result.target_voltage) == (2.0, 24.0)
        with pytest.raises(CommandRefused, match="heartbeat"):
            link.contactor(True)
        link.keep_alive(math.inf)
        link.contactor(True)
        wait_until(lambda: program.powers[-1].power.charge_current == pytest.approx(1.0))
        assert program.powers[-1].power.contactor_closed
        link.stop_heartbeat()
        wait_until(lambda: program.powers[-1].power.fault == BoardFault.HEARTBEAT_LOST)
        assert not program.powers[-1].power.contactor_closed
        link.contactor(False)
        wait_until(lambda: program.powers[-1].power.fault == 0)
        assert link.decoder_counters.damaged == 0
        wait_until(lambda: twenty_in_a_row(program), "frames without a gap, which a busy host may leave")


def test_a_second_host_finds_the_board_as_the_first_left_it(program: Program) -> None:
    with program.link as link:
        first = link.hello()
        link.tare()
    time.sleep(0.3)  # nobody listens: the terminal's buffer may fill, the board goes on
    with program.link as link:
        assert link.hello() == first
        link.start()
        wait_until(lambda: len(program.frames) > 5)
    assert program.frames[-1].tared
    assert program.boots == []


def test_a_reboot_is_noticed(program: Program) -> None:
    with program.link as link:
        link.start()
        wait_until(lambda: program.frames)
        assert program.command("boot") == "ok"
        wait_until(lambda: program.boots)
        assert link.counters.reboots == 1


def test_the_program_that_ends_is_a_port_gone(program: Program) -> None:
    with program.link as link:
        program.end()
        with pytest.raises(PortGone):
            link.probe()


def test_a_command_it_does_not_know_is_named(program: Program) -> None:
    assert program.command("presss 8") == "error: not understood: presss 8"
    assert program.command("press x") == "error: not understood: press x"
    assert program.command("advance 5") == "error: not understood: advance 5"  # time passes by itself


@pytest.mark.parametrize("arguments", [[], ["--pti"], ["--step", "0", "x"], ["--seed", "--pty"]])
def test_wrong_usage_says_how(programs: Path, arguments: list[str]) -> None:
    ended = subprocess.run([programs / "board_host", *arguments], capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert "usage:" in ended.stderr
