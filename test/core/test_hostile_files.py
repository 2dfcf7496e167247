# SPDX-License-Identifier: Apache-2.0
"""Whatever stands where a file should: a named refusal or a sound value, in 2 s and 200 MB more, by every reader.

What readers there are, their good files and what is sound stands in benchmarks/fuzz_files.py; here and in
benchmarks/files_fuzz.py these are changed at random, and replaced by what people and programs do to each other.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from ..marks import slow

for needed in ("cv2", "mcap", "pyarrow"):
    pytest.importorskip(needed, reason="reads with the extras vision, record and campaign")

ROOT = Path(__file__).resolve().parents[2]
FUZZ = ROOT / "benchmarks" / "files_fuzz.py"
KINDS = ("yaml", "csv", "npz", "npy", "picture", "mcap", "json", "parquet")


def run(*words: object) -> dict[str, Any]:
    """Run it in processes of its own, so that memory is measured from the beginning and a crash is told."""
    command = [sys.executable, str(FUZZ), "--json", "--processes", "1", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=590)
    assert done.stdout, done.stderr[-3000:]
    told: dict[str, Any] = json.loads(done.stdout)
    return told


@pytest.mark.timeout(600)
@pytest.mark.parametrize(("files", "first"), [(200, 0), slow(10_000, 1_000_000)])
@pytest.mark.parametrize("kind", KINDS)
def test_changed_files_are_refused_by_name_or_sound(kind: str, files: int, first: int) -> None:
    told = run("--kind", kind, "--files", files, "--first", first)[kind]
    assert not told["broken"], "\n".join(told["broken"])
    assert told["files"] == files
    assert min(told["taken"], told["refused"]) > 0, told


@pytest.mark.parametrize("kind", KINDS)
def test_attacks_on_every_reader_are_refused_by_name(kind: str) -> None:
    told = run("--kind", kind, "--attacks")[kind]
    assert not told["broken"], "\n".join(told["broken"])
    assert told["refused"] >= 6, told
