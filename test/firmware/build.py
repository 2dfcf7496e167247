# SPDX-License-Identifier: Apache-2.0
"""Builds the firmware once for all processes of a test run, and not again while sources and compiler stay the same."""

import fcntl
import hashlib
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FIRMWARE = ROOT / "firmware"


def make(folder: Path, *arguments: str) -> str:
    """Build the firmware in a folder and return what make printed."""
    command = ["make", "-C", str(FIRMWARE), f"BUILD={folder}", *arguments]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    return built.stdout


def once(name: str, compiler: str, build: Callable[[Path], object]) -> Path:
    """Return the folder of a build; the first process that needs it makes it, and others wait."""
    found = shutil.which(compiler)
    if found is None:
        pytest.skip(f"no compiler: '{compiler}' is not on the PATH")
    digest = hashlib.sha256(f"{found} {os.stat(found).st_mtime_ns}".encode())
    for path in sorted((*FIRMWARE.rglob("*"), *Path(__file__).parent.glob("*.cpp"))):
        if path.is_file() and not path.is_relative_to(FIRMWARE / "build"):
            digest.update(path.name.encode() + path.read_bytes())
    folder = ROOT / "build" / "firmware" / f"{name}-{digest.hexdigest()[:16]}"
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "built").exists():
            build(folder)
            (folder / "built").touch()
    return folder


def host_programs() -> Path:
    """Return the folder of board_host, codec and fuzz, with sanitizers."""
    compiler = os.environ.get("CC", "cc")
    return once("here", compiler, lambda folder: make(folder, f"CC={compiler}", "sanitize")) / "sanitize"
