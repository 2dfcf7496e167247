# SPDX-License-Identifier: Apache-2.0
"""Images of the vision report with the detections drawn in."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_lab.plotting import Axes, picture
from deltacharger_lab.reports.vision.conditions import (
    CONDITIONS,
    MUJOCO,
    OBSTRUCTED,
    RAYS,
    RENDERERS,
    key,
    members,
)
from deltacharger_lab.reports.vision.measure import Photographer, Sample, errors
from deltacharger_records.plotting import BLUE, INK, RED
from deltacharger_vision.detector.annotate import annotated
from deltacharger_vision.detector.detector import ElectrodeDetector
from deltacharger_vision.projection import project

_HARD = (
    "range: 0.15 m",
    "range: 1.00 m",
    "defects: exposure × 0.1",
    "defects: exposure × 4",
    "defects: highlight 8",
    "defects: holes: 90 % of metal, 50 % else",
    "defects: defocus 2.5 px",
    "defects: motion 8 px",
    "hidden: 75 % of one bar hidden",
    "hidden: 15 % of both bars hidden",
    "defects: drawn room, decoys",
    "alarms: clutter, no electrodes",
)
_COLUMNS = 4
_AROUND = 2.4  # shown size, in lengths of the bars
_ASPECT = 1.6


def renderers(results: dict[str, Any], path: Path) -> None:
    """Write one scene by each renderer that works here, with the detection."""
    names = (f"{RENDERERS}: drawn room, decoys, {renderer}" for renderer in (RAYS, MUJOCO))
    shown = [CONDITIONS[name] for name in names if name in results["rows"]]
    width, height = 0.3 + 5.6 * len(shown), 1.2 + 3.5
    about = "simulated images; the same scene and the same defects; green: detection"
    title = "Both renderers" if len(shown) > 1 else shown[0].renderer
    detector, closing = ElectrodeDetector(), contextlib.closing(Photographer())
    with closing as photographer, picture(path, width, height, title, about) as figure:
        panels = figure.subplots(1, len(shown), squeeze=False)[0]
        for axes, condition in zip(panels, shown, strict=True):
            sample = photographer.take(condition, results["first_seed"])
            axes.imshow(annotated(sample.image, detector.detect(sample.image)), interpolation="antialiased")
            axes.set_title(condition.renderer)
            axes.axis("off")


def hard(results: dict[str, Any], path: Path) -> None:
    """Write the worst of the measured images of many kinds, the part around the terminal."""
    images = results["raw"]["images"]
    names = [name for name in _HARD if name in images]
    lines = -(-len(names) // _COLUMNS)
    width, height = 12.4, 0.95 + 2.15 * lines
    about = "simulated images: of each row one that was missed, or the one with the largest error; blue: detection"
    detector, closing = ElectrodeDetector(), contextlib.closing(Photographer())
    with closing as photographer, picture(path, width, height, "Hard images", about) as figure:
        panels = figure.subplots(lines, _COLUMNS, squeeze=False)
        for axes in panels.flat:
            axes.axis("off")
        for axes, name in zip(panels.flat, names, strict=False):
            _one(axes, name, photographer.take(CONDITIONS[name], worst(images[name], CONDITIONS[name].real)), detector)


def obstructed(results: dict[str, Any], path: Path) -> None:
    """Write some images of each kind of obstruction, the part around the terminal: the first that were measured."""
    names = [name for name in (key(each) for each in members(OBSTRUCTED)) if name in results["rows"]]
    names = [name for name in names if CONDITIONS[name].renderer == RAYS]
    lines, first = len(names), results["first_seed"]
    about = "simulated images, the first of each kind; blue: detection"
    title = "Something before the bars"
    detector, closing = ElectrodeDetector(), contextlib.closing(Photographer())
    with closing as photographer, picture(path, 12.4, 0.95 + 2.15 * lines, title, about) as figure:
        panels = figure.subplots(lines, _COLUMNS, squeeze=False)
        for row, name in zip(panels, names, strict=True):
            for axes, seed in zip(row, range(first, first + _COLUMNS), strict=True):
                axes.axis("off")
                _one(axes, name, photographer.take(CONDITIONS[name], seed), detector)


def worst(images: list[list[float]], real: bool) -> int:
    """Return the seed of a wrong detection, else of a missed terminal, else of the largest error in (N, FIELDS)."""
    table = np.array(images, dtype=float)
    error = np.nan_to_num(np.hypot(table[:, 3], table[:, 4]))
    missed = (table[:, 1] == 0.0) if real else np.zeros(len(table))
    return int(table[np.argmax(error + 1e3 * missed + 1e6 * table[:, 2]), 0])


def _one(axes: Axes, name: str, sample: Sample, detector: ElectrodeDetector) -> None:
    condition, image = CONDITIONS[name], sample.image
    found = detector.detect(image)
    axes.imshow(image.color, interpolation="nearest")
    text, colour = "nothing found", INK
    if found is not None:
        for bar in found.bars:
            axes.plot(*np.vstack([bar, bar[:1]]).T, color=BLUE, linewidth=1.3)
        _, wrong, across, away, *_ = errors(found, sample.view.pose, condition.real)
        text, colour = ("wrong", RED) if wrong else (f"off by {np.hypot(across, away):.2f} mm", BLUE)
    axes.set_title(condition.name, fontsize=9.0)
    axes.text(0.985, 0.03, text, transform=axes.transAxes, ha="right", va="bottom", fontsize=9.0, color=colour,
              bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.5, "alpha": 0.85})  # fmt: skip
    if condition.real:
        _around(axes, sample)


def _around(axes: Axes, sample: Sample) -> None:
    """Show the part of the image around the terminal."""
    of, pose, terminal = sample.image.intrinsics, sample.view.pose, sample.view.scene.terminal
    x, y = project(pose[:3, 3], of)
    half = min(
        0.5 * _AROUND * of.fx * terminal.bar_length / pose[2, 3], 0.5 * (of.width - 1), 0.5 * _ASPECT * (of.height - 1)
    )
    x = float(np.clip(x, half - 0.5, of.width - 0.5 - half))
    y = float(np.clip(y, half / _ASPECT - 0.5, of.height - 0.5 - half / _ASPECT))
    axes.set(xlim=(x - half, x + half), ylim=(y + half / _ASPECT, y - half / _ASPECT))
