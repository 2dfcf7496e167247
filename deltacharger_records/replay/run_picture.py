# SPDX-License-Identifier: Apache-2.0
"""Picture of a docking: motion, forces, measurements and currents over the phases of the algorithm."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deltacharger_records.plotting import BLUE, GREEN, INK, ORANGE, PURPLE, RED, STYLE
from deltacharger_records.replay.contacts_picture import draw_contacts
from deltacharger_records.replay.run_record import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BAND = (0.4, 0.5)
"""Contact current (A) that the paper holds at the dock."""

MISALIGNMENT = (
    ("horizontal", BLUE, 1e3, "horizontal, mm"),
    ("vertical", ORANGE, 1e3, "vertical, mm"),
    ("angle", PURPLE, 180.0 / math.pi, "angle, °"),
)
"""Curves of a misalignment: name, colour, scale from SI, label."""
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
_PEAKS = 0.02  # of the values at each end: shorter peaks may be cut from a panel
_NARROW = 0.035  # of the time axis: narrower phases share a label
_SPARE = 0.2  # s of margin around the run


class PictureError(RuntimeError):
    """The picture cannot be drawn; the message names what to install, or the path that cannot be written."""


def draw(run: Run, path: Path) -> None:
    """Write the picture of `run` to `path`; the suffix decides the format.

    Raises:
        PictureError: matplotlib is missing, or the file cannot be written.
    """
    save(path, 8.6, 9.5, lambda figure: _compose(figure, run))


def save(path: Path, height: float, title_size: float, compose: Callable[[Figure], None]) -> None:
    """Write a figure of 13 in by `height` in, drawn by `compose`; errors as in `draw`."""
    try:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    except ImportError as error:
        raise PictureError("matplotlib is not installed: install deltacharger[picture]") from error
    with rc_context(STYLE | {"axes.titlesize": title_size}):
        figure = Figure(figsize=(13.0, height), dpi=120, facecolor="white")
        compose(figure)
        try:
            figure.savefig(path)
        except (OSError, ValueError) as error:
            raise PictureError(f"cannot write {path}: {error}") from error


def _compose(figure: Figure, run: Run) -> None:
    grid = figure.add_gridspec(
        5, 2, width_ratios=(3.0, 1.0), height_ratios=(1.5, 1.25, 1.0, 1.25, 1.0),
        left=0.075, right=0.955, top=0.875, bottom=0.062, hspace=0.16, wspace=0.13,
    )  # fmt: skip
    first = figure.add_subplot(grid[0, 0])
    rows = [first, *(figure.add_subplot(grid[index, 0], sharex=first) for index in range(1, 5))]
    span = _span(run)
    for axes, panel in zip(rows, (height, contact_current, _force, _misalignment, charge), strict=True):
        shade(axes, run, span)
        panel(axes, run)
        axes.set_xlim(span)
        axes.grid(axis="y", color="white", linewidth=1.0, zorder=0.5)
        axes.yaxis.set_label_coords(-0.058, 0.5)
        axes.tick_params(labelbottom=axes is rows[-1], length=3)
    rows[-1].set_xlabel("time since the goal, s")
    name_phases(rows[0], run, span)
    _side(figure, grid[:, 1], run)
    _title(figure, run)


def _side(figure: Figure, place: Any, run: Run) -> None:
    """Fill the column beside the curves: the camera's image if one was used, contacts, pads, figures."""
    heights = (1.1, 0.62, 0.95) if run.seen is None else (0.95, 1.1, 0.62, 0.95)
    rows = place.subgridspec(len(heights), 1, height_ratios=heights, hspace=0.3)
    if run.seen is not None:
        axes = figure.add_subplot(rows[0, 0])
        axes.imshow(run.seen, interpolation="antialiased")
        axes.set_title("camera image", pad=4)
        axes.set_axis_off()
    draw_contacts(figure.add_subplot(rows[-3, 0]), run)
    pads = rows[-2, 0].subgridspec(1, 2, wspace=0.12)
    _heat_maps(figure, (pads[0, 0], pads[0, 1]), run)
    _report(figure.add_subplot(rows[-1, 0]), run)


def _span(run: Run) -> tuple[float, float]:
    ends = [series.arrays()["time"][-1:] for series in (run.motion, run.power, run.contact)]
    times = [float(end[0]) for end in ends if len(end)] + [time for time, _ in run.phases]
    starts = [time for time, phase in run.phases if phase != "idle"]
    begin = max(min(starts, default=0.0) - _SPARE, 0.0)
    return begin, max([*times, begin + 1.0]) + _SPARE


def _intervals(run: Run, span: tuple[float, float]) -> list[tuple[float, float, str]]:
    stretches = itertools.pairwise([*run.phases, (span[1], "")])
    return [(max(begin, span[0]), end, phase) for (begin, phase), (end, _) in stretches if end > span[0]]


def shade(axes: Axes, run: Run, span: tuple[float, float]) -> None:
    """Colour a panel's background by phase."""
    axes.set_facecolor("#f6f7f8")
    axes.set_axisbelow(True)
    for begin, end, phase in _intervals(run, span):
        axes.axvspan(begin, end, color=_PHASE_COLOURS.get(phase, "#eeeeee"), linewidth=0, zorder=0)


def name_phases(
    axes: Axes, run: Run, span: tuple[float, float], place: Callable[[float], float] = lambda time: time
) -> None:
    """Label each phase above its stretch; consecutive narrow phases share the first one's label.

    Args:
        axes: the panel at the top.
        run: shown in it.
        span: first and last time shown, s.
        place: converts a time to its place on the axis, if that is not linear.
    """
    free_from, width = place(span[0]), place(span[1]) - place(span[0])
    for begin, end, phase in _intervals(run, span):
        if phase == "idle":
            continue
        room = len(phase) * 0.0085 * width
        start, stop = place(begin), place(end)
        centre = 0.5 * (start + stop)
        if stop - start < _NARROW * width and centre - 0.5 * room < free_from:
            continue
        left = max(centre - 0.5 * room, free_from)
        axes.annotate(
            phase.replace("_", " "), ((left + 0.5 * room - place(span[0])) / width, 1.0), xycoords="axes fraction",
            xytext=(0, 5), textcoords="offset points", ha="center", va="bottom", fontsize=8, color="#51606e",
        )  # fmt: skip
        free_from = left + room


def height(axes: Axes, run: Run) -> None:
    """Draw the platform's z."""
    motion = run.motion.arrays()
    axes.plot(motion["time"], 1e3 * motion["z"], color=BLUE, linewidth=1.6)
    axes.set_ylabel("z, mm")


def contact_current(axes: Axes, run: Run) -> None:
    """Draw the contact current and its band."""
    contact, motion = run.contact.arrays(), run.motion.arrays()
    axes.axhspan(*BAND, color=GREEN, alpha=0.28, linewidth=0, zorder=1)
    axes.plot(motion["time"], motion["current"], color=ORANGE, linewidth=0.8, alpha=0.6, label="from servo_state")
    axes.plot(contact["time"], contact["current"], ".", color=ORANGE, markersize=3.5, label="as reported")
    legend(axes)
    _limit(axes, np.concatenate([contact["current"], motion["current"]]), BAND, "A")
    axes.annotate(
        "0.4–0.5 A", (1.0, 0.5 * sum(BAND)), xycoords=("axes fraction", "data"), xytext=(4, 0),
        textcoords="offset points", va="center", fontsize=7.5, color="#20703f", annotation_clip=False,
    )  # fmt: skip
    axes.set_ylabel("contact\ncurrent, A")


def _force(axes: Axes, run: Run) -> None:
    motion = run.motion.arrays()
    axes.axhline(0.0, color="#9aa5b1", linewidth=0.8)
    axes.plot(motion["time"], motion["force"], color=RED, linewidth=1.1)
    _limit(axes, motion["force"], (0.0, 1.0), "N")
    axes.set_ylabel("push of the\nservos, N")


def _misalignment(axes: Axes, run: Run) -> None:
    live, decided = run.misalignment.arrays(), run.decided.arrays()
    axes.axhline(0.0, color="#9aa5b1", linewidth=0.8)
    for contact, time in {touch.contact: touch.time for touch in reversed(run.touches)}.items():
        axes.annotate(str(contact), (time, 0.04), xycoords=("data", "axes fraction"), fontsize=8, ha="center")
    for name, colour, scale, label in MISALIGNMENT:
        axes.plot(live["time"], scale * live[name], color=colour, linewidth=0.9, alpha=0.45)
        acted = scale * np.append(decided[name], decided[name][-1:])  # holds until the end of the record
        times = np.append(decided["time"], live["time"][-1:] if len(decided["time"]) and len(live["time"]) else [])
        axes.step(times, acted[: len(times)], where="post", color=colour, linewidth=1.8, label=label)
    known = np.concatenate([1e3 * decided["horizontal"], 1e3 * decided["vertical"], np.degrees(decided["angle"])])
    known = known[np.isfinite(known)]
    if len(known):
        reach = 1.35 * max(float(np.abs(known).max()), 1.0)
        axes.set_ylim(-reach, reach)
    legend(axes)
    axes.set_ylabel("misalign-\nment")


def legend(axes: Axes) -> None:
    """Show a panel's legend."""
    axes.legend(loc="upper left", ncols=3, fontsize=7.5, frameon=True, framealpha=0.75, edgecolor="none")


def charge(axes: Axes, run: Run) -> None:
    """Draw charge current and contactor state."""
    power = run.power.arrays()
    axes.plot(power["time"], power["current"], color=GREEN, linewidth=1.6)
    axes.fill_between(power["time"], 0.0, np.nan_to_num(power["current"]), color=GREEN, alpha=0.25, linewidth=0)
    measured = np.isfinite(power["current"]).any()
    highest = np.nanmax(power["current"]) if measured else 0.0
    if not measured:
        axes.text(0.5, 0.5, "not measured", transform=axes.transAxes, ha="center", va="center", color="#51606e")
    axes.set_ylim(-0.04 * max(highest, 1.0), 1.15 * max(highest, 1.0))
    axes.set_ylabel("charge\ncurrent, A")


def _limit(axes: Axes, values: Any, band: tuple[float, float], unit: str) -> None:
    """Scale a panel to most of the values and the band; short peaks beyond are cut and stated in words."""
    known = values[np.isfinite(values)]
    known = known if len(known) else np.zeros(1)
    low, high = np.percentile(known, (100.0 * _PEAKS, 100.0 * (1.0 - _PEAKS)))
    low, high = min(float(low), 0.0), max(float(high), band[1])
    spare = 0.2 * (high - low)
    axes.set_ylim(low - spare, high + spare)
    ends = [f"{end:.3g} {unit}" for end in (known.min(), known.max()) if not low - spare <= end <= high + spare]
    if ends:
        words = f"peaks to {' and '.join(ends)}".replace("-", "−")
        axes.annotate(words, (0.995, 0.04), xycoords="axes fraction", ha="right", fontsize=7.5, color="#51606e")


def _heat_maps(figure: Figure, slots: tuple[Any, Any], run: Run) -> None:
    """Show both pads as seen along +z at the target: +x to the left, +y up."""
    if run.frames is None:
        axes = figure.add_subplot(slots[0])
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no tactile contact", ha="center", va="center", color="#7b8794")
        return
    left, right = run.frames
    top = max(float(np.nanmax(left)), float(np.nanmax(right)), 2.0)
    for slot, name, frame in zip(slots, ("left pad", "right pad"), (left, right), strict=True):
        axes = figure.add_subplot(slot)
        shown = pad_map(axes, frame, top)
        axes.set_title(f"{name}, {np.nansum(frame):.0f} N", pad=4, fontsize=8.5)
        axes.set_xlabel("← +x    ↑ +y", loc="left", labelpad=2, fontsize=7.5, color="#7b8794")
    scale_bar(figure, shown, 7.5, ax=figure.axes[-2:], fraction=0.03, pad=0.03)


def pad_map(axes: Axes, frame: Any, top: float) -> Any:
    """Draw a pad's forces, from 0 to `top` N; return the image."""
    image = axes.imshow(frame, cmap=_heat_colours(), vmin=0.0, vmax=top, interpolation="nearest")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    return image


def scale_bar(figure: Figure, image: Any, size: float, **place: Any) -> None:
    """Add the colour scale of `image`, with text of `size` points."""
    bar = figure.colorbar(image, **place)
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=2, labelsize=size)
    bar.set_label("N per taxel", fontsize=size)


def _heat_colours() -> Any:
    """Return the colours of a pad: paper white where nothing presses."""
    import matplotlib
    from matplotlib.colors import LinearSegmentedColormap

    deep = [matplotlib.colormaps["magma_r"](share) for share in np.linspace(0.08, 0.95, 12)]
    colours = LinearSegmentedColormap.from_list("pressure", ["#f6f7f8", *deep])
    return colours.with_extremes(bad="#b8c2cc")


def _report(axes: Axes, run: Run) -> None:
    axes.set_axis_off()
    outcome = run.outcome
    if outcome is None:
        return
    details = outcome.details
    rest = details.get("misalignment", {})
    lines = [
        ("charge", _figure(details.get("charge_current"), 1.0, "A", 2)),
        ("energy", _figure(details.get("energy"), 1.0, "J", 0)),
        ("contact current", _figure(details.get("contact_current"), 1.0, "A", 3)),
        ("servo push", _figure(details.get("contact_force"), 1.0, "N", 1)),
        ("alignments", str(details.get("alignments", "–"))),
        ("redockings", str(details.get("redockings", "–"))),
        ("rest horizontal", _figure(rest.get("horizontal"), 1e3, "mm", 2)),
        ("rest vertical", _figure(rest.get("vertical"), 1e3, "mm", 2)),
        ("rest angle", _figure(rest.get("angle"), 180.0 / math.pi, "°", 2)),
        ("took", _figure(outcome.elapsed, 1.0, "s", 1)),
    ]
    for index, (name, value) in enumerate(lines):
        height = 0.97 - index * 0.1
        axes.text(0.02, height, name, va="top", fontsize=8.5, color="#51606e")
        axes.text(0.98, height, value, va="top", ha="right", fontsize=8.5, fontweight="bold")


def _figure(value: Any, scale: float, unit: str, digits: int) -> str:
    if value is None or value != value:
        return "–"
    return f"{scale * value:.{digits}f} {unit}"


def headline(run: Run) -> tuple[str, str]:
    """Return the run's result, and a subtitle: its error message, else the run's subject."""
    outcome = run.outcome
    if outcome is None:
        title = "Docking"
    elif outcome.success:
        title = "Docked and charging" if outcome.details.get("energy", 0.0) > 0.0 else "Docked"
    else:
        title = f"Not docked: {outcome.error_name.replace('_', ' ').lower()}"
    message = outcome.error_message if outcome is not None else ""
    return title, message or run.notes.get("about", "")


def _title(figure: Figure, run: Run) -> None:
    title, about = headline(run)
    colour = INK if run.outcome is None else "#20703f" if run.outcome.success else RED
    figure.text(0.075, 0.960, title, fontsize=17, fontweight="bold", color=colour, va="center")
    short = about if len(about) < 160 else about[:157] + "…"
    figure.text(0.075, 0.928, short, fontsize=9.5, color="#51606e", va="center")
