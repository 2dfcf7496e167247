# SPDX-License-Identifier: Apache-2.0
"""The docking report's page, second half: safety, load, alignment, errors of the estimates, quick against exact."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from deltacharger_lab.reports.docking import summary
from deltacharger_lab.reports.docking.pictures import FORMS, NAMES
from deltacharger_lab.reports.docking.text import share, show, three
from deltacharger_lab.reports.page_text import prose, table

_SPOILED = ("edge", "gaussian", "tails", "understated", "biased")
_SAFE = ("random", "upright", "edge", "zero", "soft", "seen", "tilted", *_SPOILED[1:], "paper", "classes", "published")


def safety(results: dict[str, Any]) -> Iterator[str]:
    """Yield the section: what never happens, with the bound that this proves."""
    yield "## Safety"
    parts = results["parts"]
    yield prose(
        """Live without clearance: the contactor was closed while exact rectangles overlapped a wrong bar, for however
        short. The bound is the exact one-sided 95 % bound of the rate (Clopper–Pearson): with no event in N dockings
        the rate is below 3/N, so 20 000 without one prove less than 1.5 in 10 000, **not** that it never happens.
        Docking goes on charging for 3 s after it has reported success, and these count."""
    )
    rows = []
    for name in dict.fromkeys(_SAFE):
        if name in parts:
            each = parts[name]
            unsafe = each["unsafe"]
            ended = ", ".join(f"{code} {count}" for code, count in each["ended"].items()) or "–"
            rows.append(
                (
                    name,
                    str(each["n"]),
                    str(each["live"]),
                    str(unsafe["hits"]),
                    f"{unsafe['bound']:.1e}",
                    f"{each['unsafe_s']:.2f}",
                    str(each["shorts"]),
                    str(each["parted_live"]),
                    ended,
                )
            )
    yield table(
        (
            "campaign",
            "dockings",
            "live at all",
            "live without clearance",
            "rate, at most",
            "s",
            "shorts",
            "parted live",
            "ended within 3 s",
        ),
        rows,
    )
    yield prose(
        """`gaussian` and `tails` replace the estimator's errors by ones drawn from its own standard deviations:
        normal, and Student's t with three degrees of freedom scaled to the same variance. `understated` keeps its
        errors and tells two thirds of σ; `biased` shifts each estimate by 0.5 mm in x and in y, each way as often. All
        on targets rolled by 8–11°, where it matters most."""
    )


def zero(results: dict[str, Any]) -> Iterator[str]:
    """Yield the section: how dockings ended whose true clearance was small."""
    found = results["near_zero"]
    if not found:
        return
    yield "## Near zero clearance"
    yield table(
        ("true clearance at the last estimate, mm", "dockings", "charged"),
        [
            (f"{_edge(each['low'])} to {_edge(each['high'])}", str(each["n"]), str(each["hits"]))
            for each in found["bins"]
            if each["n"]
        ],
    )
    yield f"`zero` and `edge` together; {found['unknown']} dockings had no estimate in contact."
    yield show(results, NAMES[1])


def _edge(value: float) -> str:
    return "…" if math.isinf(value) else f"{value:g}"


def load(results: dict[str, Any]) -> Iterator[str]:
    """Yield the section: what servos and target bear."""
    yield "## Load on servos and target"
    rows = []
    for name in ("random", "upright", "edge", "soft", "tilted", "paper"):
        if name in results["parts"]:
            each = results["parts"][name]
            rows.append(
                (
                    name,
                    share(each["in_band"]),
                    three(each["rest_current"], 3),
                    three(each["hottest"], 3),
                    three(each["push"], 1),
                )
            )
    head = ("campaign", "at rest in 0.4–0.5 A, %", "contact current, A", "hottest servo, A", "largest push, N")
    yield table(head, rows)
    yield prose(
        """Median, 99 % and the largest. Contact current and servos: medians over the last of three seconds of
        charging, as the servos tell them. Push: the servos' force on the target along z, magnets apart, the largest of
        the whole docking."""
    )
    yield show(results, NAMES[2])


def alignment(results: dict[str, Any]) -> Iterator[str]:
    """Yield the section: moves, time and where the electrodes rest."""
    yield "## Moves, time, and where the electrodes rest"
    rows = []
    for name in ("random", "upright", "edge", "soft", *list(FORMS)[1:]):
        if name in results["parts"]:
            each = results["parts"][name]
            rest = {key: 1000.0 * value for key, value in each["misalignment"].items()}
            rows.append(
                (
                    name,
                    three(each["moves"], 0),
                    three(each["time"], 1),
                    three(each["time_refused"], 1),
                    three(rest, 2),
                )
            )
    yield table(("campaign", "moves", "s to charging", "s to a refusal", "beside the target's centre, mm"), rows)
    yield "Median, 99 % and the largest."
    yield show(results, NAMES[3])


def errors(results: dict[str, Any]) -> Iterator[str]:
    """Yield the section: errors of the estimates beside their standard deviations."""
    yield "## Errors of the estimates"
    rows = []
    for name, found in results["calibration"].items():
        for which in ("first", "last"):
            cells = []
            for axis in summary.AXES:
                each = found[f"{which}_{axis}"]
                scale, unit = (math.degrees(1.0), "°") if axis == "angle" else (1000.0, " mm")
                cells.append(f"{scale * each['error_rms']:.2f}{unit}; {each['rms']:.2f}, {each['max']:.1f}")
            rows.append((name, which, str(found[f"{which}_angle"]["n"]), *cells))
    yield table(("campaign", "estimate", "n", "horizontal", "vertical", "angle"), rows)
    yield prose(
        """Rms error; rms of error / σ, which is 1 where σ is right and less where it is cautious; and the largest. The
        last estimate is the one that decided."""
    )
    yield show(results, NAMES[4])


def engine(results: dict[str, Any]) -> Iterator[str]:
    """Yield the section: what the quick computation changes."""
    for pair in results["pairs"]:
        if "exact" in pair["names"]:
            yield "## What the quick computation changes"
            yield prose(
                """Campaigns compute less than the nodes do (docs/campaigns.md). The same dockings with every tick and
                every tactile frame:"""
            )
            yield table(
                ("figure", "exact", "quick", "difference", "95 %"),
                [_compared(name, each) for kind in ("rates", "numbers") for name, each in pair[kind].items()],
            )
            codes = ", ".join(f"{name} {each['a']} → {each['b']}" for name, each in pair["refused"].items())
            yield f"{pair['pairs']} pairs; refused {codes or 'none'}."


def _compared(name: str, each: dict[str, Any]) -> tuple[str, ...]:
    scale = 100.0 if "p" in each else 1000.0 if each.get("unit") == "m" else 1.0
    unit = "%" if "p" in each else "mm" if each.get("unit") == "m" else each.get("unit", "")
    low, high = each["interval"]
    figures = (each["a"], each["b"], each["difference"])
    return (
        f"{name}, {unit}".rstrip(", "),
        *(f"{scale * value:.2f}" for value in figures),
        f"{scale * low:.2f} to {scale * high:.2f}",
    )
