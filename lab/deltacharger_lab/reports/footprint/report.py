# SPDX-License-Identifier: Apache-2.0
"""Measures the computing resources of a charger, scene by scene, and writes the report: figures as JSON and a page."""

import math
import os
import statistics
import tempfile
from pathlib import Path
from typing import Any

from rclpy.context import Context

from deltacharger_lab.reports.footprint.measure import ONE, CannotRun, FootprintPlan, measure
from deltacharger_lab.reports.report import Progress, Report, at_least, at_most

BENCH = "bench"


def build(plan: FootprintPlan, context: Context, directory: Path, command: str, progress: Progress) -> dict[str, Any]:
    """Measure, write page and figures into `directory`, and return the figures.

    Raises:
        OSError: a file cannot be written.
        KeyboardInterrupt: interrupted; nothing was written.
    """
    report = Report("footprint", command, ("ros_rclpy", "numpy"))
    results = report.results
    results["machine"]["nice"] = os.getpriority(os.PRIO_PROCESS, 0)
    results |= {
        "quick": plan.quick,
        "repeats": plan.repeats,
        "rest_s": plan.rest_s,
        "left_out": dict(plan.left_out),
    }
    results["rows"] = _measure(plan, context, results["left_out"], progress)
    results["targets"] = targets(results["rows"])
    report.draw({}, directory)
    return report.write(directory)


def _measure(
    plan: FootprintPlan, context: Context, left_out: dict[str, str], progress: Progress
) -> list[dict[str, Any]]:
    """Return one row for each scene and way; those that do not run are added to `left_out`."""
    runs: dict[tuple[str, str], list[dict[str, Any]]] = {(name, way): [] for name in plan.scenes for way in plan.ways}
    broken: dict[tuple[str, str], str] = {}
    for turn in range(plan.repeats):  # in turns, so that other work of the computer affects all equally
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
    """Return [median, lowest, highest] of each figure of several runs, with problems."""
    found: dict[str, Any] = {"runs": len(runs)}
    problems = [run["docking_problem"] for run in runs if run["docking_problem"]]
    found["docking_problem"] = problems[0] if problems else ""
    found["dockings_failed"] = len(problems)
    for key, value in runs[0].items():
        if isinstance(value, int | float):
            values = [run[key] for run in runs if not math.isnan(run[key])] or [math.nan]
            found[key] = [statistics.median(values), min(values), max(values)]
    return found


def targets(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return every target with its measured value and verdict."""
    row = next((row for row in rows if (row["scene"], row["way"]) == (BENCH, ONE)), None)

    def median(key: str) -> float:
        return math.nan if row is None else float(row[key][0])

    what = f"{BENCH}, {ONE}"
    found = [
        at_most(f"{what}: memory, RSS", median("rss_mb"), 180.0, "MB"),
        at_most(f"{what}: CPU at rest", median("rest_percent"), 25.0, "% of a core"),
        at_most(f"{what}: CPU while docking", median("docking_percent"), 25.0, "% of a core"),
    ]
    for when, at in (("rest", "at rest"), ("docking", "while docking")):
        for name, rate in (("tactile_frame", 120.0), ("servo_state", 100.0)):
            found.append(at_least(f"{what}: {name} {at}", median(f"{when}_{name}_hz"), 0.99 * rate, "Hz"))
    found.append(at_most(f"{what}: reports ready", median("reports_ready_s"), 5.0, "s"))
    found.append(at_most(f"{what}: found by a client outside", median("ready_s"), 5.0, "s"))
    return found
