# SPDX-License-Identifier: Apache-2.0
"""Measures the classifiers of misalignment and writes the report: figures as JSON, a page, one HTML file, pictures."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from deltacharger_lab.reports.formats import grouped
from deltacharger_lab.reports.pool import ReportTask, joined, work
from deltacharger_lab.reports.report import Progress, Report
from deltacharger_lab.reports.tactile import splits, summary
from deltacharger_lab.reports.tactile.ceiling import CEILING, ROWS
from deltacharger_lab.reports.tactile.measure import WINDOWS, judge_rig, timing
from deltacharger_lab.reports.tactile.pictures import PICTURES
from deltacharger_lab.reports.tactile.plan import SETS, TARGETS, TactilePlan, absent, default
from deltacharger_tactile.parameters import TactileParameters

_SPLIT_MODELS = ("knn", "forest", "lda", "pose")
_LIBRARIES = ("numpy", "scikit-learn", "xgboost", "xgboost-cpu", "torch", "matplotlib")


def build(plan: TactilePlan, directory: Path, command: str, progress: Progress) -> dict[str, Any]:
    """Measure, write page, HTML, figures and pictures into `directory` and return the figures.

    Raises:
        ModuleNotFoundError: no library that trains is installed.
        OSError: a file cannot be written.
        KeyboardInterrupt: interrupted; nothing was written.
    """
    if not plan.names:
        raise ModuleNotFoundError("nothing that trains is installed", name="sklearn")
    report = Report("tactile", command, _LIBRARIES, html=True)
    results = report.results
    results |= {
        "simulated": True,
        "digest": TactileParameters().digest(),
        "rigs": list(plan.rigs),
        "seeds": list(plan.seeds),
        "quick": plan.quick,
        "windows": list(WINDOWS),
        "models": list(plan.names),
        "judged": list(plan.judged),
        "default": default(plan),
        "absent": absent(),
    }
    _measure(results, plan, progress)
    progress("pictures")
    report.draw(PICTURES, directory)
    results["targets"] = summary.targets(results, plan)
    return report.write(directory, view=summary, ways=splits, ceiling_name=CEILING)


def _measure(results: dict[str, Any], plan: TactilePlan, progress: Progress) -> None:
    with tempfile.TemporaryDirectory() as kept:
        found = work(tasks(plan, kept), progress)
        progress("run times, alone")
        times = work([ReportTask("run times", timing, (plan, kept))], progress)["run times"][0]
    rigs = found["rig"]
    raw = {key: joined(each[key] for each in rigs) for key in ("accuracy", "shifts", "diagrams")}
    results["accuracy"] = summary.accuracies(raw["accuracy"], plan.names)
    results["shifts"] = summary.shifts(raw["shifts"])
    results["diagrams"] = summary.diagrams(raw["diagrams"])
    results["splits"] = joined(found.get("splits", []))
    results["ceiling"] = summary.mean_rows(joined(found.get("one docking", [])))
    results["times"] = {
        name: {row["target"]: row for row in each} for (name,), each in grouped(times["predictions"], "model")
    }
    results["generation_s"] = times["generation_s"]
    results["raw"] = raw


def tasks(plan: TactilePlan, kept: str) -> list[ReportTask]:
    """Return all work but the run times, which must be alone."""
    found = []
    for rig in plan.rigs:
        for seed in plan.seeds:
            first = (rig, seed) == (plan.rigs[0], plan.seeds[0])
            for part in SETS:
                weight = len(SETS[part]) * (1.0 + 0.5 * len(plan.names))
                found.append(ReportTask("rig", judge_rig, (rig, seed, part, plan, kept if first else ""), weight))
    for name in plan.names:
        if name in _SPLIT_MODELS:
            for target in TARGETS:
                found.append(ReportTask("splits", splits.compare, (name, target, plan.split_rigs, plan.seeds[0]), 2.0))
    if default(plan) == "pose":  # all of them need scikit-learn
        for rig in plan.ceiling_rigs:
            found += [ReportTask("one docking", row, (rig, plan.seeds[0], plan), 3.0) for row in ROWS]
    return found
