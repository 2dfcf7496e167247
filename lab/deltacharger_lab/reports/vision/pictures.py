# SPDX-License-Identifier: Apache-2.0
"""The diagrams of the vision report, drawn from its own figures, and which pictures there are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_lab.plotting import note, picture, plain_ticks, top_legend
from deltacharger_lab.reports.vision import gallery
from deltacharger_lab.reports.vision.conditions import BAND, BY_RANGE, DEFECTS, HIDDEN, SIZE, key, members
from deltacharger_records.plotting import BLUE, FAINT, ORANGE, RED

_ABOUT = "simulated images; "
_ERRORS = {
    "xy_mm": ("across the line of sight", "mm", 0.5),
    "z_mm": ("along the optical axis", "mm", 2.0),
    "roll_deg": ("roll", "°", 1.0),
}
"""Title, unit and target of the 95 % error of each."""


def _range(results: dict[str, Any], path: Path) -> None:
    about = _ABOUT + "640 × 400 px, exact intrinsics; no depth below 0.174 m; the target is for the 95 %"
    rows = [(each.away, results["rows"][key(each)]) for each in members(BY_RANGE)]
    with picture(path, 11.0, 4.6, "Error against range", about) as figure:
        panels = figure.subplots(1, 3)
        for axes, (name, (title, unit, target)) in zip(panels, _ERRORS.items(), strict=True):
            away = [each for each, _ in rows]
            for share, colour, text in ((95, ORANGE, "95 %"), (50, BLUE, "median")):
                values = [row[f"{name}_p{share}"] for _, row in rows]
                axes.plot(away, values, "o-", color=colour, linewidth=1.6, markersize=4.5, label=text)
            axes.plot(BAND, [target] * 2, color=RED, linewidth=1.3, linestyle=(0, (4, 3)), label="target")
            axes.set_yscale("log")
            plain_ticks(axes)
            axes.set(title=f"{title}, {unit}", xlabel="range, m", xlim=(0.1, 1.05))
        top_legend(figure, panels[0].get_legend_handles_labels()[0])


def _found(results: dict[str, Any], path: Path) -> None:
    rows = [each for group in (DEFECTS, HIDDEN) for each in members(group) if key(each) in results["rows"]]
    about = _ABOUT + "0.2–0.8 m, hidden bars 0.2–0.6 m; share of images in which the electrodes were found"
    figures = [results["rows"][key(each)] for each in rows]
    found, wrong = (np.array([100.0 * each[name] / each["images"] for each in figures]) for name in ("found", "wrong"))
    with picture(path, 9.0, 1.15 + 0.225 * len(rows), "Found share under each defect", about) as figure:
        axes, lines = figure.subplots(), range(len(rows))
        whole = axes.barh(lines, 100.0, 0.7, color="#e4e8ec")
        axes.barh(lines, found, 0.7, color=BLUE)
        axes.barh(lines, wrong, 0.7, left=found, color=RED)
        axes.bar_label(whole, [f"{each:.1f}" for each in found], padding=3.0, fontsize=8.5)
        axes.set_yticks(lines, [each.name for each in rows])
        axes.set(ylim=(len(rows) - 0.4, -0.6), xlim=(0.0, 106.0), xlabel="found, %; red: wrong")
        axes.tick_params(axis="y", length=0)


def _error_time(results: dict[str, Any], path: Path) -> None:
    about = _ABOUT + "0.15–0.8 m, three sizes of the image; processor time of one core, median"
    with picture(path, 9.0, 4.4, "Error against run time", about) as figure:
        panels = figure.subplots(1, 2)
        for axes, name in zip(panels, ("xy_mm", "z_mm"), strict=True):
            title, unit, target = _ERRORS[name]
            for number, each in enumerate(members(SIZE)):
                row, time = results["rows"][key(each)], results["times"][key(each)]["median_ms"]
                low, high = row[f"{name}_p50"], row[f"{name}_p95"]
                axes.plot([time] * 2, [low, high], color=FAINT, linewidth=1.4, zorder=2)
                axes.plot(time, low, "o", color=BLUE, markersize=7, zorder=3, label="median")
                axes.plot(time, high, "o", color=ORANGE, markersize=7, zorder=3, label="95 %")
                # Above the first and the last, below the middle one: they are close together.
                place, shift = (low, -16) if number == 1 else (high, 8)
                note(axes, each.name, (time, place), (0, shift))
            axes.axhline(target, color=RED, linewidth=1.3, linestyle=(0, (4, 3)), label="targets")
            axes.axvline(15.0, color=RED, linewidth=1.3, linestyle=(0, (1, 2)))
            axes.set(yscale="log", xscale="log")
            axes.margins(x=0.3, y=0.14)
            plain_ticks(axes)
            axes.set_xticks([5, 10, 15, 20, 30, 50], ["5", "10", "15", "20", "30", "50"])
            axes.xaxis.minorticks_off()
            axes.set(title=f"{title}, {unit}", xlabel="ms a frame, log scale")
        top_legend(figure, panels[0].get_legend_handles_labels()[0][-3:])


PICTURES = {
    "vision-range.png": _range,
    "vision-found.png": _found,
    "vision-error-time.png": _error_time,
    "vision-renderers.png": gallery.renderers,
    "vision-obstructed.png": gallery.obstructed,
    "vision-gallery.png": gallery.hard,
}
