# SPDX-License-Identifier: Apache-2.0
"""The pictures of the tactile report; each is drawn from the report's own figures."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deltacharger_lab.reports.tactile.measure import BINS
from deltacharger_lab.reports.tactile.plan import KINDS, TARGETS, kind, title
from deltacharger_records.plotting import BLUE, FAINT, GREEN, INK, ORANGE, PAPER, grid, picture, plain_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ANGLE, POSITION = "tactile-angle.png", "tactile-position.png"
ERROR_TIME, RELIABILITY, CONFUSION = "tactile-error-time.png", "tactile-reliability.png", "tactile-confusion.png"
SHIFTS = "tactile-shifts.png"
NAMES = (ANGLE, POSITION, ERROR_TIME, SHIFTS, RELIABILITY, CONFUSION)
COLOURS = {"shallow": ORANGE, "deep": BLUE, "physical": GREEN}
_PAPER = {"angle": ("cnn", 95.46), "vertical": ("cnn", 98.2), "horizontal": ("nn", 87.9)}
_ABOUT = "simulated data; "


def jobs(results: dict[str, Any]) -> dict[str, Callable[[Path], None]]:
    """Return what draws each picture."""
    draw = (_angle, _position, _error_time, _shifts, _reliability, _confusion)
    return {name: partial(each, results) for name, each in zip(NAMES, draw, strict=True)}


def _angle(results: dict[str, Any], path: Path) -> None:
    about = (
        _ABOUT + "above: mean and 95 % interval over rigs; below: one prediction on numpy, median and 99th percentile"
    )
    with picture(path, 9.0, 6.4, "Angle: accuracy and execution time", about) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        figure.subplots_adjust(left=0.09, right=0.97, top=0.83, bottom=0.08, hspace=0.12)
        _bars(above, results, "angle")
        names = results["models"]
        for index, name in enumerate(names):
            times = results["times"][name]["angle"]
            below.bar(index, times["median_ms"], color=COLOURS[kind(name)], width=0.66)
            below.plot([index] * 2, [times["median_ms"], times["p99_ms"]], color=INK, linewidth=1.2, marker="_")
            text = f"{times['median_ms']:.2f}"
            below.annotate(
                text, (index, times["p99_ms"]), xytext=(0, 4), textcoords="offset points", ha="center", fontsize=8.5
            )
        below.axhline(38.0, color=FAINT, linewidth=1.0, linestyle=(0, (4, 3)))
        below.annotate("paper's CNN, 38 ms", (0.01, 38.0), xycoords=("axes fraction", "data"), xytext=(0, 3),
                       textcoords="offset points", fontsize=8.5, color=FAINT)  # fmt: skip
        below.set(yscale="log", ylim=(0.005, 150.0), ylabel="ms, log scale")
        _name_axis(below, names)
        grid(below, both=False)
        _legend(figure)


def _position(results: dict[str, Any], path: Path) -> None:
    about = _ABOUT + "mean and 95 % interval over rigs"
    with picture(path, 9.0, 6.4, "Vertical and horizontal: accuracy", about) as figure:
        panels = figure.subplots(2, 1, sharex=True)
        figure.subplots_adjust(left=0.09, right=0.97, top=0.83, bottom=0.08, hspace=0.2)
        for axes, target in zip(panels, TARGETS[1:], strict=True):
            _bars(axes, results, target)
            axes.set_title(target, loc="left", pad=4)
        _name_axis(panels[1], results["models"])
        _legend(figure)


def _bars(axes: Axes, results: dict[str, Any], target: str) -> None:
    names = results["models"]
    low = 100.0
    for index, name in enumerate(names):
        mean, half = (100.0 * results["accuracy"][name][target][key] for key in ("mean", "half"))
        axes.bar(index, mean, color=COLOURS[kind(name)], width=0.66)
        top = mean
        if np.isfinite(half):
            axes.plot([index] * 2, [mean - half, min(mean + half, 100.0)], color=INK, linewidth=1.2, marker="_")
            top = min(mean + half, 100.0)
        axes.annotate(
            f"{mean:.1f}", (index, top), xytext=(0, 5), textcoords="offset points", ha="center", fontsize=8.5,
            bbox={"facecolor": PAPER, "edgecolor": "none", "pad": 0.8},
        )  # fmt: skip
        low = min(low, mean - (half if np.isfinite(half) else 0.0))
    bottom = max(0.0, 10.0 * np.floor((low - 4.0) / 10.0))
    owner, value = _PAPER[target]
    axes.axhline(value, color=FAINT, linewidth=1.0, linestyle=(0, (4, 3)), zorder=0.8)
    axes.annotate(f"paper's {title(owner)}, {value:g} %", (1.0, 1.0), xycoords="axes fraction", xytext=(0, 3),
                  textcoords="offset points", ha="right", fontsize=8.5, color=FAINT)  # fmt: skip
    axes.set(ylim=(bottom, 100.0 + 0.08 * (100.0 - bottom)), ylabel="accuracy, %")
    grid(axes, both=False)


def _name_axis(axes: Axes, names: list[str]) -> None:
    axes.set_xticks(range(len(names)), [title(name) for name in names])
    axes.set_xlim(-0.6, len(names) - 0.4)


def _legend(figure: Any) -> None:
    from matplotlib.patches import Patch

    handles = [Patch(color=COLOURS[name], label=text) for name, text in KINDS.items()]
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.985, 0.995), ncols=3, frameon=False, fontsize=9)


def _error_time(results: dict[str, Any], path: Path) -> None:
    about = _ABOUT + "mean error rate over rigs against the median time of one prediction on numpy"
    with picture(path, 11.0, 4.8, "Error against prediction time", about) as figure:
        panels = figure.subplots(1, 3)
        figure.subplots_adjust(left=0.07, right=0.98, top=0.76, bottom=0.12, wspace=0.2)
        for axes, target in zip(panels, TARGETS, strict=True):
            points = []
            for name in results["models"]:
                time = results["times"][name][target]["median_ms"]
                error = max(100.0 * (1.0 - results["accuracy"][name][target]["mean"]), 0.05)
                axes.plot(time, error, marker="o", markersize=7, color=COLOURS[kind(name)], linestyle="none")
                points.append((time, error, title(name)))
            axes.set(xscale="log", yscale="log", ylim=_reach([error for _, error, _ in points]))
            axes.margins(x=0.22)
            axes.set_title(target, pad=6)
            axes.set_xlabel("ms, log scale")
            plain_ticks(axes)
            _label_points(figure, axes, points)
            grid(axes)
        panels[0].set_ylabel("wrong class, %, log scale")
        _legend(figure)


def _reach(values: list[float]) -> tuple[float, float]:
    """Return limits of a logarithmic axis that leave room around values; none at all count as little."""
    least = min((value for value in values if value > 0.0), default=0.1)
    return 0.6 * least, 1.7 * max(*values, least)


def _label_points(figure: Figure, axes: Axes, points: list[tuple[float, float, str]]) -> None:
    """Name points beside them, each where the fewest labels and points are."""
    figure.draw_without_rendering()  # settles the scales
    places = axes.transData.transform([(time, error) for time, error, _ in points])
    scale = axes.figure.dpi / 72.0
    taken = [(x - 6, y - 6, x + 6, y + 6) for x, y in places]
    inside = axes.get_window_extent()
    for (x, y), (time, error, text) in zip(places, points, strict=True):
        width, height = 5.6 * scale * len(text), 12.0 * scale
        best: tuple[float, tuple[float, float], tuple[float, float, float, float]] | None = None
        for far in (8.0, 16.0, 26.0):
            for dx, dy in ((1, 0), (0, 1), (0, -1), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)):
                left = x + scale * far * dx - width * (0.5 * (1 - dx))
                low = y + scale * far * dy - height * 0.5
                box = (left, low, left + width, low + height)
                hits = sum(_meet(box, other) for other in taken)
                beyond = box[0] < inside.x0 or box[2] > inside.x1 or box[1] < inside.y0 or box[3] > inside.y1
                cost = 10.0 * hits + 20.0 * beyond + 0.1 * far
                if best is None or cost < best[0]:
                    best = (cost, ((left - x) / scale, (low - y) / scale), box)
        assert best is not None
        taken.append(best[2])
        axes.annotate(text, (time, error), xytext=best[1], textcoords="offset points", fontsize=8.5, va="bottom")


def _meet(one: tuple[float, ...], two: tuple[float, ...]) -> bool:
    return one[0] < two[2] and two[0] < one[2] and one[1] < two[3] and two[1] < one[3]


def _shifts(results: dict[str, Any], path: Path) -> None:
    names = results["judged"]
    shifts = list(dict.fromkeys(row["shift"] for row in results["shifts"]))
    table = {(row["model"], row["target"], row["shift"]): row for row in results["shifts"]}
    about = _ABOUT + "coverage in % (nominal 95); green: holds, blue: drift check fires, orange: NEITHER"
    colours = {"coverage holds": "#cfe8d8", "drift check fires": "#cfe0f0", "NEITHER": "#f3c9a5"}
    width = max(9.0, 2.6 + 0.72 * 3 * len(names))
    with picture(path, width, 6.2, "What is noticed when something changes", about) as figure:
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
        figure.subplots_adjust(left=0.08, right=0.98, top=0.81, bottom=0.10, wspace=0.1, hspace=0.1)
        for column, name in enumerate(names):
            above, below = panels[:, column]
            above.plot([0, 1], [0, 1], color=FAINT, linewidth=1.0, linestyle=(0, (4, 3)))
            for number, (target, colour) in enumerate(zip(TARGETS, (BLUE, ORANGE, GREEN), strict=True)):
                found = results["diagrams"][name][target]
                count, sure, right = (np.array(found[key], dtype=float) for key in ("count", "sure", "right"))
                used = count >= 10  # fewer tell nothing
                above.plot(sure[used] / count[used], right[used] / count[used], "o-", color=colour, markersize=5,
                           linewidth=1.3, label=target)  # fmt: skip
                places = (np.arange(BINS) + 0.25 * (number + 0.5) + 0.125) / BINS
                below.bar(places, np.maximum(count, 0.0), width=0.25 / BINS, color=colour)
            above.set_title(title(name), pad=5)
            below.set(yscale="log", ylim=(1, None), xlabel="probability of the winner")
            above.set(xlim=(0.15, 1.02), ylim=(0.0, 1.03))
            grid(above)
            grid(below, both=False)
        panels[0, 0].set_ylabel("share that is right")
        panels[1, 0].set_ylabel("frames")
        handles, texts = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, texts, loc="upper right", bbox_to_anchor=(0.98, 0.995), ncols=3, frameon=False)


def _confusion(results: dict[str, Any], path: Path) -> None:
    names = results["judged"]
    about = _ABOUT + "rows: true class, columns: class told, % of the row; unseen dockings of the same rigs"
    ticks = {"angle": [str(each) for each in range(6)]}
    with picture(path, 9.5, 1.2 + 2.55 * len(names), "Confusion", about) as figure:
        panels = figure.subplots(len(names), 3, squeeze=False)
        height = 1.2 + 2.55 * len(names)
        figure.subplots_adjust(left=0.09, right=0.98, top=1.0 - 1.15 / height, bottom=0.35 / height, hspace=0.28)
        for line, name in enumerate(names):
            for column, target in enumerate(TARGETS):
                axes = panels[line, column]
                matrix = np.array(results["diagrams"][name][target]["matrix"], dtype=float)
                shares = 100.0 * matrix / np.maximum(matrix.sum(axis=1, keepdims=True), 1.0)
                axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=100.0, aspect="auto")
                for (row, told), value in np.ndenumerate(shares):
                    if value >= 0.05:
                        text = f"{value:.0f}" if value >= 9.95 else f"{value:.1f}"
                        axes.text(told, row, text, ha="center", va="center", fontsize=8,
                                  color="white" if value > 55 else INK)  # fmt: skip
                words = ticks.get(target, ["−10", "−5", "0", "5", "10"])
                axes.set_xticks(range(len(words)), words)
                axes.set_yticks(range(len(words)), words)
                unit = "°" if target == "angle" else "mm"
                axes.set_title(f"{title(name)}, {target}, {unit}", pad=4, fontsize=9.5)
                axes.tick_params(length=0)
