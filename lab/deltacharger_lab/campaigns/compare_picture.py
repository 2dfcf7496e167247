# SPDX-License-Identifier: Apache-2.0
"""The picture of a comparison: each difference with its interval on its own scale, and the results of dockings."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from deltacharger_lab.plotting import Axes, picture
from deltacharger_records.plotting import BLUE, FAINT, GREEN, INK, ORANGE, RED

_WIDTH, _HEIGHT = 10.5, 6.4  # inches
_LABELS = {
    "charged": "charged, %",
    "aligned": "aligned, %",
    "time": "time, s",
    "moves": "moves",
    "final_misalignment": "final misalignment, mm",
    "peak_push": "peak push, N",
    "time_above_band": "time above the band, s",
}
_CODES_LEAST, _CODES_MOST = 5, 8


def draw(found: dict[str, Any], path: Path) -> None:
    """Write the picture of what `compare_campaigns` found.

    Raises:
        ImportError: matplotlib is missing.
        OSError: the file cannot be written.
    """
    title = f"{found['pairs']} pairs of simulated dockings: B − A with 95 % intervals"
    about = _shortened("; ".join(found["differs"]) or "the same settings", 150)
    with picture(path, _WIDTH, _HEIGHT, title, about) as figure:
        rows = _rows(found)
        top, bottom = 0.83, 0.09
        height = (top - bottom) / len(rows)
        for index, (label, each, scale) in enumerate(rows):
            axes = figure.add_axes((0.20, top - (index + 0.72) * height, 0.30, 0.40 * height))
            _interval(axes, label, each, scale)
        axes = figure.add_axes((0.72, bottom, 0.25, top - bottom - 0.03))
        _endings(axes, found)
        figure.text(0.04, 0.02, f"A: {found['a']}   B: {found['b']}", fontsize=8, color=FAINT)


def _rows(found: dict[str, Any]) -> list[tuple[str, dict[str, Any], float]]:
    rows = [(_LABELS[name], each, 100.0) for name, each in found["rates"].items()]
    return rows + [
        (_LABELS[name], each, 1e3 if each["unit"] == "m" else 1.0) for name, each in found["numbers"].items()
    ]


def _interval(axes: Axes, label: str, each: dict[str, Any], scale: float) -> None:
    """Draw one difference; blue: its interval contains 0, orange: it does not."""
    low, high = (scale * value for value in each["interval"])
    middle = scale * each["difference"]
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    known = math.isfinite(low) and math.isfinite(high)
    differs = known and (low > 0.0 or high < 0.0)
    colour = ORANGE if differs else BLUE
    text = f"{scale * each['a']:.3g} → {scale * each['b']:.3g}   (n = {each['n']})" if each["n"] else "in no pair"
    axes.text(-0.03, 0.62, label, transform=axes.transAxes, ha="right", va="center", fontsize=9.5, color=INK)
    axes.text(-0.03, 0.0, text, transform=axes.transAxes, ha="right", va="center", fontsize=8, color=FAINT)
    if not known:
        axes.set_xticks([])
        return
    axes.axvline(0.0, color=FAINT, linewidth=1.0, zorder=1)
    axes.plot([low, high], [0.0, 0.0], color=colour, linewidth=3.0, solid_capstyle="butt", zorder=2)
    axes.plot([middle], [0.0], "o", color=colour, markersize=6.5, zorder=3)
    reach = 1.25 * max(abs(low), abs(high), abs(middle)) or 1.0
    axes.set(xlim=(-reach, reach), ylim=(-1.0, 1.0))
    axes.locator_params(axis="x", nbins=5)
    axes.tick_params(labelsize=8, length=2)
    verdict = "B is higher" if differs and low > 0.0 else "B is lower" if differs else "no difference seen"
    axes.text(1.03, 0.5, verdict, transform=axes.transAxes, va="center", fontsize=8, color=colour)


def _endings(axes: Axes, found: dict[str, Any]) -> None:
    """Draw the number of dockings of each campaign by result."""
    count = found["pairs"]
    ended = {"charged": {side: round(found["rates"]["charged"][side] * count) for side in ("a", "b")}}
    refused = sorted(found["refused"].items(), key=lambda item: -sum(item[1].values()))
    ended |= dict(refused[:_CODES_MOST])
    ended["shorts"] = found["shorts"]
    names = list(ended)
    for offset, side, colour in ((-0.19, "a", FAINT), (0.19, "b", GREEN)):
        values = [ended[name][side] for name in names]
        places = [index + offset for index in range(len(names))]
        colours = [RED if name == "shorts" and value else colour for name, value in zip(names, values, strict=True)]
        axes.barh(places, values, 0.34, color=colours, label=side.upper(), zorder=2)
        for place, value in zip(places, values, strict=True):
            axes.text(value, place, f" {value}", va="center", fontsize=8, color=INK)
    axes.set_yticks(range(len(names)), [name.lower().replace("_", " ") for name in names])
    axes.set_ylim(max(len(names), _CODES_LEAST) - 0.5, -0.5)  # the first on top, bars of equal size
    axes.set_xlim(0.0, 1.15 * count)
    axes.set_title("results")
    axes.legend(loc="lower right")


def _shortened(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"
