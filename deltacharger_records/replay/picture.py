# SPDX-License-Identifier: Apache-2.0
"""Picture of a recorded docking: motion, forces, measurements, decisions, currents and the outcome."""

from __future__ import annotations

import math
import textwrap
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deltacharger_docking.clearance import CLEARANCE_SIGMAS, clearance, clearance_stddev
from deltacharger_records.plotting import BLUE, FAINT, GREEN, ORANGE, RED
from deltacharger_records.quantities import in_unit
from deltacharger_records.replay.record import Replay
from deltacharger_records.replay.run_picture import (
    MISALIGNMENT,
    charge,
    contact_current,
    height,
    legend,
    name_phases,
    pad_map,
    save,
    scale_bar,
    shade,
)
from deltacharger_records.replay.run_record import Touch
from deltacharger_records.replay.time_scale import TimeScale, scale_for
from deltacharger_records.replay.words import why

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MAPS = 4  # measurements whose tactile frames are shown
_MARKED = {
    "contact": ("contact", FAINT),
    "overshoot": ("overshoot", ORANGE),
    "move": ("move", BLUE),
    "elsewhere": ("look elsewhere", ORANGE),
    "again": ("once more", ORANGE),
    "aligned": ("aligned", GREEN),
    "exhausted": ("no move left", RED),
    "refused": ("refused", RED),
    "close": ("close", GREEN),
    "charging": ("charging", GREEN),
    "unsafe": ("unsafe", RED),
    "full": ("full", FAINT),
    "interrupted": ("interrupted", RED),
    "open": ("open", FAINT),
    "stuck": ("stuck", RED),
}
"""Decisions that get a label, and its colour; the others are ticks only."""


def draw(replay: Replay, path: Path) -> None:
    """Write the picture of a recorded docking; the suffix decides the format.

    Raises:
        PictureError: matplotlib is missing, or the file cannot be written.
    """
    save(path, 9.6, 9.0, lambda figure: _compose(figure, replay))


def _compose(figure: Figure, replay: Replay) -> None:
    grid = figure.add_gridspec(
        6, 2, width_ratios=(3.2, 1.0), height_ratios=(0.5, 1.3, 1.15, 1.3, 1.0, 0.9),
        left=0.07, right=0.955, top=0.872, bottom=0.165, hspace=0.13, wspace=0.13,
    )  # fmt: skip
    scale = scale_for(replay)
    first = figure.add_subplot(grid[0, 0])
    rows = [first, *(figure.add_subplot(grid[index, 0], sharex=first) for index in range(1, 6))]
    for axes in rows:
        shade(axes, replay.run, scale.span)
    _decisions(rows[0], replay, scale)
    height(rows[1], replay.run)
    contact_current(rows[2], replay.run)
    _misalignment(rows[3], replay, scale)
    _clearance(rows[4], replay)
    charge(rows[5], replay.run)
    for axes in rows:
        axes.grid(axis="y", color="white", linewidth=1.0, zorder=0.5)
        axes.yaxis.set_label_coords(-0.062, 0.5)
        axes.tick_params(labelbottom=axes is rows[-1], length=3)
    scale.apply(rows)
    rows[-1].set_xlabel("time since the docking began, s", labelpad=2)
    name_phases(first, replay.run, scale.span, scale.forward)
    _maps(figure, grid[:, 1], replay)
    _title(figure, replay)
    _closing(figure, replay)


def _decisions(axes: Axes, replay: Replay, scale: TimeScale) -> None:
    """Mark every decision, and label the important ones if there is room."""
    axes.set_ylim(0.0, 1.0)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_ylabel("decided")
    free = [scale.forward(scale.span[0])] * 3
    width = scale.width
    for decision in replay.run.decisions:
        text, colour = _MARKED.get(decision.kind, ("", "#b3bdc8"))
        axes.axvline(decision.time, ymin=0.0, ymax=0.18, color=colour, linewidth=1.4 if text else 0.8)
        place = scale.forward(decision.time)
        level = next((level for level in range(3) if text and free[level] <= place), None)
        if level is None:
            continue
        axes.text(decision.time, 0.2 + 0.27 * level, f" {text}", fontsize=7, color=colour, va="bottom", clip_on=True)
        free[level] = place + (len(text) + 2) * 0.0062 * width


def _misalignment(axes: Axes, replay: Replay, scale: TimeScale) -> None:
    """Draw each measurement with its standard deviation; hollow = unsure."""
    axes.axhline(0.0, color="#9aa5b1", linewidth=0.8)
    touches, shown = replay.run.touches, list[tuple[float, float]]()
    for offset, (name, colour, factor, label) in enumerate(MISALIGNMENT):
        times = [scale.beside(touch.time, (offset - 1) * 0.004) for touch in touches]
        values = [factor * getattr(touch, name) for touch in touches]
        spread = [factor * getattr(touch, f"{name}_stddev") for touch in touches]
        shown += [(value - stddev, value + stddev) for value, stddev in zip(values, spread, strict=True)]
        axes.plot(times, values, color=colour, linewidth=0.9, alpha=0.5)
        axes.errorbar(times, values, yerr=spread, fmt="none", ecolor=colour, elinewidth=1.2, capsize=2.5)
        faces = [colour if touch.sure else "white" for touch in touches]
        axes.scatter(times, values, s=20, c=faces, edgecolors=colour, linewidths=1.2, zorder=3, label=label)
    ends = [end for values in shown for end in values if math.isfinite(end)]
    low, high = min([*ends, -1.0]), max([*ends, 1.0])
    axes.set_ylim(low - 0.12 * (high - low), high + 0.5 * (high - low))  # room for the legend
    legend(axes)
    axes.set_ylabel("misalign-\nment ± σ")


def _clearance(axes: Axes, replay: Replay) -> None:
    """Draw each measurement's clearance, less CLEARANCE_SIGMAS standard deviations, against the needed one."""
    needed = 1e3 * replay.parameters.clearance_min
    places = [(touch.time, *_left(touch, replay)) for touch in replay.run.touches]
    places = [place for place in places if math.isfinite(place[2])]
    for when, left, worst in places:
        colour = GREEN if worst >= needed else RED
        axes.plot([when, when], [left, worst], color=colour, linewidth=3.0, solid_capstyle="butt", alpha=0.55)
        axes.plot([when], [left], "o", color=colour, markersize=4.5)
    axes.axhline(needed, color=RED, linewidth=1.0, linestyle=(0, (4, 3)))
    values = [value for place in places for value in place[1:]]
    low, high = min([*values, 0.0]) - 0.8, max([*values, 4.0]) + 0.8
    axes.set_ylim(low, high)
    axes.axhspan(low, needed, color=RED, alpha=0.07, linewidth=0)
    axes.annotate(
        f"{needed:.1f} mm\nneeded", (1.0, needed), xycoords=("axes fraction", "data"), xytext=(4, 0),
        textcoords="offset points", va="center", fontsize=7, color=RED, annotation_clip=False,
    )  # fmt: skip
    axes.set_ylabel(f"clearance\nto {CLEARANCE_SIGMAS:g}σ, mm")


def _left(touch: Touch, replay: Replay) -> tuple[float, float]:
    """Return the clearance of a measurement, and that value less CLEARANCE_SIGMAS standard deviations, mm."""
    gap, length = replay.parameters.electrode_half_gap, replay.parameters.electrode_half_length
    pose = touch.estimate
    left = clearance(pose.angle, pose.across, gap, length)
    return 1e3 * left, 1e3 * (left - CLEARANCE_SIGMAS * clearance_stddev(pose, gap, length))


def _maps(figure: Figure, place: Any, replay: Replay) -> None:
    """Show the pads' forces at the measurements, seen along +z: +x to the left, +y up."""
    maps = [touch for touch in replay.run.touches if touch.frames is not None]
    shown = maps if len(maps) <= _MAPS else [maps[round(i * (len(maps) - 1) / (_MAPS - 1))] for i in range(_MAPS)]
    rows = place.subgridspec(_MAPS, 2, hspace=0.42, wspace=0.08)
    if not shown:
        axes = figure.add_subplot(rows[0, :])
        axes.set_axis_off()
        axes.text(0.5, 0.5, "nothing was measured by touch", ha="center", va="center", color=FAINT)
        return
    top = max(2.0, *(float(np.nanmax(pad)) for touch in shown for pad in touch.frames or ()))
    image: Any = None
    axes_of_maps = []
    for row, touch in enumerate(shown):
        assert touch.frames is not None
        for column, frame in enumerate(touch.frames):
            axes = figure.add_subplot(rows[row, column])
            image = pad_map(axes, frame, top)
            axes_of_maps.append(axes)
            if column == 0:
                axes.set_title(_caption(touch), loc="left", pad=4, fontsize=8.2)
            if row == 0 and column == 0:
                axes.set_ylabel("↑ +y", rotation=0, loc="top", labelpad=8, fontsize=7, color=FAINT)
            if row == len(shown) - 1:
                label = "← +x  left pad" if column == 0 else "right pad"
                axes.set_xlabel(label, loc="left", labelpad=2, fontsize=7, color=FAINT)
    scale_bar(figure, image, 7, ax=axes_of_maps, location="right", fraction=0.035, pad=0.03, aspect=40)


def _caption(touch: Touch) -> str:
    place = f"{in_unit(touch.horizontal, 'm')}, {in_unit(touch.vertical, 'm')}, {in_unit(touch.angle, 'rad')}"
    return f"{in_unit(touch.time, 's', 1)}   {place}{'' if touch.sure else '   unsure'}"


def _title(figure: Figure, replay: Replay) -> None:
    outcome, after = replay.outcome(), replay.afterwards()
    name = str((after or outcome)["name"]).replace("_", " ").lower()
    if outcome["success"] is None:
        headline, colour = "Unfinished record", ORANGE
    elif after is not None:
        headline, colour = f"Charged, then {name}", RED
    elif outcome["success"]:
        headline, colour = "Docked" if math.isnan(replay.charged) else "Docked and charged", "#20703f"
    else:
        headline, colour = f"Not docked: {name}", RED
    when = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(replay.began * 1e-9))
    about = [when, replay.request_id, f"scene {replay.about['scene']}" if replay.about.get("scene") else ""]
    figure.text(0.075, 0.966, headline, fontsize=17, fontweight="bold", color=colour, va="center")
    figure.text(0.075, 0.937, "   ·   ".join(filter(None, about)), fontsize=9.5, color=FAINT, va="center")


def _closing(figure: Figure, replay: Replay) -> None:
    from matplotlib.patches import Rectangle

    good = bool(replay.outcome()["success"]) and replay.afterwards() is None
    figure.add_artist(Rectangle((0.075, 0.022), 0.004, 0.078, color=GREEN if good else RED, linewidth=0))
    lines = textwrap.wrap(why(replay), 165)
    text = "\n".join([*lines[:4], *(["…"] if len(lines) > 4 else [])])
    figure.text(0.087, 0.061, text, fontsize=9.6, va="center", linespacing=1.45)
