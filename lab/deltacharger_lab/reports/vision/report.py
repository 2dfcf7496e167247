# SPDX-License-Identifier: Apache-2.0
"""Measures the electrode detector on simulated images and writes the report: figures as JSON, a page, pictures."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_lab.campaigns.summary import quantiles, upper_bound
from deltacharger_lab.reports.pool import work
from deltacharger_lab.reports.report import Progress, Report, at_least, at_most
from deltacharger_lab.reports.vision import conditions
from deltacharger_lab.reports.vision.conditions import (
    ALARMS,
    BAND,
    BIASED,
    BY_RANGE,
    CLEAR,
    HIDDEN,
    OBSTRUCTED,
    PIXELS,
    members,
)
from deltacharger_lab.reports.vision.measure import FIELDS, MOUNT_FIELDS
from deltacharger_lab.reports.vision.pictures import PICTURES
from deltacharger_lab.reports.vision.plan import VisionPlan

_NORMAL_95 = 1.96
_CHI_SQUARE_95 = 7.815  # of three degrees of freedom
_LIBRARIES = ("numpy", "opencv-python-headless", "opencv-python", "mujoco", "matplotlib")


def build(plan: VisionPlan, directory: Path, command: str, progress: Progress) -> dict[str, Any]:
    """Measure, write page, HTML, figures and pictures into `directory` and return the figures.

    Raises:
        ModuleNotFoundError: OpenCV is missing.
        OSError: a file cannot be written.
        KeyboardInterrupt: interrupted; nothing was written.
    """
    if "opencv" in plan.absent:
        raise ModuleNotFoundError(plan.absent["opencv"], name="cv2")
    report = Report("vision", command, _LIBRARIES, html=True)
    results = report.results
    results |= {
        "simulated": True,
        "seed": plan.seed,
        "first_seed": plan.first_seed,
        "images": plan.images,
        "quick": plan.quick,
        "absent": plan.absent,
    }
    _measure(results, plan, progress)
    progress("pictures")
    report.draw(PICTURES, directory)
    results["targets"] = targets(results)
    return report.write(directory, None, view=conditions, upper_bound=upper_bound)


def _measure(results: dict[str, Any], plan: VisionPlan, progress: Progress) -> None:
    found = work(plan.tasks(), progress)
    progress("run times, alone")
    results["times"] = work([plan.timing()], progress)["run times"][0]
    images, mounts = gathered(found["images"]), gathered(found["mount"])
    results["rows"] = {name: row(each) for name, each in images.items()}
    results["band"] = row(band(images))
    for group in (OBSTRUCTED, CLEAR, BIASED, PIXELS):
        parts = [images[conditions.key(each)] for each in members(group) if conditions.key(each) in images]
        results[group] = row([image for part in parts for image in part])
    results["mount"] = {name: row(each, MOUNT_FIELDS) for name, each in mounts.items()}
    results["raw"] = {"fields": FIELDS, "images": images, "mount_fields": MOUNT_FIELDS, "mount": mounts}


def gathered(parts: Iterable[tuple[str, list[list[float]]]]) -> dict[str, list[list[float]]]:
    """Return the images of each row together."""
    found: dict[str, list[list[float]]] = {}
    for name, rows in parts:
        found.setdefault(name, []).extend(rows)
    return found


def row(images: Sequence[Sequence[float]], fields: Sequence[str] = FIELDS) -> dict[str, Any]:
    """Return the summary of images (N, fields) of one kind; `found` counts right detections."""
    table = np.array(images, dtype=float).reshape(-1, len(fields))
    column = dict(zip(fields, table.T, strict=True))
    right = column["found"] > 0.0
    found: dict[str, Any] = {"images": len(table)}
    if "wrong" in column:
        right &= column["wrong"] == 0.0
        found["wrong"] = int(column["wrong"].sum())
        found["sure"] = int(column["sure"].sum())
        found["sure_held"] = float(np.mean(column["nees"][right] <= _CHI_SQUARE_95)) if right.any() else math.nan
    found["found"] = int(right.sum())
    for name in ("yaw", "pitch"):
        degrees, sigmas = (column[f"{name}_{each}"][right] for each in ("deg", "sigma"))
        found |= {f"{name}_rms": _rms(degrees), f"{name}_sigma_rms": _rms(sigmas), f"{name}_held": _held(sigmas)}
    found["leans"] = int(np.isfinite(column["yaw_deg"][right]).sum())
    for name in (each for each in fields if each.endswith(("_mm", "_deg"))):
        found[f"{name}_p50"], found[f"{name}_p95"] = quantiles(column[name][right], 0.5, 0.95)
    return {**found, "nees": float(np.mean(column["nees"][right])) if right.any() else math.nan}


def _rms(values: Array) -> float:
    """Return the root mean square of the known values, NaN for none."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else math.nan


def _held(sigmas: Array) -> float:
    """Return the share of errors, in standard deviations, within the 95 % interval."""
    known = sigmas[np.isfinite(sigmas)]
    return float(np.mean(np.abs(known) <= _NORMAL_95)) if len(known) else math.nan


def band(images: dict[str, list[list[float]]]) -> list[list[float]]:
    """Return the images at all ranges of the targets."""
    return [image for name in _near() for image in images[name]]


def _near() -> list[str]:
    return [conditions.key(each) for each in members(BY_RANGE) if BAND[0] <= each.away <= BAND[1]]


def targets(results: dict[str, Any]) -> list[dict[str, Any]]:
    """Return each target with its measured value and verdict."""
    band_row, rows = results["band"], results["rows"]
    half, alarms = rows[f"{HIDDEN}: {conditions.HALF_HIDDEN}"], rows[f"{ALARMS}: {conditions.CLUTTER}"]
    hidden, clear = results[OBSTRUCTED], results[CLEAR]
    slowest = max(results["times"][name]["median_ms"] for name in _near())
    where = f"{BAND[0]:g}–{BAND[1]:g} m"
    return [
        at_least(f"{where}, electrodes found", 100.0 * band_row["found"] / band_row["images"], 99.0, "%"),
        at_most(f"{where}, wrong", 100.0 * band_row["wrong"] / band_row["images"], 0.2, "%"),
        at_most(f"{where}, error across, 95 %", band_row["xy_mm_p95"], 0.5, "mm"),
        at_most(f"{where}, error of range, 95 %", band_row["z_mm_p95"], 2.0, "mm"),
        at_most(f"{where}, error of roll, 95 %", band_row["roll_deg_p95"], 1.0, "°"),
        at_least("half of one bar hidden, found", 100.0 * half["found"] / half["images"], 85.0, "%"),
        at_most("one frame on one core, slowest range, median", slowest, 15.0, "ms"),
        at_least("something before the bars, found", 100.0 * hidden["found"] / hidden["images"], 60.0, "%"),
        at_most("something before the bars, wrong and sure", hidden["sure"], 0.0, f"of {hidden['images']}"),
        at_least("nothing before the bars, 0.15–1 m, found", 100.0 * clear["found"] / clear["images"], 99.0, "%"),
        at_most("nothing before the bars, wrong and sure", clear["sure"], 0.0, f"of {clear['images']}"),
        *(
            at_most(f"{name}, wrong and sure", results[group]["sure"], 0.0, f"of {results[group]['images']}")
            for name, group in (("depth off by up to 2 %", BIASED), ("unaligned, cut, binned or scaled", PIXELS))
        ),
        at_most("false alarms in clutter, with depth", alarms["wrong"], 0.0, f"of {alarms['images']}"),
    ]
