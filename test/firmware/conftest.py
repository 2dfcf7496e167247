# SPDX-License-Identifier: Apache-2.0
"""The firmware's host programs: for this computer with sanitizers, and at night for the board's processor, which QEMU
emulates."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from ..marks import night
from .bench import Bench
from .board_host import FirmwareBoard
from .build import host_programs, make, once


@pytest.fixture(scope="session")
def programs() -> Path:
    """The folder of board_host, codec and fuzz."""
    return host_programs()


@pytest.fixture(scope="session")
def arm_compiler() -> str:
    """The compiler for the board's processor, with its C library."""
    name = "arm-none-eabi-gcc"
    library = [name, "-mcpu=cortex-m3", "-mthumb", "-print-file-name=rdimon.specs"]
    if not shutil.which(name) or not Path(subprocess.check_output(library, text=True).strip()).exists():
        pytest.skip("no arm-none-eabi-gcc with newlib for the board's Cortex-M3: make cross")
    return name


@pytest.fixture(scope="session")
def arm_programs(arm_compiler: str) -> Path:
    """The folder of board_host (without --pty), codec and fuzz for the board's processor, each run by QEMU."""
    if shutil.which("qemu-system-arm") is None:
        pytest.skip("no qemu-system-arm that emulates the board's Cortex-M3: make cross")
    return once("cortex-m3", arm_compiler, lambda folder: make(folder, "cortex-m3")) / "cortex-m3"


@pytest.fixture(scope="session", params=["programs", night("arm_programs")], ids=["here", "cortex-m3"])
def core(request: pytest.FixtureRequest) -> Path:
    """The folder of board_host, codec and fuzz: the core on this computer's processor, then on the board's."""
    return request.getfixturevalue(request.param)


@pytest.fixture
def firmware_boards(core: Path) -> Iterator[None]:
    """Set the program of `FirmwareBoard`, and end every board that the test started."""
    FirmwareBoard.program = core / "board_host"
    FirmwareBoard.started.clear()
    yield
    for board in FirmwareBoard.started:
        board.host.close()


@pytest.fixture
def new_bench(core: Path) -> Iterator[Callable[..., Bench]]:
    """Make benches that are ended and checked after the test."""
    benches: list[Bench] = []

    def make(start: int = 0, **settings: float) -> Bench:
        benches.append(Bench(core / "board_host", start, **settings))
        return benches[-1]

    yield make
    for bench in benches:
        bench.close()


@pytest.fixture
def bench(new_bench: Callable[..., Bench]) -> Bench:
    """A board just booted."""
    return new_bench()
