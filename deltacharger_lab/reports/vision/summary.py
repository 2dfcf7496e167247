# SPDX-License-Identifier: Apache-2.0
"""From single images to what the page says: shares, medians, percentiles, targets."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_lab.reports.targets import at_least, at_most
from deltacharger_lab.reports.vision import conditions, mount
from deltacharger_lab.reports.vision.conditions import ALARMS, BAND, BY_RANGE, HIDDEN, members
from deltacharger_lab.reports.vision.measure import FIELDS

Row = dict[str, Any]


def gathered(parts: Iterable[tuple[str, list[list[float]]]]) -> dict[str, list[list[float]]]:
    """Return the images of each row together."""
    found: dict[str, list[list[float]]] = {}
    for name, rows in parts:
        found.setdefault(name, []).extend(rows)
    return found


def row(images: Sequence[Sequence[float]]) -> Row:
    """Return what images (N, FIELDS) of one kind come to; found are the detections that are right."""
    table = np.array(images, dtype=float).reshape(-1, len(FIELDS))
    right = table[(table[:, 1] > 0.0) & (table[:, 2] == 0.0)]
    column = {name: right[:, index] for index, name in enumerate(FIELDS)}
    return {
        "images": len(table),
        "found": len(right),
        "wrong": int(table[:, 2].sum()),
        **{f"{name}_p{share}": _quantile(column[name], share) for name in FIELDS[3:6] for share in (50, 95)},
        "nees": float(np.mean(column["nees"])) if len(right) else math.nan,
        "tilt_deg_p95": _quantile(column["tilt_deg"], 95),
    }


def mount_row(images: Sequence[Sequence[float]]) -> Row:
    """Return what images (N, mount.FIELDS) of one level come to."""
    table = np.array(images, dtype=float).reshape(-1, len(mount.FIELDS))
    right = table[table[:, 1] > 0.0]
    found: Row = {"images": len(table), "found": len(right)}
    for index, name in enumerate(mount.FIELDS[2:7], start=2):
        found |= {f"{name}_p{share}": _quantile(right[:, index], share) for share in (50, 95)}
    return {**found, "nees": float(np.mean(right[:, 7])) if len(right) else math.nan}


def band(images: dict[str, list[list[float]]]) -> list[list[float]]:
    """Return the images at all ranges that the targets speak of."""
    near = [conditions.key(each) for each in members(BY_RANGE) if BAND[0] <= each.away <= BAND[1]]
    return [image for name in near for image in images[name]]


def targets(results: Row) -> list[Row]:
    """Return what the detector should reach beside what it does."""
    whole, rows = results["band"], results["rows"]
    half, alarms = rows[f"{HIDDEN}: {conditions.HALF_HIDDEN}"], rows[f"{ALARMS}: {conditions.CLUTTER}"]
    near = [conditions.key(each) for each in members(BY_RANGE) if BAND[0] <= each.away <= BAND[1]]
    slowest = max(results["times"][name]["median_ms"] for name in near)
    where = f"{BAND[0]:g}–{BAND[1]:g} m"
    return [
        at_least(f"{where}, electrodes found", 100.0 * whole["found"] / whole["images"], 99.0, "%"),
        at_most(f"{where}, wrong", 100.0 * whole["wrong"] / whole["images"], 0.2, "%"),
        at_most(f"{where}, error across, 95 %", whole["xy_mm_p95"], 1.0, "mm"),
        at_most(f"{where}, error of range, 95 %", whole["z_mm_p95"], 2.0, "mm"),
        at_most(f"{where}, error of roll, 95 %", whole["roll_deg_p95"], 1.0, "°"),
        at_least("half of one bar hidden, found", 100.0 * half["found"] / half["images"], 85.0, "%"),
        at_most("one frame on one core, slowest range, median", slowest, 15.0, "ms"),
        at_most("false alarms in clutter, with depth", alarms["wrong"], 0.0, f"of {alarms['images']}"),
    ]


def _quantile(values: NDArray[np.float64], percent: float) -> float:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, percent)) if len(known) else math.nan
