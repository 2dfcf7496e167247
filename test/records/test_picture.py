# SPDX-License-Identifier: Apache-2.0
"""The picture of a run: drawn from any recorded data, however few, and never a reason to fail."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deltacharger_records.replay.run_picture import PictureError, draw, headline
from deltacharger_records.replay.run_record import Run, Series
from deltacharger_ros.outcomes import Outcome

PNG = b"\x89PNG"
DETAILS = {
    "charge_current": 5.0,
    "energy": 109.0,
    "contact_current": 0.45,
    "contact_force": 17.2,
    "alignments": 1,
    "misalignment": {"horizontal": 3e-4, "vertical": -7e-4, "angle": 0.034},
}


def full_run() -> Run:
    run = Run(phases=[(0.0, "idle"), (0.1, "approach"), (1.0, "contact"), (2.0, "measure"), (2.1, "energise")])
    for time in np.arange(0.0, 3.0, 0.01):
        run.motion.add(time, 0.08 * min(time, 1.0), 17.0 * (time > 1.5), 0.45 * (time > 1.5))
        run.contact.add(time, 0.45 * (time > 1.5))
        run.power.add(time, 5.0 * (time > 2.2), float(time > 2.1))
        run.misalignment.add(time, *((1e-3, -1e-3, 0.03) if time > 2.0 else (math.nan,) * 3))
    run.decided.add(2.1, 1e-3, -1e-3, 0.03)
    frame = np.zeros((10, 10))
    frame[4:6] = 2.0
    frame[0, 0] = math.nan
    run.frames = (frame, frame)
    run.outcome = Outcome("dock", True, 0, "NONE", "", False, 2.9, DETAILS)
    return run


def seeing_run() -> Run:
    run = full_run()
    run.seen = np.zeros((40, 64, 3), dtype=np.uint8)
    return run


def failed_run() -> Run:
    run = Run()
    run.outcome = Outcome("dock", False, 301, "UNREACHABLE", "stand 100 mm closer " * 20, True, 0.0)
    return run


@pytest.mark.parametrize(
    "run",
    [full_run(), seeing_run(), failed_run(), Run()],
    ids=["full", "with a camera", "refused at once", "nothing at all"],
)
def test_it_is_drawn(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="pictures need deltacharger[report]")
    path = tmp_path / "dock.png"
    draw(run, path)
    assert path.read_bytes()[:4] == PNG
    assert path.stat().st_size > 10_000


@pytest.mark.parametrize(("energy", "title"), [(109.0, "Docked and charging"), (0.0, "Docked"), (math.nan, "Docked")])
def test_only_a_measured_charge_is_in_the_title(energy: float, title: str) -> None:
    run = full_run()
    assert run.outcome is not None
    run.outcome = replace(run.outcome, error_message="power: none", details=DETAILS | {"energy": energy})
    assert headline(run) == (title, "power: none")


def test_an_unwritable_path_is_reported(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="pictures need deltacharger[report]")
    with pytest.raises(PictureError, match="cannot write"):
        draw(Run(), tmp_path / "no" / "such" / "folder.png")
    with pytest.raises(PictureError, match="cannot write"):
        draw(Run(), tmp_path / "dock.xyz")


def test_without_matplotlib_the_message_states_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(PictureError, match=r"deltacharger\[report\]"):
        draw(Run(), tmp_path / "dock.png")


def test_a_series_stays_bounded_and_keeps_its_span() -> None:
    series = Series("value")
    count = 200_000
    for index in range(count):
        series.add(float(index), 2.0 * index)
    arrays = series.arrays()
    assert len(arrays["time"]) < 25_000
    assert arrays["time"][0] < 0.001 * count
    assert arrays["time"][-1] > 0.999 * count
    assert np.all(arrays["value"] == 2.0 * arrays["time"])
    assert np.all(np.diff(arrays["time"]) > 0.0)
    assert series.last("value") == arrays["value"][-1]
