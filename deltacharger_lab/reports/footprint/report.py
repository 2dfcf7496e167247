# SPDX-License-Identifier: Apache-2.0
"""Measures what a charger costs a computer, scene by scene, and writes the report: figures as JSON and a page."""

from __future__ import annotations

import datetime
import importlib.util
import json
import math
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.context import Context

from deltacharger_lab.reports.footprint.measure import measure
from deltacharger_lab.reports.footprint.page import write_page
from deltacharger_lab.reports.footprint.plan import Plan
from deltacharger_lab.reports.footprint.process import LIBRARIES
from deltacharger_lab.reports.footprint.start import ONE, CannotRun
from deltacharger_lab.reports.machine import machine
from deltacharger_ros.outcomes import json_ready

PAGE, FIGURES = "footprint.md", "footprint.json"
BENCH = "bench"
NEVER = ("torch", "sklearn", "cv2", "depthai", "mujoco", "matplotlib")  # in the bench scene


def build(
    plan: Plan, context: Context, directory: Path, command: str, progress: Callable[[str], None]
) -> dict[str, Any]:
    """Measure, write page and figures into `directory`, and return the figures.

    Raises:
        OSError: a file cannot be written.
        KeyboardInterrupt: interrupted; nothing was written.
    """
    started = time.monotonic()
    results: dict[str, Any] = {
        "machine": {**machine(("ros_rclpy", "numpy")), "nice": os.getpriority(os.PRIO_PROCESS, 0)},
        "command": command,
        "date": datetime.date.today().isoformat(),
        "quick": plan.quick,
        "repeats": plan.repeats,
        "rest_s": plan.rest_s,
        "left_out": dict(plan.left_out),
        "installed": [name for name in LIBRARIES if importlib.util.find_spec(name) is not None],
        "absent": {},
        "pictures": [],
        "missing_pictures": {},
    }
    results["rows"] = _measure(plan, context, results["left_out"], progress)
    results["elapsed_s"] = time.monotonic() - started
    results["targets"] = targets(results["rows"])
    (directory / FIGURES).write_text(json.dumps(json_ready(results), indent=1, ensure_ascii=False) + "\n", "utf-8")
    write_page(results, directory / PAGE)
    return results


def _measure(
    plan: Plan, context: Context, left_out: dict[str, str], progress: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Return one row for each scene and way; what does not run is added to `left_out`."""
    runs: dict[tuple[str, str], list[dict[str, Any]]] = {(name, way): [] for name in plan.scenes for way in plan.ways}
    broken: dict[tuple[str, str], str] = {}
    for turn in range(plan.repeats):  # in turns, so that whatever else the computer does meets them all alike
        for name, way in runs:
            if (name, way) in broken:
                continue
            progress(f"{name}, {way}: run {turn + 1} of {plan.repeats}")
            try:
                with tempfile.TemporaryDirectory(prefix="deltacharger-") as folder:
                    runs[name, way].append(measure(plan.scenes[name], way, plan, context, Path(folder)))
            except CannotRun as error:
                broken[name, way] = str(error)
                progress(f"{name}, {way}: {error}")
    for (name, way), why in broken.items():
        left_out[f"{name}, {way}"] = why if not runs[name, way] else f"{why} (after {len(runs[name, way])} runs)"
    return [{"scene": name, "way": way, **summary(each)} for (name, way), each in runs.items() if each]


def summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return [median, lowest, highest] of each figure of several runs, and what else they tell."""
    found: dict[str, Any] = {
        "runs": len(runs),
        "libraries": sorted({each for run in runs for each in run["libraries"]}),
    }
    problems = [run["docking_problem"] for run in runs if run["docking_problem"]]
    found["docking_problem"] = problems[0] if problems else ""
    found["dockings_failed"] = len(problems)
    for key, value in runs[0].items():
        if isinstance(value, int | float):
            values = [run[key] for run in runs if not math.isnan(run[key])] or [math.nan]
            found[key] = [statistics.median(values), min(values), max(values)]
    return found


def targets(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return name, what is wanted, what was measured, its unit and whether it is met, of every target."""
    row = next((row for row in rows if (row["scene"], row["way"]) == (BENCH, ONE)), None)

    def median(key: str) -> float:
        return math.nan if row is None else float(row[key][0])

    loaded = math.nan if row is None else float(len(set(row["libraries"]) & set(NEVER)))
    what = f"{BENCH}, {ONE}"
    found = [
        _target(f"{what}: memory, RSS", "≤ 180", median("rss_mb"), "MB", upper=180.0),
        _target(f"{what}: CPU at rest", "≤ 25", median("rest_percent"), "% of a core", upper=25.0),
        _target(f"{what}: CPU while docking", "≤ 25", median("docking_percent"), "% of a core", upper=25.0),
    ]
    for when in ("rest", "docking"):
        for name, rate in (("tactile_frame", 120.0), ("servo_state", 100.0)):
            at = "at rest" if when == "rest" else "while docking"
            value = median(f"{when}_{name}_hz")
            found.append(_target(f"{what}: {name} {at}", f"≥ {0.99 * rate:g}", value, "Hz", lower=0.99 * rate))
    found.append(_target(f"{what}: says ready", "≤ 5", median("says_ready_s"), "s", upper=5.0))
    found.append(_target(f"{what}: found by a client outside", "≤ 5", median("ready_s"), "s", upper=5.0))
    found.append(_target(f"{what}: of {', '.join(NEVER)}", "= 0", loaded, "loaded", upper=0.0))
    return found


def _target(
    name: str, wanted: str, measured: float, unit: str, upper: float = math.inf, lower: float = -math.inf
) -> dict[str, Any]:
    met = None if math.isnan(measured) else lower <= measured <= upper
    return {"name": name, "wanted": wanted, "measured": measured, "unit": unit, "met": met}
