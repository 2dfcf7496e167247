# SPDX-License-Identifier: Apache-2.0
"""The pictures of the tactile report; each is drawn from the report's own figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_lab.plotting import Axes, note, picture, plain_ticks, top_legend
from deltacharger_lab.reports.tactile.measure import BINS
from deltacharger_lab.reports.tactile.plan import KINDS, TARGETS, kind, title
from deltacharger_records.plotting import BLUE, FAINT, GREEN, INK, ORANGE

COLOURS = {"shallow": ORANGE, "deep": BLUE, "physical": GREEN}
_PAPER = {"angle": ("cnn", 95.46), "vertical": ("cnn", 98.2), "horizontal": ("nn", 87.9)}
_ABOUT = "simulated data; "


def _angle(results: dict[str, Any], path: Path) -> None:
    about = (
        _ABOUT + "above: mean and 95 % interval over rigs; below: one prediction on numpy, median and 99th percentile"
    )
    with picture(path, 9.0, 6.4, "Angle: accuracy and execution time", about) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        _bars(above, results, "angle")
        times = [results["times"][name]["angle"] for name in results["models"]]
        median, slow = (np.array([each[key] for each in times]) for key in ("median_ms", "p99_ms"))
        _labelled_bars(below, results, median, 0.0 * median, slow - median, "%.2f")
        below.axhline(38.0, color=FAINT, linewidth=1.0, linestyle=(0, (4, 3)))
        note(below, "paper's CNN, 38 ms", (-0.3, 38.0), (0, 3), ha="left", color=FAINT)
        below.set(yscale="log", ylim=(0.005, 150.0), ylabel="ms, log scale")
        _legend(figure)


def _position(results: dict[str, Any], path: Path) -> None:
    about = _ABOUT + "mean and 95 % interval over rigs"
    with picture(path, 9.0, 6.4, "Vertical and horizontal: accuracy", about) as figure:
        panels = figure.subplots(2, 1, sharex=True)
        for axes, target in zip(panels, TARGETS[1:], strict=True):
            _bars(axes, results, target)
            axes.set_title(target)
        _legend(figure)


def _bars(axes: Axes, results: dict[str, Any], target: str) -> None:
    found = [results["accuracy"][name][target] for name in results["models"]]
    mean, half = (100.0 * np.array([each[key] for each in found]) for key in ("mean", "half"))
    half = np.nan_to_num(half)  # of a single rig
    _labelled_bars(axes, results, mean, half, np.minimum(half, 100.0 - mean), "%.1f")
    bottom = max(0.0, 10.0 * np.floor(((mean - half).min() - 4.0) / 10.0))
    owner, value = _PAPER[target]
    axes.axhline(value, color=FAINT, linewidth=1.0, linestyle=(0, (4, 3)), zorder=0.8)
    text = f"paper's {title(owner)}, {value:g} %"
    note(axes, text, (1.0, 1.0), (0, 3), xycoords="axes fraction", ha="right", color=FAINT)
    axes.set(ylim=(bottom, 100.0 + 0.08 * (100.0 - bottom)), ylabel="accuracy, %")


def _labelled_bars(axes: Axes, results: dict[str, Any], height: Any, below: Any, above: Any, form: str) -> None:
    """Draw a bar of each model with its height written above, and its interval."""
    names = results["models"]
    colours = [COLOURS[kind(name)] for name in names]
    bars = axes.bar(range(len(names)), height, 0.66, color=colours, yerr=(below, above), ecolor=INK, capsize=3.0)
    axes.bar_label(bars, fmt=form, padding=2.0, fontsize=8.5)
    axes.set_xticks(range(len(names)), [title(name) for name in names])


def _legend(figure: Any) -> None:
    from matplotlib.patches import Patch

    top_legend(figure, [Patch(color=COLOURS[name], label=text) for name, text in KINDS.items()])


def _error_time(results: dict[str, Any], path: Path) -> None:
    about = _ABOUT + "mean error rate over rigs against the median time of one prediction on numpy"
    with picture(path, 11.0, 4.8, "Error against prediction time", about) as figure:
        panels = figure.subplots(1, 3)
        for axes, target in zip(panels, TARGETS, strict=True):
            points = []
            for name in results["models"]:
                time = results["times"][name][target]["median_ms"]
                error = max(100.0 * (1.0 - results["accuracy"][name][target]["mean"]), 0.05)
                axes.plot(time, error, marker="o", markersize=7, color=COLOURS[kind(name)], linestyle="none")
                points.append((time, error, title(name)))
            axes.set(xscale="log", yscale="log", ylim=_reach([error for _, error, _ in points]))
            axes.margins(x=0.22)
            axes.set(title=target, xlabel="ms, log scale")
            plain_ticks(axes)
            axes.xaxis.set_minor_formatter("")  # labels between the decades of a short axis would overlap
            _label_points(figure, axes, points)
        panels[0].set_ylabel("wrong class, %, log scale")
        _legend(figure)


def _reach(values: list[float]) -> tuple[float, float]:
    """Return limits of a logarithmic axis with room around values; zero is drawn as a small value."""
    least = min((value for value in values if value > 0.0), default=0.1)
    return 0.6 * least, 1.7 * max(*values, least)


def _label_points(figure: Any, axes: Axes, points: list[tuple[float, float, str]]) -> None:
    """Name points beside them, each where the fewest labels and points are."""
    from matplotlib.transforms import Bbox

    figure.draw_without_rendering()  # settles the scales
    taken = [Bbox.from_bounds(x - 6, y - 6, 12, 12) for x, y in axes.transData.transform([each[:2] for each in points])]
    directions = ((1, 0), (0, 1), (0, -1), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1))
    for time, error, text in points:
        label = axes.annotate(text, (time, error), (0, 0), textcoords="offset points", ha="center", va="center")
        label.set_in_layout(False)
        half = 0.5 * label.get_window_extent().width * 72.0 / figure.dpi

        def cost(place: tuple[float, float], label: Any = label) -> float:
            label.set_position(place)
            box = label.get_window_extent()
            inside = axes.bbox.contains(*box.min) and axes.bbox.contains(*box.max)
            return float(box.count_overlaps(taken) + 2.0 * (not inside) + 1e-3 * np.hypot(*place))

        places = [(dx * (far + half), dy * far) for far in (8.0, 16.0, 26.0) for dx, dy in directions]
        label.set_position(min(places, key=cost))
        taken.append(label.get_window_extent())


def _shifts(results: dict[str, Any], path: Path) -> None:
    names = results["judged"]
    shifts = list(dict.fromkeys(row["shift"] for row in results["shifts"]))
    table = {(row["model"], row["target"], row["shift"]): row for row in results["shifts"]}
    about = _ABOUT + "coverage in % (nominal 95); grey: holds, blue: drift check fires, orange: NEITHER"
    colours = {"coverage holds": "#eceff2", "drift check fires": "#a9c9f8", "NEITHER": "#f0b45c"}
    width = max(9.0, 2.6 + 0.72 * 3 * len(names))
    with picture(path, width, 6.2, "Coverage and drift check under changes", about) as figure:
        figure.set_layout_engine("none")  # positions are fixed
        axes = figure.add_axes((2.35 / width, 0.03, 1.0 - 2.5 / width, 0.76))
        for column, (target, name) in enumerate((target, name) for target in TARGETS for name in names):
            for line, shift in enumerate(shifts):
                row = table[name, target, shift]
                colour = colours[row["verdict"]]
                axes.fill(
                    [column, column + 0.96, column + 0.96, column], [line, line, line + 0.94, line + 0.94], colour
                )
                axes.text(column + 0.48, line + 0.47, f"{100 * row['coverage']:.0f}", ha="center", va="center")
            axes.text(column + 0.48, -0.3, title(name), ha="center", fontsize=8.5)
        for index, target in enumerate(TARGETS):
            axes.text((index + 0.5) * len(names), -0.95, target, ha="center", fontweight="bold")
        axes.set_yticks([line + 0.47 for line in range(len(shifts))], shifts)
        axes.set(xticks=[], ylim=(len(shifts), -0.1), xlim=(0, 3 * len(names)), facecolor="white")
        axes.tick_params(length=0)
        for side in axes.spines.values():
            side.set_visible(False)


def _reliability(results: dict[str, Any], path: Path) -> None:
    names = results["judged"]
    about = _ABOUT + "unseen dockings of the same rigs; how often the winning class is right, by its probability"
    with picture(path, 10.0, 6.2, "Reliability", about) as figure:
        panels = figure.subplots(2, len(names), sharex=True, sharey="row", squeeze=False, height_ratios=(3, 1))
        for column, name in enumerate(names):
            above, below = panels[:, column]
            above.plot([0, 1], [0, 1], color=FAINT, linewidth=1.0, linestyle=(0, (4, 3)))
            for number, (target, colour) in enumerate(zip(TARGETS, (BLUE, ORANGE, GREEN), strict=True)):
                found = results["diagrams"][name][target]
                count, sure, right = (np.array(found[key], dtype=float) for key in ("count", "sure", "right"))
                used = count >= 10  # fewer are not significant
                above.plot(sure[used] / count[used], right[used] / count[used], "o-", color=colour, markersize=5,
                           linewidth=1.3, label=target)  # fmt: skip
                places = (np.arange(BINS) + 0.25 * (number + 0.5) + 0.125) / BINS
                below.bar(places, np.maximum(count, 0.0), width=0.25 / BINS, color=colour)
            below.set(yscale="log", ylim=(1, None), xlabel="probability of the winner")
            above.set(title=title(name), xlim=(0.15, 1.02), ylim=(0.0, 1.03))
        panels[0, 0].set_ylabel("share that is right")
        panels[1, 0].set_ylabel("frames")
        top_legend(figure, panels[0, 0].get_legend_handles_labels()[0])


def _confusion(results: dict[str, Any], path: Path) -> None:
    names = results["judged"]
    about = _ABOUT + "rows: true class, columns: predicted class, % of the row; unseen dockings of the same rigs"
    ticks = {"angle": [str(each) for each in range(6)]}
    with picture(path, 9.5, 1.2 + 2.55 * len(names), "Confusion", about) as figure:
        panels = figure.subplots(len(names), 3, squeeze=False)
        for line, name in enumerate(names):
            for column, target in enumerate(TARGETS):
                axes = panels[line, column]
                matrix = np.array(results["diagrams"][name][target]["matrix"], dtype=float)
                shares = 100.0 * matrix / np.maximum(matrix.sum(axis=1, keepdims=True), 1.0)
                axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=100.0, aspect="auto")
                for (row, predicted), value in np.ndenumerate(shares):
                    if value >= 0.05:
                        text = f"{value:.0f}" if value >= 9.95 else f"{value:.1f}"
                        axes.text(predicted, row, text, ha="center", va="center", fontsize=8,
                                  color="white" if value > 55 else INK)  # fmt: skip
                words = ticks.get(target, ["−10", "−5", "0", "5", "10"])
                axes.set_xticks(range(len(words)), words)
                axes.set_yticks(range(len(words)), words)
                axes.set_title(f"{title(name)}, {target}, {'°' if target == 'angle' else 'mm'}", fontsize=9.5)
                axes.tick_params(length=0)
                axes.grid(visible=False)


PICTURES = {
    "tactile-angle.png": _angle,
    "tactile-position.png": _position,
    "tactile-error-time.png": _error_time,
    "tactile-shifts.png": _shifts,
    "tactile-reliability.png": _reliability,
    "tactile-confusion.png": _confusion,
}
