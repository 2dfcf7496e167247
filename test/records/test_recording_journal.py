# SPDX-License-Identifier: Apache-2.0
"""Contents of a recording's journal, refused requests, and the data set made from it; no charger."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mcap", reason="records with deltacharger[record]")

from deltacharger_core.mcap_file import RecordingError
from deltacharger_records.datasets.dataset import Docking, Settings
from deltacharger_records.datasets.journal import Journal, Mismatch
from deltacharger_records.datasets.plan import Part
from deltacharger_tactile.dataset import Dataset

PART = Part("reference", 0.0, 10, 0, 0.0, 0.0, 80.0)
SETTINGS = Settings(rig=1, sensor="", frames=1, rows=2, threshold=0.5, dwell_s=0.5, simulated=False)


def docking(attempt: int) -> Docking:
    frames = np.full((2, 2, 10, 10), 0.4, dtype=np.float32)
    frames[0, 0, 3, 4], frames[:, 1, 0, 0] = 2.0, np.nan
    return Docking(attempt, 0, PART.name, attempt, 0.0, 0.0, 0.0, 1e-4, -2e-4, 0.45, 1.8e9, frames)


def test_a_data_set_is_composed_from_the_journal_and_can_be_composed_again(tmp_path: Path) -> None:
    out = tmp_path / "F.npz"
    with Journal(out) as journal:
        assert journal.compose() is None
        for attempt in range(3):
            journal.store(docking(attempt), PART, SETTINGS, {}, [])
        assert (journal.next_attempt, journal.next_session) == (3, 1)
        journal.compose()
    first = Dataset.load(out)
    assert list(first.attempt) == [0, 0, 1, 1, 2, 2]
    assert first.left[0, 3, 4] == 2.0
    assert first.left.sum() == 6.0  # readings below the threshold are 0
    assert first.dead[:, 1, 0, 0].all()
    assert first.dead.sum() == 6
    assert first.poses()[0] == pytest.approx((1e-4, -2e-4, 0.0))
    assert first.meta["simulated"] is False
    out.unlink()
    with Journal(out) as journal:
        journal.compose()
    again = Dataset.load(out)
    assert all(np.array_equal(getattr(first, name), getattr(again, name), equal_nan=True) for name in ("left", "dead"))
    assert first.meta == again.meta


def test_a_folder_accepts_one_process_at_a_time_and_no_other_settings(tmp_path: Path) -> None:
    out = tmp_path / "F.npz"
    with Journal(out) as journal:
        journal.store(docking(0), PART, SETTINGS, {}, [])
        with pytest.raises(Mismatch, match="another process"):
            Journal(out)
    with Journal(out) as journal:
        journal.check(PART, dataclasses.replace(SETTINGS, simulated=None))
        with pytest.raises(Mismatch, match=r"that is real \(not simulated\)"):
            journal.check(PART, dataclasses.replace(SETTINGS, simulated=True))
        with pytest.raises(Mismatch, match=r"--z-mm 80\.0 \(not 75\.0\)"):
            journal.check(dataclasses.replace(PART, z_mm=75.0), SETTINGS)
        journal.check(dataclasses.replace(PART, set="angle", z_mm=75.0), SETTINGS)
    path, header = (tmp_path / "F.recording" / name for name in ("docking-000000.mcap", "recording.json"))
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(RecordingError, match=path.name):
        Journal(out)
    for content, noun in ((json.dumps(json.loads(header.read_text()) | {"version": 0}), "version 0"), ("{", "damaged")):
        header.write_text(content)
        with pytest.raises(RecordingError, match=rf"recording\.json.*{noun}"):
            Journal(out)
