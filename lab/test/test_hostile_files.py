# SPDX-License-Identifier: Apache-2.0
"""Every reader refuses a bad file by name or returns a valid value, within 2 s and 200 MB more memory.

lab/benchmarks/fuzz_files.py defines the readers, their good files and valid values. At night files_fuzz.py beside it
changes thousands of good files at random, and replaces them by typical mistakes and attacks.
"""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from test.marks import night, rest

FUZZ = Path(__file__).resolve().parents[1] / "benchmarks" / "files_fuzz.py"
KINDS = ("yaml", "csv", "npz", "npy", "picture", "mcap", "json", "parquet")
EXTRAS = {
    "npy": {"cv2": "vision"},
    "picture": {"cv2": "vision"},
    "mcap": {"mcap": "record"},
    "json": {"mcap": "record"},
}


@pytest.fixture(autouse=True)
def needed(kind: str) -> None:
    """Skip a kind whose library is not installed."""
    for library, extra in EXTRAS.get(kind, {}).items():
        pytest.importorskip(library, reason=f"reads with the extra {extra}")


@pytest.mark.parametrize("kind", [*(kind for kind in KINDS if kind != "npz"), rest("npz")])
def test_hostile_files_are_refused_by_name(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Longer than memory, nothing, noise, pickled, and changed good ones."""
    monkeypatch.syspath_prepend(FUZZ.parent)
    from files_fuzz import MEGABYTES, peak, reset_peak
    from fuzz_files import readers
    from fuzz_mutations import mutated

    (tmp_path / "good").mkdir()
    for reader in readers(tmp_path / "good", kind):
        place = tmp_path / reader.name / reader.place
        place.parent.mkdir(parents=True)
        for name, content in reader.beside.items():
            (tmp_path / reader.name / name).write_bytes(content)
        hostile = [None, os.urandom(500), pickle.dumps({"x": print})]
        reset_peak()
        before = peak()
        for content in (
            *hostile,
            b"",
            *(mutated(f"{kind} {number}", reader.good, reader.changes) for number in range(3)),
        ):
            place.write_bytes(content or b"")
            if content is None:
                os.truncate(place, 2**40)
            try:
                reader.sound(reader.read(place))
            except reader.refusals as refusal:
                message = str(refusal)
            else:
                assert content not in hostile, reader.name
                continue
            assert not reader.names or place.name in message or str(place.parent) in message
        assert peak() - before < MEGABYTES, reader.name


@pytest.mark.timeout(600)
@pytest.mark.parametrize("words", [rest("--attacks"), night("--files=10000")])
@pytest.mark.parametrize("kind", [*(kind for kind in KINDS if kind != "npz"), night("npz")])
def test_many_changed_files_and_attacks_are_refused_by_name(kind: str, words: str) -> None:
    """In separate processes, to measure memory from the start and to report crashes."""
    command = [sys.executable, str(FUZZ), "--json", "--processes", "1", "--kind", kind, words]
    done = subprocess.run(command, capture_output=True, text=True, cwd=FUZZ.parents[2], timeout=590)
    assert done.stdout, done.stderr[-3000:]
    result: dict[str, Any] = json.loads(done.stdout)[kind]
    assert not result["broken"], "\n".join(result["broken"])
    assert result["refused"] >= 6, result
