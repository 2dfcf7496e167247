# SPDX-License-Identifier: Apache-2.0
"""Dependencies of the core, and its behaviour under a million random bytes."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from deltacharger_core import machine
from deltacharger_driver.board import protocol

from .conftest import FIRMWARE

CORE = FIRMWARE / "deltacharger_board" / "src"
SOURCES = sorted(CORE.glob("*.c"))
ALLOWED_HEADERS = {"stdbool.h", "stddef.h", "stdint.h", "string.h"}
ALLOWED_FUNCTIONS = {"memchr", "memcpy", "memmove", "memset"}


@pytest.mark.parametrize("path", [*SOURCES, *sorted(CORE.glob("*.h"))], ids=lambda path: path.name)
def test_the_core_includes_no_hardware_and_no_operating_system(path: Path) -> None:
    assert set(re.findall(r"#include <(.*)>", path.read_text())) <= ALLOWED_HEADERS


def test_the_core_calls_nothing_but_memory_functions(compiler: str, tmp_path: Path) -> None:
    if shutil.which("nm") is None:
        pytest.skip("no nm to list what the objects call")
    subprocess.run([compiler, "-std=c99", "-O1", "-c", *SOURCES], cwd=tmp_path, check=True)
    objects = sorted(tmp_path.glob("*.o"))
    listing = subprocess.run(["nm", *objects], capture_output=True, text=True, check=True).stdout
    defined = set(re.findall(r" [TDBR] (\w+)", listing))
    called = set(re.findall(r" U (\w+)", listing)) - defined
    assert {name for name in called if not name.startswith("__")} <= ALLOWED_FUNCTIONS
    # Every byte of state is in the caller's dc_board: two boards can share a processor.
    assert not re.findall(r" [bBdDC] (\w+)", listing)


def test_firmware_and_host_have_the_same_constants() -> None:
    text = "".join(path.read_text() for path in CORE.glob("*.h"))
    written = {name: float(value) for name, value in re.findall(r"#define DC_(\w+) ([\d.]+)[uf]?\b", text)}
    host = vars(protocol) | vars(machine)
    shared = {name: value for name, value in written.items() if name in host}
    assert shared == {name: host[name] for name in shared}
    assert shared.keys() >= {"ROWS", "COLUMNS", "CONTACT_FORCE", "FULL_SCALE", "DEFAULT_RATE", "SHORT_RESISTANCE"}
    micros = {name.removesuffix("_US"): value * 1e-6 for name, value in written.items() if name.endswith("_US")}
    for name in ("HEARTBEAT_TIMEOUT", "PROBE_LIFETIME", "PROBE_TIMEOUT"):
        assert micros[name] == pytest.approx(host[name])


def test_every_header_compiles_alone_in_c_and_in_cpp(compiler: str, tmp_path: Path) -> None:
    modes = [(compiler, "c", "-std=c99")]
    if shutil.which("c++"):
        modes.append(("c++", "c++", "-std=c++11"))
    for header in CORE.glob("*.h"):
        for program, language, standard in modes:
            command = [program, standard, "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only", f"-I{CORE}"]
            text = f'#include "{header.name}"\n#include "{header.name}"\n'
            subprocess.run([*command, "-x", language, "-"], input=text, text=True, check=True, cwd=tmp_path)


def test_fuzzing_finds_nothing(programs: Path) -> None:
    accepted, closes = (int(number) for number in re.findall(r"(\d+) (?:accepted|closes)", fuzz(programs, 200_000)))
    assert accepted > 20_000
    assert closes > 500


@pytest.mark.rest
def test_fuzzing_finds_the_same_on_the_boards_processor(programs: Path, arm_programs: Path) -> None:
    assert fuzz(arm_programs, 50_000) == fuzz(programs, 50_000)


def fuzz(folder: Path, packets: int) -> str:
    """Send damaged packets and return the findings."""
    ended = subprocess.run([folder / "fuzz", str(packets), "11"], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr == ""
    return ended.stdout
