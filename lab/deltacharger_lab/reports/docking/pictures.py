# SPDX-License-Identifier: Apache-2.0
"""Pictures of the docking report."""

from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_bringup.records.replay.picture import BLUE, FAINT, GREEN, INK, ORANGE, PURPLE, RED
from deltacharger_lab.plotting import Axes, picture, top_legend
from deltacharger_lab.reports.docking import lean, summary

NAME = "docking-lean.png"
_KINDS = (
    ("charged, called aligned", "o", "#0072b2"),
    ("charged, not called aligned", "o", "#56b4e9"),
    ("LEANING", "X", "#e69f00"),
    ("another code", "D", "#222222"),
)
"""Colours of Okabe and Ito, which colour-blind people can distinguish."""
_MARKS_MOST = 5000  # marks of a panel


def outcomes(results: dict[str, Any], path: Path) -> None:
    """Draw each docking of `MAP` at its yaw and pitch, marked by its result."""
    rows = {name: results["rows"][name] for name in lean.MAP if name in results["rows"]}
    about = "each mark one simulated docking; right: springs of the electrodes of 3e5 N/m instead of 3e4 and 1e5"
    with picture(path, 11.0, 5.9, "Leaning faces: charged and refused dockings", about) as figure:
        panels = figure.subplots(1, len(lean.MAP), sharex=True, sharey=True)
        for axes, name in zip(panels, lean.MAP, strict=True):
            if name in rows:
                _marks(axes, rows[name])
            ends = (-1.04 * lean.MOST, 1.04 * lean.MOST)
            axes.set(title=name if name in rows else f"{name}: not run", aspect="equal", xlim=ends, ylim=ends)
            axes.set_xlabel("yaw of the faces, °")
        panels[0].set_ylabel("pitch of the faces, °")
        handles = [
            panels[0].plot([], [], mark, color=colour, markersize=5, label=what)[0] for what, mark, colour in _KINDS
        ]
        top_legend(figure, handles, 2)


def _marks(axes: Axes, rows: summary.Columns) -> None:
    yaw, pitch = (np.degrees(rows[f"world.target.tilt_{axis}"].astype(float)) for axis in "yx")
    charged, leaning = rows["charged"].astype(bool), rows["code_name"] == "LEANING"
    aligned = rows["aligned"].astype(bool)
    chosen = (charged & aligned, charged & ~aligned, ~charged & leaning, ~charged & ~leaning)
    every = max(1, len(yaw) // _MARKS_MOST)
    size = 4.5 if len(yaw) < 2000 else 2.2
    for kind, (_, mark, colour) in zip(chosen, _KINDS, strict=True):
        index = np.flatnonzero(kind)
        index = index[:: every if mark != "D" else 1]
        axes.plot(yaw[index], pitch[index], mark, color=colour, markersize=size, markeredgewidth=0.0, alpha=0.8)


FORMS = {
    "random": ("ours", BLUE),
    "published": ("paper as printed", PURPLE),
}
"""The forms of Algorithm 1 that dock the same scenes."""
_CODES = {
    "charged": BLUE,
    "CRITICAL_ANGLE": ORANGE,
    "MISALIGNED": PURPLE,
    "ESTIMATE_UNSURE": GREEN,
    "UNREACHABLE": FAINT,
    "LEANING": RED,
    "other": "#9aa5b1",
}
_LEGEND: Any = {"frameon": True, "facecolor": "white", "edgecolor": "none", "framealpha": 0.85, "fontsize": 8}
_DOTS_MOST = 6000  # dots of a cloud


def _angle(results: dict[str, Any], path: Path) -> None:
    rows = results["rows"]
    about = "simulated dockings of `random` by the target's roll; left with 95 % intervals, right ours"
    with picture(path, 11.0, 4.8, "Charged and refused dockings", about) as figure:
        left, right = figure.subplots(1, 2, gridspec_kw={"width_ratios": (1.15, 1.0)})
        names = [name for name in FORMS if name in rows]
        for index, name in enumerate(names):
            label, colour = FORMS[name]
            bins = results["parts"][name]["bins"]
            middle = np.array([0.5 * (each["low"] + each["high"]) for each in bins]) + 0.12 * (index - 0.5)
            share = np.array([100.0 * each["share"] for each in bins])
            ends = np.array([[100.0 * end for end in each["interval"]] for each in bins])
            reach = np.abs(np.stack([share - ends[:, 0], ends[:, 1] - share]))
            left.errorbar(
                middle, share, reach, fmt="o-", markersize=3.5, linewidth=1.3, elinewidth=0.9, color=colour, label=label
            )
        left.axvline(12.07, color=RED, linewidth=1.0, linestyle="--")
        left.text(12.25, 97.0, "zero clearance\nat 12.07°", color=RED, fontsize=8, va="top")
        left.set(title="charged, %", xlim=(0.0, 20.0), ylim=(-3.0, 103.0), xlabel="|roll|, degrees")
        left.legend(fontsize=8, loc="center right")
        _stack(right, rows["random"])


def _stack(axes: Axes, rows: summary.Columns) -> None:
    """Draw the shares of outcomes over integer degrees of |roll|."""
    edges = np.arange(0.0, 21.0)
    middle = 0.5 * (edges[1:] + edges[:-1])
    names = np.where(rows["charged"], "charged", rows["code_name"])
    names = np.where(np.isin(names, list(_CODES)), names, "other")
    total = np.histogram(rows["degrees"], edges)[0]
    base = np.zeros(len(middle))
    for name, colour in _CODES.items():
        count = np.histogram(rows["degrees"][names == name], edges)[0]
        share = 100.0 * count / np.maximum(total, 1)
        if count.any():
            axes.bar(middle, share, 0.92, base, color=colour, label=f"{name}, {int(count.sum())}", zorder=2)
        base += share
    axes.set(title="results, %", xlim=(0.0, 20.0), ylim=(0.0, 100.0), xlabel="|roll|, degrees")
    axes.legend(**_LEGEND, loc="lower right")


def _clearance(results: dict[str, Any], path: Path) -> None:
    rows = results["rows"]
    about = "each dot one simulated docking at its last estimate; true clearance is judged by exact rectangles"
    with picture(path, 11.0, 5.2, "Near zero clearance", about) as figure:
        left, right = figure.subplots(1, 2, sharex=True, sharey=True)
        spoiled = [name for name in ("tails", "understated", "biased") if name in rows]
        _cloud(left, summary.joined(rows, "zero", "edge"), "unchanged estimates")
        _cloud(right, summary.joined(rows, *spoiled), "with added errors: " + (", ".join(spoiled) or "not run"))
        left.set_ylabel("estimated clearance − 3 σ, mm")
        left.legend(**_LEGEND, loc="upper left")


def _cloud(axes: Axes, every: summary.Columns | None, title: str) -> None:
    axes.axhline(0.3, color=INK, linewidth=1.0, linestyle="--")
    axes.text(3.95, 0.36, "docking's limit, 0.3 mm", fontsize=8, ha="right", va="bottom", color=INK)
    axes.axvline(0.0, color=RED, linewidth=1.0, linestyle="--")
    axes.text(-0.06, -4.8, "wrong bars touch", fontsize=8, ha="right", color=RED)
    axes.set(title=title, xlim=(-4.0, 4.0), ylim=(-5.0, 4.0), xlabel="true clearance, mm")
    if every is None:
        return
    x, y = 1000.0 * every["last_clearance"].astype(float), 1000.0 * summary.estimated_clearance(every, 3.0)
    unsafe = every["energised_unsafe"] > 0.0
    kinds = ((~every["charged"] & ~unsafe, ORANGE, "refused"), (every["charged"] & ~unsafe, BLUE, "charged"))
    for chosen, colour, label in kinds:
        index = np.flatnonzero(chosen & np.isfinite(x) & np.isfinite(y))
        shown = index[:: max(1, len(index) // _DOTS_MOST)]
        axes.plot(x[shown], y[shown], ".", markersize=2.2, color=colour, alpha=0.5, label=f"{label}, {len(index)}")
    label = f"live without clearance, {int(unsafe.sum())}"
    axes.plot(x[unsafe], y[unsafe], "X", markersize=8, color=RED, markeredgecolor="white", label=label)
    if unsafe.any():
        axes.legend(**_LEGEND, loc="upper left")


def _alignment(results: dict[str, Any], path: Path) -> None:
    rows = results["rows"]
    about = "charged simulated dockings of `random`; the other forms on the same seeds"
    names = [name for name in FORMS if name in rows]
    with picture(path, 11.0, 4.2, "Moves, time and offsets at rest", about) as figure:
        moves, seconds, rest = figure.subplots(1, 3)
        for index, name in enumerate(names):
            label, colour = FORMS[name]
            charged = rows[name]["charged"]
            count = int(charged.sum())
            share = np.bincount(rows[name]["moves"][charged].astype(int), minlength=16)[:16] / max(count, 1)
            moves.bar(np.arange(16) + 0.4 * (index - 0.5), 100.0 * share, 0.4, color=colour, label=f"{label}, {count}")
            _share_below(seconds, rows[name]["time"][charged].astype(float), colour)
            far = np.maximum(np.abs(rows[name]["final_horizontal"]), np.abs(rows[name]["final_vertical"]))[charged]
            _share_below(rest, 1000.0 * far.astype(float), colour)
        moves.set(title="alignment moves", ylabel="% of the charged", xticks=range(0, 16, 3))
        top_legend(figure, moves.get_legend_handles_labels()[0], 2)
        seconds.set(title="charged by then, %", xlabel="time to charging, s", xlim=(0.0, 60.0))
        rest.set(title="within, %", xlabel="larger of the two offsets at rest, mm", xlim=(0.0, 6.0))
        rest.axvline(2.5, color=RED, linewidth=1.0, linestyle="--")


def _share_below(axes: Axes, values: summary.Array, colour: str) -> None:
    known = np.sort(values[np.isfinite(values)])
    axes.plot(known, 100.0 * np.arange(1, len(known) + 1) / max(len(known), 1), color=colour, linewidth=1.5)
    axes.set_ylim(0.0, 101.0)


def _errors(results: dict[str, Any], path: Path) -> None:
    rows = results["rows"]["random"]
    about = "(estimate − truth) / σ of simulated dockings of `random`; outside ±5 at the ends; black: expected from σ"
    with picture(path, 11.0, 3.9, "Errors of the estimates in units of their σ", about) as figure:
        edges = np.linspace(-5.0, 5.0, 51)
        middle = 0.5 * (edges[1:] + edges[:-1])
        normal = np.exp(-0.5 * middle**2) / np.sqrt(2.0 * np.pi)
        for axes, axis in zip(figure.subplots(1, 3, sharey=True), summary.AXES, strict=True):
            for which, colour in (("first", ORANGE), ("last", BLUE)):
                z = rows[f"{which}_{axis}_error"] / rows[f"{which}_{axis}_stddev"]
                z = np.clip(z[np.isfinite(z)], -4.999, 4.999)
                rms = results["calibration"]["random"][f"{which}_{axis}"]["rms"]
                label = f"{which} estimate, rms {rms:.2f}"
                axes.hist(z, edges, density=True, histtype="step", linewidth=1.5, color=colour, label=label, zorder=2)
            axes.plot(middle, normal, color=INK, linewidth=1.0)
            axes.set(yscale="log", ylim=(1e-4, 12.0), xlabel=f"{axis} error / σ")
            axes.legend(fontsize=8, loc="upper right")


PICTURES = {
    "docking-angle.png": _angle,
    "docking-clearance.png": _clearance,
    "docking-alignment.png": _alignment,
    "docking-errors.png": _errors,
    NAME: outcomes,
}
_NEEDS = {"docking-clearance.png": "edge", NAME: "lean5"}


def without(rows: dict[str, summary.Columns]) -> dict[str, str]:
    """Return the pictures whose campaign is missing, with the reason."""
    needs = {name: _NEEDS.get(name, "random") for name in PICTURES}
    return {name: f"the campaign {needed} was not run" for name, needed in needs.items() if needed not in rows}
