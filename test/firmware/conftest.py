# SPDX-License-Identifier: Apache-2.0
"""The firmware's host programs, built once per run with every warning an error and with sanitizers."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from .bench import Bench
from .board_host import FirmwareBoard

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"


@pytest.fixture(scope="session")
def compiler() -> str:
    """The C compiler that make uses."""
    name = os.environ.get("CC", "cc")
    if shutil.which(name) is None:
        pytest.skip(f"no C compiler: '{name}' is not on the PATH")
    return name


@pytest.fixture(scope="session")
def programs(compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of board_host, codec and fuzz."""
    folder = tmp_path_factory.mktemp("firmware")
    command = ["make", "-C", str(FIRMWARE), f"CC={compiler}", f"BUILD={folder}", "sanitize"]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    return folder / "sanitize"


@pytest.fixture
def firmware_boards(programs: Path) -> Iterator[None]:
    """Let `FirmwareBoard` find its program, and end every board that the test started."""
    FirmwareBoard.program = programs / "board_host"
    FirmwareBoard.started.clear()
    yield
    for board in FirmwareBoard.started:
        board.host.close()


@pytest.fixture
def new_bench(programs: Path) -> Iterator[Callable[..., Bench]]:
    """Make benches that end with the test, each with a healthy end."""
    benches: list[Bench] = []

    def make(start: int = 0, **settings: float) -> Bench:
        benches.append(Bench(programs / "board_host", start, **settings))
        return benches[-1]

    yield make
    for bench in benches:
        bench.close()


@pytest.fixture
def bench(new_bench: Callable[..., Bench]) -> Bench:
    """A board just booted."""
    return new_bench()
