# SPDX-License-Identifier: Apache-2.0
"""The firmware's host programs, built once per run with every warning an error: for this computer with sanitizers, and
for the board's processor, which QEMU emulates."""

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


def make(folder: Path, *arguments: str) -> str:
    """Build the firmware in a folder and return what make printed."""
    command = ["make", "-C", str(FIRMWARE), f"BUILD={folder}", *arguments]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    return built.stdout


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
    make(folder, f"CC={compiler}", "sanitize")
    return folder / "sanitize"


@pytest.fixture(scope="session")
def arm_compiler() -> None:
    """The compiler for the board's processor and its C library."""
    try:
        library = ["arm-none-eabi-gcc", "-mcpu=cortex-m3", "-mthumb", "-print-file-name=rdimon.specs"]
        found = Path(subprocess.run(library, capture_output=True, text=True, check=True).stdout.strip()).exists()
    except FileNotFoundError:
        found = False
    if not found:
        pytest.skip("no arm-none-eabi-gcc with newlib for the board's Cortex-M3: make cross")


@pytest.fixture(scope="session")
def arm_programs(arm_compiler: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of board_host (without --pty), codec and fuzz for the board's processor, each run by QEMU."""
    if shutil.which("qemu-system-arm") is None:
        pytest.skip("no qemu-system-arm that emulates the board's Cortex-M3: make cross")
    folder = tmp_path_factory.mktemp("firmware")
    make(folder, "cortex-m3")
    return folder / "cortex-m3"


ON_THE_BOARD = pytest.param("arm_programs", id="cortex-m3", marks=pytest.mark.rest)


@pytest.fixture(scope="session", params=[pytest.param("programs", id="here"), ON_THE_BOARD])
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
