# SPDX-License-Identifier: Apache-2.0
"""Dependencies of the core, and its behaviour under a million random bytes."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from deltacharger_core import machine
from deltacharger_driver.board import protocol

from ..marks import night
from .build import FIRMWARE, once

CORE = FIRMWARE / "deltacharger_board" / "src"
COMPILER = os.environ.get("CC", "cc")
ALLOWED_HEADERS = {"stdbool.h", "stddef.h", "stdint.h", "string.h"}
ALLOWED_FUNCTIONS = {"memchr", "memcpy", "memmove", "memset"}


def test_the_core_includes_no_hardware_and_calls_nothing_but_memory_functions() -> None:
    for path in CORE.glob("*.[ch]"):
        assert set(re.findall(r"#include <(.*)>", path.read_text())) <= ALLOWED_HEADERS, path.name
    if shutil.which("nm") is None:
        pytest.skip("no nm to list what the objects call")
    command = [COMPILER, "-std=c99", "-O1", "-c", *CORE.glob("*.c")]
    folder = once("objects", COMPILER, lambda folder: subprocess.run(command, cwd=folder, check=True))
    listing = subprocess.check_output(["nm", *folder.glob("*.o")], text=True)
    called = set(re.findall(r" U (\w+)", listing)) - set(re.findall(r" [TDBR] (\w+)", listing))
    assert {name for name in called if not name.startswith("__")} <= ALLOWED_FUNCTIONS
    # Every byte of state is in the caller's dc_board: two boards can share a processor.
    assert not re.findall(r" [bBdDC] (\w+)", listing)


def test_firmware_and_host_have_the_same_constants() -> None:
    text = "".join(path.read_text() for path in CORE.glob("*.h"))
    written = {name: float(value) for name, value in re.findall(r"#define DC_(\w+) ([\d.]+)[uf]?\b", text)}
    host = vars(protocol) | vars(machine)
    shared = {name: value for name, value in written.items() if name in host}
    assert shared == {name: host[name] for name in shared}
    assert shared.keys() >= {"ROWS", "COLUMNS", "CONTACT_FORCE", "FULL_SCALE", "DEFAULT_RATE", "MINOR", "SERVO_MINOR"}
    assert shared.keys() >= {"SHORT_RESISTANCE", "LIVE_VOLTAGE"}
    for name in ("HEARTBEAT_TIMEOUT", "PROBE_LIFETIME", "PROBE_TIMEOUT"):
        assert 1e-6 * written[f"{name}_US"] == pytest.approx(host[name])


@pytest.mark.parametrize("packets", [20_000, night(1_000_000)])
def test_fuzzing_finds_nothing(programs: Path, packets: int) -> None:
    accepted, closes = (int(number) for number in re.findall(r"(\d+) (?:accepted|closes)", fuzz(programs, packets)))
    assert accepted > packets / 10
    assert closes > packets / 400


def fuzz(folder: Path, packets: int) -> str:
    """Send damaged packets and return the findings."""
    ended = subprocess.run([folder / "fuzz", str(packets), "11"], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
    return ended.stdout
