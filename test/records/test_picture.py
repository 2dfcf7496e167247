# SPDX-License-Identifier: Apache-2.0
"""The picture of a run: drawn from any recorded data, however few, and never a reason to fail."""

from __future__ import annotations

import itertools
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from deltacharger_records import plotting
from deltacharger_records.replay.run_picture import PictureError, draw, headline
from deltacharger_records.replay.run_record import Run, Series
from deltacharger_ros.outcomes import Outcome

DETAILS = {"charge_current": 5.0, "energy": 109.0, "contact_current": 0.45, "contact_force": 17.2, "alignments": 1}


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
    run.outcome = Outcome("dock", True, 0, "NONE", "", False, 2.9, DETAILS | {"misalignment": {"angle": 0.034}})
    return run


@pytest.mark.rest
@pytest.mark.parametrize("kind", ["full", "refused at once"])
def test_it_is_drawn_from_any_data(kind: str, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="pictures need deltacharger[picture]")
    run = full_run() if kind == "full" else Run()
    if kind == "full":
        run.seen = np.zeros((40, 64, 3), dtype=np.uint8)
    else:
        run.outcome = Outcome("dock", False, 301, "UNREACHABLE", "stand 100 mm closer " * 20, True, 0.0)
    path = tmp_path / "dock.png"
    draw(run, path)
    assert (path.read_bytes()[:4], path.stat().st_size > 10_000) == (b"\x89PNG", True)
    for place in (tmp_path / "no" / "such" / "folder.png", tmp_path / "dock.xyz"):
        with pytest.raises(PictureError, match=place.name):
            draw(Run(), place)


@pytest.mark.parametrize(("energy", "title"), [(109.0, "Docked and charging"), (0.0, "Docked"), (math.nan, "Docked")])
def test_only_a_measured_charge_is_in_the_title(energy: float, title: str) -> None:
    run = full_run()
    assert run.outcome is not None
    run.outcome = replace(run.outcome, error_message="power: none", details=DETAILS | {"energy": energy})
    assert headline(run) == (title, "power: none")


def test_without_matplotlib_the_message_states_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(PictureError, match=r"deltacharger\[picture\]"):
        draw(Run(), tmp_path / "dock.png")


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


COLOURS = {name: getattr(plotting, name) for name in ("FAINT", "BLUE", "ORANGE", "GREEN", "PURPLE", "RED")}
SIGHTS = {
    "full": np.eye(3),
    "without red": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "without green": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "without blue": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
"""Linear RGB as each kind of eye sees it (Machado, Oliveira and Fernandes 2009, severity 1)."""
_TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])  # sRGB, D65
_WHITE = _TO_XYZ.sum(axis=1)


def _linear(colour: str) -> NDArray[np.float64]:
    values = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)]) / 255.0
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _lab(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return L*a*b* (CIE 1976)."""
    ratio = _TO_XYZ @ np.clip(linear, 0.0, 1.0) / _WHITE
    x, y, z = np.where(ratio > 0.008856, np.cbrt(ratio), 7.787 * ratio + 16.0 / 116.0)
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


@pytest.mark.parametrize("sight", SIGHTS)
def test_every_eye_distinguishes_the_colours_on_paper(sight: str) -> None:
    seen = {name: _lab(np.array(SIGHTS[sight]) @ _linear(colour)) for name, colour in COLOURS.items()}
    apart = {pair: np.linalg.norm(seen[pair[0]] - seen[pair[1]]) for pair in itertools.combinations(seen, 2)}
    assert min(apart.values()) >= 25.0, apart  # 2.3 is just noticeable
    luminance = {name: (_TO_XYZ @ _linear(colour))[1] for name, colour in COLOURS.items()}
    assert 1.05 / (max(luminance.values()) + 0.05) >= 2.5, luminance  # contrast on white (WCAG)
