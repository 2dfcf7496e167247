# SPDX-License-Identifier: Apache-2.0
"""The picture of a docking: drawn from any data, however few, and never a reason to fail."""

import math
from pathlib import Path

import numpy as np
import pytest

from deltacharger_bringup.records.replay.picture import PictureError, draw
from deltacharger_bringup.records.replay.run import Phase, Run, Series, Touch
from deltacharger_core.ros.outcomes import Outcome
from deltacharger_docking import clearance, codes


def outcome(code: codes.Code = codes.Code.NONE, message: str = "") -> Outcome:
    return Outcome("dock", code == codes.Code.NONE, int(code), code.name, message, False, 2.9)


def hours() -> Run:
    """Return a run of hours, without curves and with measurements of nothing."""
    run = Run(phases=[Phase("measure", 0.0, 3.0), Phase("charging", 3.0, 9000.0)], charged=8997.0, end=9000.0)
    known, unknown = clearance.MisalignmentEstimate(*[1e-3] * 6), clearance.MisalignmentEstimate(*[math.nan] * 6)
    frame = np.zeros((10, 10))
    frame[0, 0] = math.nan
    run.touches = [Touch(number, each, number, (frame, frame)) for number, each in enumerate([known, unknown] * 3, 1)]
    run.results = [outcome()]
    return run


@pytest.mark.rest
@pytest.mark.parametrize("run", [Run(), Run(results=[outcome(codes.Code.UNREACHABLE, "stand closer " * 40)]), hours()])
def test_it_is_drawn_from_any_data(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="pictures need deltacharger[picture]")
    path = tmp_path / "dock.png"
    draw(run, path, "a subject " * 30)
    assert (path.read_bytes()[:4], path.stat().st_size > 10_000) == (b"\x89PNG", True)
    for place in (tmp_path / "no" / "such" / "folder.png", tmp_path / "dock.xyz"):
        with pytest.raises(PictureError, match=place.name):
            draw(run, place)


def test_a_series_stays_bounded_and_keeps_its_span() -> None:
    series = Series("value")
    count = 50_000
    for index in range(count):
        series.add(float(index), 2.0 * index)
    arrays = series.arrays()
    assert len(arrays["time"]) < 25_000
    assert arrays["time"][0] < 0.001 * count
    assert arrays["time"][-1] > 0.999 * count
    assert np.all(arrays["value"] == 2.0 * arrays["time"])
    assert np.all(np.diff(arrays["time"]) > 0.0)
    assert series.last("value") == arrays["value"][-1]
