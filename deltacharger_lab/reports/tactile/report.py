# SPDX-License-Identifier: Apache-2.0
"""Measures the classifiers of misalignment and writes the report: figures as JSON, a page, one HTML file, pictures."""

from __future__ import annotations

import datetime
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from deltacharger_lab.reports.html import write_html
from deltacharger_lab.reports.machine import machine
from deltacharger_lab.reports.pool import Task, joined, work
from deltacharger_lab.reports.tactile import plan as tactile_plan
from deltacharger_lab.reports.tactile import splits as tactile_splits
from deltacharger_lab.reports.tactile import summary as tactile_summary
from deltacharger_lab.reports.tactile.ceiling import ROWS
from deltacharger_lab.reports.tactile.measure import WINDOWS, judge_rig
from deltacharger_lab.reports.tactile.page import write_page
from deltacharger_lab.reports.tactile.pictures import draw_all
from deltacharger_lab.reports.tactile.plan import SETS, TARGETS, Plan
from deltacharger_lab.reports.tactile.timing import timing
from deltacharger_ros.outcomes import json_ready
from deltacharger_tactile.parameters import TactileParameters

PAGE, FIGURES, HTML = "tactile.md", "tactile.json", "tactile.html"
_SPLIT_MODELS = ("knn", "forest", "lda", "pose")
_LIBRARIES = ("numpy", "scikit-learn", "xgboost", "xgboost-cpu", "torch", "matplotlib")


def build(plan: Plan, directory: Path, command: str, progress: Callable[[str], None]) -> dict[str, Any]:
    """Measure, write page, HTML, figures and pictures into `directory` and return the figures.

    Raises:
        ModuleNotFoundError: no library that trains is installed.
        OSError: a file cannot be written.
        KeyboardInterrupt: interrupted; nothing was written.
    """
    if not plan.names:
        raise ModuleNotFoundError("nothing that trains is installed", name="sklearn")
    started = time.monotonic()
    results: dict[str, Any] = {
        "simulated": True,
        "digest": TactileParameters().digest(),
        "machine": machine(_LIBRARIES),
        "command": command,
        "date": datetime.date.today().isoformat(),
        "rigs": list(plan.rigs),
        "seeds": list(plan.seeds),
        "quick": plan.quick,
        "windows": list(WINDOWS),
        "models": list(plan.names),
        "judged": list(plan.judged),
        "default": tactile_plan.default(plan),
        "absent": tactile_plan.absent(),
    }
    _measure(results, plan, progress)
    progress("pictures")
    results["pictures"], results["missing_pictures"] = draw_all(results, directory)
    results["elapsed_s"] = time.monotonic() - started
    results["targets"] = tactile_summary.targets(results, plan)
    (directory / FIGURES).write_text(json.dumps(json_ready(results), indent=1, ensure_ascii=False) + "\n", "utf-8")
    write_page(results, directory / PAGE)
    write_html(directory / PAGE, results["pictures"], directory / HTML)
    return results


def _measure(results: dict[str, Any], plan: Plan, progress: Callable[[str], None]) -> None:
    with tempfile.TemporaryDirectory() as kept:
        found = work(tasks(plan, kept), progress)
        progress("run times, alone")
        times = work([Task("run times", timing, (plan, kept))], progress)["run times"][0]
    rigs = found["rig"]
    raw = {key: joined(each[key] for each in rigs) for key in ("accuracy", "shifts", "diagrams")}
    results["accuracy"] = tactile_summary.accuracies(raw["accuracy"], plan.names)
    results["shifts"] = tactile_summary.shifts(raw["shifts"])
    results["diagrams"] = tactile_summary.diagrams(raw["diagrams"])
    results["splits"] = joined(found.get("splits", []))
    results["ceiling"] = tactile_summary.mean_rows(joined(found.get("one docking", [])))
    results["times"] = tactile_summary.by_model(times["predictions"])
    results["generation_s"] = times["generation_s"]
    results["raw"] = raw


def tasks(plan: Plan, kept: str) -> list[Task]:
    """Return all work but the run times, which must be alone."""
    found = []
    for rig in plan.rigs:
        for seed in plan.seeds:
            first = (rig, seed) == (plan.rigs[0], plan.seeds[0])
            for part in SETS:
                weight = len(SETS[part]) * (1.0 + 0.5 * len(plan.names))
                found.append(Task("rig", judge_rig, (rig, seed, part, plan, kept if first else ""), weight))
    for name in plan.names:
        if name in _SPLIT_MODELS:
            for target in TARGETS:
                found.append(
                    Task("splits", tactile_splits.compare, (name, target, plan.split_rigs, plan.seeds[0]), 2.0)
                )
    if tactile_plan.default(plan) == "pose":  # all of them need scikit-learn
        for rig in plan.ceiling_rigs:
            found += [Task("one docking", row, (rig, plan.seeds[0], plan), 3.0) for row in ROWS]
    return found
