# SPDX-License-Identifier: Apache-2.0
"""Picture of a docking, live or recorded: why it ended, over the phases of the algorithm.

Its colours are those of all pictures; the five stay distinct for colour-blind readers.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deltacharger_bringup.records.replay.run import Run, Touch
from deltacharger_bringup.records.replay.words import in_unit, why
from deltacharger_docking.clearance import CLEARANCE_SIGMAS, least_clearance

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, FAINT, PAPER = "#22303c", "#51606e", "#f6f7f8"
BLUE, ORANGE, GREEN, PURPLE, RED = "#1a70e8", "#df8712", "#14b377", "#5c1d8c", "#981018"
STYLE: Any = {
    "font.size": 9.0,
    "axes.edgecolor": "#9aa5b1",
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10.0,
    "axes.facecolor": PAPER,
    "axes.axisbelow": True,
}
BAND = (0.4, 0.5)
"""Contact current (A) that the paper holds at the dock."""
_SIZE = (13.0, 10.4)  # in
_PHASE_COLOURS = {
    "locate": "#e6eaf1",
    "approach": "#e4eff8",
    "back_off": "#faeae1",
    "contact": "#fdf6e0",
    "measure": "#e9e2f5",
    "align": "#e0f1ec",
    "energise": "#fce6eb",
    "charging": "#dcf2e1",
    "retract": "#efebe5",
    "idle": "#f6f7f8",
}
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
_MISALIGNMENT = (
    ("horizontal", BLUE, 1e3, "horizontal, mm"),
    ("vertical", ORANGE, 1e3, "vertical, mm"),
    ("angle", PURPLE, 180.0 / math.pi, "angle, °"),
)
"""Parts of a misalignment: name, colour, scale from SI, label."""
_DARK_GREEN, _LINE = "#20703f", "#9aa5b1"
_PEAKS = 0.02  # of the values at each end: shorter peaks may be cut from a panel
_NARROW = 0.035  # of the time axis: narrower phases share a label
_MAPS = 3  # contacts whose tactile frames are shown
_LEAST_REACH, _SPARE_REACH = 5.0, 1.2  # mm: smallest half width of the map of contacts, and its margin


class PictureError(RuntimeError):
    """The picture cannot be drawn; the message names what to install, or the path that cannot be written."""


def draw(run: Run, path: Path, about: str = "") -> None:
    """Write the picture of a docking.

    Args:
        run: a completed one.
        path: of the file; the suffix decides the format.
        about: text below the title.

    Raises:
        PictureError: matplotlib is missing, or the file cannot be written.
    """
    try:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    except ImportError as error:
        raise PictureError("matplotlib is not installed: install deltacharger[picture]") from error
    with rc_context({**STYLE, "axes.titlesize": 9.5}):
        figure = Figure(figsize=_SIZE, dpi=120, facecolor="white")
        _compose(figure, run, about)
        try:
            figure.savefig(path)
        except (OSError, ValueError) as error:
            raise PictureError(f"cannot write {path}: {error}") from error


def _compose(figure: Figure, run: Run, about: str) -> None:
    grid = figure.add_gridspec(
        6, 2, width_ratios=(3.2, 1.0), height_ratios=(0.5, 1.2, 1.3, 1.4, 1.1, 1.0),
        left=0.075, right=0.955, top=0.885, bottom=0.150, hspace=0.13, wspace=0.2,
    )  # fmt: skip
    scale = TimeScale(run)
    first = figure.add_subplot(grid[0, 0])
    rows = [first, *(figure.add_subplot(grid[index, 0], sharex=first) for index in range(1, 6))]
    panels = (_decisions, _height, _contact_current, _misalignment, _clearance, _charge)
    for axes, panel in zip(rows, panels, strict=True):
        axes.set_facecolor(_PHASE_COLOURS["idle"])
        for phase in run.phases:
            colour = _PHASE_COLOURS.get(phase.state, "#eeeeee")
            axes.axvspan(max(phase.start, scale.begin), phase.end, color=colour, linewidth=0, zorder=0)
        panel(axes, run, scale)
        axes.grid(axis="y", color="white", linewidth=1.0, zorder=0.5)
        axes.yaxis.set_label_coords(-0.058, 0.5)
        axes.tick_params(labelbottom=axes is rows[-1], length=3)
    scale.apply(rows)
    rows[-1].set_xlabel("time since the docking began, s", labelpad=2)
    _name_phases(first, run, scale)
    _side(figure, grid[:, 1], run)
    title, colour = headline(run)
    figure.text(0.075, 0.968, title, fontsize=17, fontweight="bold", color=colour, va="center")
    short = about if len(about) < 160 else f"{about[:157]}…"
    figure.text(0.075, 0.942, short, fontsize=9.5, color=FAINT, va="center")
    _closing(figure, run, colour)


def headline(run: Run) -> tuple[str, str]:
    """Return the title, and its colour."""
    outcome, after = run.outcome(), run.afterwards()
    name = str((after or outcome)["name"]).replace("_", " ").lower()
    if outcome["success"] is None:
        return "Unfinished record", ORANGE
    if after is not None or not outcome["success"]:
        return f"Not docked: {name}" if math.isnan(run.charged) else f"Charged, then {name}", RED
    charge = "" if math.isnan(run.charged) else " and charging" if run.last_phase == "charging" else " and charged"
    return f"Docked{charge}", _DARK_GREEN


def _closing(figure: Figure, run: Run, colour: str) -> None:
    """Write below the panels why it ended."""
    from matplotlib.patches import Rectangle

    figure.add_artist(Rectangle((0.075, 0.020), 0.004, 0.072, color=colour, linewidth=0))
    lines = textwrap.wrap(why(run), 165)
    text = "\n".join([*lines[:4], *(["…"] if len(lines) > 4 else [])])
    figure.text(0.087, 0.056, text, fontsize=9.6, va="center", linespacing=1.45)


class TimeScale:
    """Time axis of a run; long stretches of one phase are compressed to the width of a docking.

    Attributes:
        begin, end: first and last time shown, s.
        squeezed: the compressed stretches, s.
        width: of the axis.
    """

    _SPARE = 0.3  # s of margin around the run
    _SHARE = 0.35  # width of a long stretch, as a share of the rest
    _LEAST = 8.0  # s, smallest width of a compressed stretch
    _EDGE = 3.0  # s at both ends of a long stretch that are not compressed

    def __init__(self, run: Run) -> None:
        self.begin, self.end = -self._SPARE, run.end + self._SPARE
        long = [(phase.start + self._EDGE, phase.end - self._EDGE) for phase in run.phases]
        long = [(start, stop) for start, stop in long if stop - start > self._LEAST]
        room = max(self._SHARE * (self.end - self.begin - sum(stop - start for start, stop in long)), self._LEAST)
        self.squeezed = [(start, stop) for start, stop in long if stop - start > room]
        self._times, self._places = [self.begin], [0.0]  # knots of a piecewise linear map
        for start, stop in self.squeezed:
            place = self._places[-1] + start - self._times[-1]
            self._times += [start, stop]
            self._places += [place, place + room]
        self.width = self._places[-1] + self.end - self._times[-1]
        self._times.append(self.end)
        self._places.append(self.width)

    def forward(self, time: Any) -> Any:
        """Return the places of one or many times."""
        return np.interp(time, self._times, self._places)

    def inverse(self, place: Any) -> Any:
        """Return the times of one or many places."""
        return np.interp(place, self._places, self._times)

    def beside(self, time: float, share: float) -> float:
        """Return the time drawn at a distance from `time`, given as a share of the axis."""
        return float(self.inverse(self.forward(time) + share * self.width))

    def apply(self, rows: Sequence[Axes]) -> None:
        """Use the scale on panels that share their time axis."""
        from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator

        if self.squeezed:
            for axes in rows:
                axes.set_xscale("function", functions=(self.forward, self.inverse))
            first = self.squeezed[0][0]
            ticks = [time for time in MaxNLocator(6).tick_values(self.begin, first) if self.begin <= time <= first]
            ticks += [round(stop) for _, stop in self.squeezed]
            rows[-1].xaxis.set_major_locator(FixedLocator(ticks))
            rows[-1].xaxis.set_minor_locator(NullLocator())
            rows[-1].xaxis.set_major_formatter(lambda time, _: f"{time:g}")
            for start, stop in self.squeezed:
                middle = float(self.inverse(np.mean(self.forward((start, stop)))))
                rows[-1].annotate(
                    f"⟵ {_length(stop - start)} ⟶", (middle, 0.05), xycoords=("data", "axes fraction"),
                    ha="center", va="bottom", fontsize=7.5, color=FAINT,
                )  # fmt: skip
        rows[0].set_xlim(self.begin, self.end)


def _length(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


def _name_phases(axes: Axes, run: Run, scale: TimeScale) -> None:
    """Label each phase above its stretch; consecutive narrow phases share the first one's label."""
    free_from, width = 0.0, scale.width
    for phase in run.phases:
        start, stop = (scale.forward(max(time, scale.begin)) for time in (phase.start, phase.end))
        if phase.state == "idle" or stop <= 0.0:
            continue
        room = len(phase.state) * 0.0085 * width
        centre = 0.5 * (start + stop)
        if stop - start < _NARROW * width and centre - 0.5 * room < free_from:
            continue
        left = max(centre - 0.5 * room, free_from)
        axes.annotate(
            phase.state.replace("_", " "), ((left + 0.5 * room) / width, 1.0), xycoords="axes fraction",
            xytext=(0, 5), textcoords="offset points", ha="center", va="bottom", fontsize=8, color=FAINT,
        )  # fmt: skip
        free_from = left + room


def _decisions(axes: Axes, run: Run, scale: TimeScale) -> None:
    """Mark every decision, and label the important ones if there is room."""
    axes.set_ylim(0.0, 1.0)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_ylabel("decided")
    free = [0.0] * 3
    for decision in run.decisions:
        text, colour = _MARKED.get(decision.kind, ("", "#b3bdc8"))
        axes.axvline(decision.time, ymin=0.0, ymax=0.18, color=colour, linewidth=1.4 if text else 0.8)
        place = scale.forward(decision.time)
        level = next((level for level in range(3) if text and free[level] <= place), None)
        if level is None:
            continue
        free[level] = place + (len(text) + 2) * 0.0062 * scale.width
        side = "left" if free[level] < scale.width else "right"
        axes.text(decision.time, 0.2 + 0.27 * level, f" {text} ", fontsize=7, color=colour, va="bottom", ha=side)


def _height(axes: Axes, run: Run, scale: TimeScale) -> None:
    motion = run.motion.arrays()
    axes.plot(motion["time"], 1e3 * motion["z"], color=BLUE, linewidth=1.6)
    axes.set_ylabel("z, mm")


def _contact_current(axes: Axes, run: Run, scale: TimeScale) -> None:
    contact, motion = run.contact.arrays(), run.motion.arrays()
    axes.axhspan(*BAND, color=GREEN, alpha=0.28, linewidth=0, zorder=1)
    axes.plot(motion["time"], motion["current"], color=ORANGE, linewidth=0.8, alpha=0.6, label="from servo_state")
    axes.plot(contact["time"], contact["current"], ".", color=ORANGE, markersize=3.5, label="as reported")
    _legend(axes, "lower left")
    _limit(axes, np.concatenate([contact["current"], motion["current"]]), BAND[1], "A")
    _beside(axes, 0.5 * sum(BAND), "0.4–0.5 A", _DARK_GREEN)
    axes.set_ylabel("contact\ncurrent, A")


def _misalignment(axes: Axes, run: Run, scale: TimeScale) -> None:
    """Draw each measurement with its standard deviation, and its contact's number; hollow = unsure."""
    axes.axhline(0.0, color=_LINE, linewidth=0.8)
    shown = list[float]()
    for offset, (name, colour, factor, label) in enumerate(_MISALIGNMENT):
        times = [scale.beside(touch.time, (offset - 1) * 0.004) for touch in run.touches]
        values = [factor * getattr(touch.estimate, name) for touch in run.touches]
        spread = [factor * getattr(touch.estimate, f"{name}_stddev") for touch in run.touches]
        shown += [end for at, by in zip(values, spread, strict=True) for end in (at - by, at + by)]
        axes.plot(times, values, color=colour, linewidth=0.9, alpha=0.5)
        axes.errorbar(times, values, yerr=spread, fmt="none", ecolor=colour, elinewidth=1.2, capsize=2.5)
        faces = [colour if touch.estimate.sure else "white" for touch in run.touches]
        axes.scatter(times, values, s=20, c=faces, edgecolors=colour, linewidths=1.2, zorder=3, label=label)
    for contact, time in {touch.contact: touch.time for touch in reversed(run.touches)}.items():
        axes.annotate(str(contact), (time, 0.03), xycoords=("data", "axes fraction"), fontsize=8, ha="center")
    known = [end for end in shown if math.isfinite(end)]
    low, high = min([*known, -1.0]), max([*known, 1.0])
    axes.set_ylim(low - 0.25 * (high - low), high + 0.5 * (high - low))  # room for the numbers and the legend
    _legend(axes, "upper left")
    axes.set_ylabel("misalign-\nment ± σ")


def _clearance(axes: Axes, run: Run, scale: TimeScale) -> None:
    """Draw each measurement's clearance, less CLEARANCE_SIGMAS standard deviations, against the needed one."""
    parameters = run.parameters
    needed, sigmas = 1e3 * parameters.clearance_min, CLEARANCE_SIGMAS
    shown = [0.0, 4.0]
    for touch in run.touches:
        left, worst = (1e3 * least_clearance(touch.estimate, parameters, spread) for spread in (0.0, sigmas))
        if math.isfinite(worst):
            colour = GREEN if worst >= needed else RED
            axes.plot([touch.time] * 2, [left, worst], color=colour, linewidth=3.0, solid_capstyle="butt", alpha=0.55)
            axes.plot([touch.time], [left], "o", color=colour, markersize=4.5)
            shown += [left, worst]
    axes.axhline(needed, color=RED, linewidth=1.0, linestyle=(0, (4, 3)))
    low, high = min(shown) - 0.8, max(shown) + 0.8
    axes.set_ylim(low, high)
    axes.axhspan(low, needed, color=RED, alpha=0.07, linewidth=0)
    _beside(axes, needed, f"{needed:.1f} mm\nneeded", RED)
    axes.set_ylabel(f"clearance\nto {sigmas:g}σ, mm")


def _charge(axes: Axes, run: Run, scale: TimeScale) -> None:
    power = run.power.arrays()
    axes.plot(power["time"], power["current"], color=GREEN, linewidth=1.6)
    axes.fill_between(power["time"], 0.0, np.nan_to_num(power["current"]), color=GREEN, alpha=0.25, linewidth=0)
    measured = np.isfinite(power["current"]).any()
    highest = max(float(np.nanmax(power["current"])) if measured else 0.0, 1.0)
    if not measured:
        axes.text(0.5, 0.5, "not measured", transform=axes.transAxes, ha="center", va="center", color=FAINT)
    axes.set_ylim(-0.04 * highest, 1.15 * highest)
    axes.set_ylabel("charge\ncurrent, A")


def _legend(axes: Axes, place: Any) -> None:
    axes.legend(loc=place, ncols=3, fontsize=7.5, frameon=True, framealpha=0.75, edgecolor="none")


def _beside(axes: Axes, value: float, text: str, colour: str) -> None:
    """Write to the right of a panel, at a value."""
    axes.annotate(
        text, (1.0, value), xycoords=("axes fraction", "data"), xytext=(4, 0), textcoords="offset points",
        va="center", fontsize=7, color=colour, annotation_clip=False,
    )  # fmt: skip


def _limit(axes: Axes, values: Any, least: float, unit: str) -> None:
    """Scale a panel to most of the values, 0 and `least`; short peaks beyond are cut and stated in words."""
    known = values[np.isfinite(values)]
    known = known if len(known) else np.zeros(1)
    low, high = np.percentile(known, (100.0 * _PEAKS, 100.0 * (1.0 - _PEAKS)))
    low, high = min(float(low), 0.0), max(float(high), least)
    spare = 0.2 * (high - low)
    axes.set_ylim(low - spare, high + spare)
    ends = [f"{end:.3g} {unit}" for end in (known.min(), known.max()) if not low - spare <= end <= high + spare]
    if ends:
        words = f"peaks to {' and '.join(ends)}".replace("-", "−")
        axes.annotate(words, (0.995, 0.04), xycoords="axes fraction", ha="right", fontsize=7.5, color=FAINT)


def _side(figure: Figure, place: Any, run: Run) -> None:
    """Fill the column beside the curves: contacts and pads."""
    rows = place.subgridspec(2, 1, height_ratios=(2.0, 3.6), hspace=0.22)
    contacts = list({touch.contact or index: touch for index, touch in enumerate(run.touches, 1)}.values())
    _contacts(figure.add_subplot(rows[0, 0]), contacts, run)
    _pads(figure, rows[1, 0], contacts)


def _contacts(axes: Axes, contacts: Sequence[Touch], run: Run) -> None:
    """Draw the target's offset at each contact with one standard deviation, and the limits for resting.

    Seen along +z at the target, as the pads: +x to the left, +y up. Each contact's last measurement counts: it was made
    after the holding currents were reduced.
    """
    from matplotlib.patches import Rectangle

    axes.set_title("target offset at each contact, mm", pad=4)
    axes.axhline(0.0, color=_LINE, linewidth=0.8, zorder=1)
    axes.axvline(0.0, color=_LINE, linewidth=0.8, zorder=1)
    x, y = 1e3 * run.parameters.overlap_loss_max, 1e3 * run.parameters.landing_limit
    area: Any = Rectangle((-x, -y), 2 * x, 2 * y, color=GREEN, alpha=0.14, linewidth=0, zorder=0.5)
    axes.add_patch(area)
    axes.annotate(
        f"±{x:g} × ±{y:g}", (-x, -y), xytext=(-2, 3), textcoords="offset points", fontsize=7, ha="right", color=FAINT
    )
    places = [(1e3 * touch.estimate.horizontal, 1e3 * touch.estimate.vertical) for touch in contacts]
    known = [(touch, at) for touch, at in zip(contacts, places, strict=True) if math.isfinite(sum(at))]
    axes.plot([at[0] for _, at in known], [at[1] for _, at in known], color=BLUE, linewidth=0.8, alpha=0.5, zorder=2)
    for touch, at in known:
        last = touch is contacts[-1]
        colour = GREEN if last and run.outcome()["success"] else BLUE
        pose = touch.estimate
        axes.errorbar(
            *at, 1e3 * pose.vertical_stddev, 1e3 * pose.horizontal_stddev,
            color=colour, marker="o" if pose.sure else "x", markersize=5, elinewidth=0.9, zorder=3,
        )  # fmt: skip
        axes.annotate(
            str(touch.contact), at, xytext=(5, 4), textcoords="offset points", fontsize=8.5,
            fontweight="bold" if last else "normal", color=colour,
        )  # fmt: skip
    reach = max([_LEAST_REACH, *(abs(value) + _SPARE_REACH for _, at in known for value in at)])
    axes.set_xlim(reach, -reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal")
    axes.tick_params(length=2, labelsize=7.5)


def _pads(figure: Figure, place: Any, contacts: Sequence[Touch]) -> None:
    """Show the pads' forces at the contacts as seen along +z at the target: +x to the left, +y up."""
    felt = [touch for touch in contacts if touch.frames is not None]
    shown = felt if len(felt) <= _MAPS else [felt[round(i * (len(felt) - 1) / (_MAPS - 1))] for i in range(_MAPS)]
    rows = place.subgridspec(_MAPS, 2, hspace=0.45, wspace=0.08)
    if not shown:
        axes = figure.add_subplot(rows[0, :])
        axes.set_axis_off()
        axes.text(0.5, 0.5, "nothing was measured by touch", ha="center", va="center", color=FAINT)
        return
    top = max(2.0, *(float(np.nanmax(pad)) for touch in shown for pad in touch.frames or ()))
    image: Any = None
    maps = []
    for row, touch in enumerate(shown):
        for column, frame in enumerate(touch.frames or ()):
            axes = figure.add_subplot(rows[row, column])
            maps.append(axes)
            image = axes.imshow(frame, cmap=_heat_colours(), vmin=0.0, vmax=top, interpolation="nearest")
            axes.set_xticks([])
            axes.set_yticks([])
            for spine in axes.spines.values():
                spine.set_visible(False)
            if column == 0:
                axes.set_title(_caption(touch), loc="left", pad=4, fontsize=8.2)
            if row == len(shown) - 1:
                label = "← +x  ↑ +y  left pad" if column == 0 else "right pad"
                axes.set_xlabel(label, loc="left", labelpad=2, fontsize=7, color=FAINT)
    bar = figure.colorbar(image, ax=maps, location="right", fraction=0.035, pad=0.03, aspect=40)
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=2, labelsize=7)
    bar.set_label("N per taxel", fontsize=7)


def _caption(touch: Touch) -> str:
    pose = touch.estimate
    place = f"{in_unit(pose.horizontal, 'm')}, {in_unit(pose.vertical, 'm')}, {in_unit(pose.angle, 'rad')}"
    return f"{touch.contact}: {place}{'' if pose.sure else '   unsure'}"


def _heat_colours() -> Any:
    """Return the colours of a pad: paper white where nothing presses."""
    import matplotlib
    from matplotlib.colors import LinearSegmentedColormap

    deep = [matplotlib.colormaps["magma_r"](share) for share in np.linspace(0.08, 0.95, 12)]
    colours = LinearSegmentedColormap.from_list("pressure", ["#f6f7f8", *deep])
    return colours.with_extremes(bad="#b8c2cc")
