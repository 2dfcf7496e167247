# SPDX-License-Identifier: Apache-2.0
"""Every reader refuses a bad file by name or returns a valid value, within 2 s and 200 MB more memory.

benchmarks/fuzz_files.py defines the readers, their good files and valid values. This file and benchmarks/files_fuzz.py
change good files at random, and replace them by typical mistakes and attacks.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from ..marks import rest

for needed in ("cv2", "mcap", "pyarrow"):
    pytest.importorskip(needed, reason="reads with the extras vision, record and campaign")

ROOT = Path(__file__).resolve().parents[2]
FUZZ = ROOT / "benchmarks" / "files_fuzz.py"
KINDS = ("yaml", "csv", "npz", "npy", "picture", "mcap", "json", "parquet")


def run(*words: object) -> dict[str, Any]:
    """Run it in separate processes, to measure memory from the start and to report crashes."""
    command = [sys.executable, str(FUZZ), "--json", "--processes", "1", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=590)
    assert done.stdout, done.stderr[-3000:]
    result: dict[str, Any] = json.loads(done.stdout)
    return result


@pytest.mark.timeout(600)
@pytest.mark.parametrize(("files", "first"), [(200, 0), rest(10_000, 1_000_000)])
@pytest.mark.parametrize("kind", KINDS)
def test_changed_files_are_refused_by_name_or_valid(kind: str, files: int, first: int) -> None:
    result = run("--kind", kind, "--files", files, "--first", first)[kind]
    assert not result["broken"], "\n".join(result["broken"])
    assert result["files"] == files
    assert min(result["taken"], result["refused"]) > 0, result


@pytest.mark.parametrize("kind", KINDS)
def test_attacks_on_every_reader_are_refused_by_name(kind: str) -> None:
    result = run("--kind", kind, "--attacks")[kind]
    assert not result["broken"], "\n".join(result["broken"])
    assert result["refused"] >= 6, result
