# SPDX-License-Identifier: Apache-2.0
"""The pictures of the kinematics report; each is drawn from the report's own figures."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_lab.plotting import Axes, note, picture
from deltacharger_lab.reports.kinematics.workspace import draw_condition, draw_force
from deltacharger_records.plotting import BLUE, FAINT, GREEN, INK, ORANGE, PURPLE, RED

_COLOURS = {"ours": BLUE, "form": ORANGE, "peer": PURPLE}
_MARKERS = {"ours": "oD^*", "form": "vPXs<>", "peer": "hpds^"}
_FLOOR = 1e-17  # rad; an error of zero is drawn here
_PANELS = {"interior": "workspace box", "boundary": "edge of reach", "fold": "one limb folded"}


def _error_time(results: dict[str, Any], path: Path) -> None:
    about = "largest angle error against 60 digits; filled: in an array of 10 000, hollow: one call at a time"
    with picture(path, 13.0, 5.6, "Inverse kinematics: error against run time", about) as figure:
        panels = figure.subplots(1, len(_PANELS), sharey=True, sharex=True)
        for axes, (name, title) in zip(panels, _PANELS.items(), strict=True):
            _scatter(axes, results["inverse"], name)
            axes.set(title=title, xlabel="µs per pose", xscale="log", yscale="log")
        panels[0].set(ylabel="largest error, rad", ylim=(1e-17, 10.0))
        markers = _markers(results["inverse"])
        for row in results["inverse"]:
            marker, colour = markers[row["name"]], _COLOURS[row["family"]]
            panels[0].plot([], [], marker, color=colour, markersize=7, label=row["name"])
        figure.legend(loc="outside right center", labelspacing=0.75)


def _scatter(axes: Axes, rows: list[dict[str, Any]], name: str) -> None:
    markers = _markers(rows)
    for row in rows:
        error = row["sets"][name]["max"]
        if not np.isfinite(error):
            continue
        marker, colour = markers[row["name"]], _COLOURS[row["family"]]
        level = max(error, _FLOOR)
        cost = row["times"][name]
        times = {face: cost[key] for face, key in ((colour, "array_us"), ("white", "one_us")) if cost[key] is not None}
        axes.plot(list(times.values()), [level] * len(times), color=colour, linewidth=0.8, alpha=0.5, zorder=2)
        for face, time in times.items():
            axes.plot(
                time, level, marker=marker, markersize=11 if marker == "*" else 7, color=colour, markerfacecolor=face,
                alpha=0.9, linestyle="none", zorder=4 if row["family"] == "ours" else 3,
            )  # fmt: skip


def _markers(rows: list[dict[str, Any]]) -> dict[str, str]:
    """Return the marker of each row's name: the next one of its family."""
    left = {family: itertools.cycle(markers) for family, markers in _MARKERS.items()}
    return {row["name"]: next(left[row["family"]]) for row in rows}


def _edge(results: dict[str, Any], path: Path) -> None:
    decades, markers = results["edge"]["decades"], _markers(results["inverse"])
    about = "largest angle error of points whose exact distance to the edge lies within a factor of ten"
    with picture(path, 13.0, 5.2, "Inverse kinematics toward the edge of reach", about) as figure:
        axes = figure.subplots()
        for row in results["inverse"]:
            curve = [np.nan if each is None else max(each, _FLOOR) for each in results["edge"]["curves"][row["name"]]]
            axes.plot(
                decades, curve, marker=markers[row["name"]], markersize=5, linewidth=1.3, color=_COLOURS[row["family"]],
                alpha=0.85, label=row["name"], zorder=4 if row["family"] == "ours" else 3,
            )  # fmt: skip
        axes.set(xscale="log", yscale="log", ylim=(1e-17, 1e-3), ylabel="largest error, rad")
        axes.set_xlabel("distance to the edge of reach, m (lower end of the decade)")
        figure.legend(loc="outside right center", labelspacing=0.75)


def _speed(results: dict[str, Any], path: Path) -> None:
    about = "one process, process time; full solves give angles, status and margin"
    with picture(path, 13.0, 4.8, "Poses per second by the size of the array", about) as figure:
        axes = figure.subplots()
        colours = (BLUE, PURPLE, RED, ORANGE, GREEN, FAINT)
        for (name, row), colour, marker in zip(results["speed"].items(), colours, "oDsv^P", strict=False):
            axes.plot(
                [int(size) for size in row], list(row.values()), marker=marker, markersize=5, linewidth=1.5,
                color=colour, label=name, linestyle="dashed" if colour == RED else "solid",
            )  # fmt: skip
        axes.axhline(3e6, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
        note(axes, "wanted: 3 million", (1.0, 3e6), (2, 3), ha="left")
        axes.set(xscale="log", yscale="log", xlabel="points in one call", ylabel="poses per second")
        figure.legend(loc="outside right center", labelspacing=0.9)


PICTURES = {
    "kinematics-error-time.png": _error_time,
    "kinematics-edge.png": _edge,
    "kinematics-speed.png": _speed,
    "kinematics-condition.png": draw_condition,
    "kinematics-force.png": draw_force,
}
