# SPDX-License-Identifier: Apache-2.0
"""Measures the classifiers of misalignment and writes the report: figures as JSON, a page, one HTML file, pictures."""

from __future__ import annotations

import math
import tempfile
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_lab.reports.formats import grouped, percent
from deltacharger_lab.reports.pool import ReportTask, joined, work
from deltacharger_lab.reports.report import Progress, Report, at_least, at_most, none
from deltacharger_lab.reports.tactile import parity, recorded, second, splits
from deltacharger_lab.reports.tactile.ceiling import CEILING, ROWS
from deltacharger_lab.reports.tactile.measure import WINDOWS, judge_rig, timing
from deltacharger_lab.reports.tactile.pictures import PICTURES
from deltacharger_lab.reports.tactile.plan import SETS, TARGETS, TactilePlan, absent, default, kind, title
from deltacharger_lab.reports.tactile.shifts import NONE
from deltacharger_lab.second.parameters import SecondParameters
from deltacharger_lab.training.reliability import NOMINAL
from deltacharger_tactile.parameters import TactileParameters

HOLDS, FIRES, NEITHER = "coverage holds", "drift check fires", "NEITHER"
POINTS = 0.015
"""Allowed error of coverage."""
FALSE_ALARMS = 0.01
PAPER_FIGURES = (
    ("cnn", "angle", 95.46),
    ("cnn", "vertical", 98.2),
    ("cnn", "horizontal", 86.9),
    ("nn", "horizontal", 87.9),
)
"""The paper's accuracies of its networks, %."""
_OFTEN = 0.5  # share of frames or windows from which the drift check counts as firing

Row = dict[str, Any]
_SPLIT_MODELS = ("knn", "forest", "lda", "pose")
_LIBRARIES = ("numpy", "scikit-learn", "xgboost", "xgboost-cpu", "torch", "matplotlib")


def build(plan: TactilePlan, directory: Path, command: str, progress: Progress) -> dict[str, Any]:
    """Measure, write page, HTML, figures and pictures into `directory` and return the figures.

    Raises:
        ModuleNotFoundError: no training library is installed.
        OSError: a file cannot be written.
        KeyboardInterrupt: interrupted; nothing was written.
    """
    if not plan.names:
        raise ModuleNotFoundError("no training library is installed", name="sklearn")
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
    results["targets"] = targets(results, plan)
    return report.write(
        directory,
        TARGETS=TARGETS,
        PAPER_FIGURES=PAPER_FIGURES,
        title=title,
        best=best,
        slowest=slowest,
        ways=splits,
        ceiling_name=CEILING,
        AXES=second.AXES,
        PHYSICS=(second.FIRST, second.SECOND),
    )


def _measure(results: dict[str, Any], plan: TactilePlan, progress: Progress) -> None:
    with tempfile.TemporaryDirectory() as kept:
        found = work(tasks(plan, kept), progress)
        progress("run times, alone")
        times = work([ReportTask("run times", timing, (plan, kept))], progress)["run times"][0]
    rigs = found["rig"]
    raw = {key: joined(each[key] for each in rigs) for key in ("accuracy", "shifts", "diagrams", "second")}
    results["accuracy"] = accuracies(raw["accuracy"], plan.names)
    results["shifts"] = shifts(raw["shifts"])
    results["diagrams"] = diagrams(raw["diagrams"])
    usual = [row for row in results["shifts"] if row["shift"] == NONE.name]
    raw |= {key: joined(found[key]) for key in ("second estimates", "second variants")}
    results["second"] = {
        "digest": SecondParameters().digest(),
        "models": second.table(raw["second"], usual),
        "estimates": second.summed(raw["second estimates"], "threshold", "frames", "physics"),
        "variants": second.summed(raw["second variants"], "variant"),
    }
    results["splits"] = joined(found.get("splits", []))
    results["ceiling"] = mean_rows(joined(found.get("one docking", [])))
    results["parity"] = parity.table(joined(found.get("parity", [])), results["accuracy"])
    results["recorded"] = recorded.table(found.get("recorded", []), raw["accuracy"])
    results["trainers"] = {row["model"]: row for row in times["trainers"]}
    results["times"] = {
        name: {row["target"]: row for row in each} for (name,), each in grouped(times["predictions"], "model")
    }
    results["generation_s"] = times["generation_s"]
    results["raw"] = raw


def tasks(plan: TactilePlan, kept: str) -> list[ReportTask]:
    """Return all work except the run times, which need an idle computer."""
    found = []
    for rig in plan.rigs:
        for seed in plan.seeds:
            first = (rig, seed) == (plan.rigs[0], plan.seeds[0])
            for part in SETS:
                weight = len(SETS[part]) * (1.0 + 0.5 * len(plan.names))
                found.append(ReportTask("rig", judge_rig, (rig, seed, part, plan, kept if first else ""), weight))
    for rig in plan.rigs:
        found.append(ReportTask("second estimates", second.judge_estimates, (rig, plan.seeds[0], plan), 1.0))
    for rig in plan.ceiling_rigs:
        found.append(ReportTask("second variants", second.judge_variants, (rig, plan.seeds[0], plan), 2.0))
    for name in plan.names:
        if name in _SPLIT_MODELS:
            for target in TARGETS:
                found.append(ReportTask("splits", splits.compare, (name, target, plan.split_rigs, plan.seeds[0]), 2.0))
    if default(plan) == "pose":  # all of them need scikit-learn
        found += [ReportTask("parity", parity.compare, (rig, seed), 1.0) for rig in plan.rigs for seed in plan.seeds]
        for rig in plan.ceiling_rigs:
            found.append(ReportTask("recorded", recorded.judge, (rig, plan.seeds[0], plan), 12.0))
            found += [ReportTask("one docking", row, (rig, plan.seeds[0], plan), 3.0) for row in ROWS]
    return found


def accuracies(rows: Iterable[Row], names: Iterable[str]) -> dict[str, dict[str, Row]]:
    """Return mean accuracy with the half width of its 95 % interval (t over rigs; NaN of one), by model and target."""
    found: dict[str, dict[str, Row]] = {name: {} for name in names}
    for (name, target), chosen in grouped(rows, "model", "target"):
        means = [float(np.mean([row["accuracy"] for row in each])) for _, each in grouped(chosen, "rig")]
        fit = float(np.median([row["fit_s"] for row in chosen]))
        found[name][target] = {"mean": float(np.mean(means)), "half": _half(means), "fit_s": fit}
    return found


def _half(values: list[float]) -> float:
    if len(values) < 2:
        return math.nan
    from scipy.stats import t

    return float(t.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / math.sqrt(len(values)))


def shifts(rows: Iterable[Row]) -> list[Row]:
    """Return means over rigs and seeds by model, target and shift, with the verdict."""
    found = []
    for (model, target, shift), members in grouped(rows, "model", "target", "shift"):
        means = {key: float(np.mean([row[key] for row in members])) for key in second.SHARES}
        windows = np.mean([row["windows"] for row in members], axis=0).tolist()
        error = _coverage_error(members)
        holds = means["coverage"] >= NOMINAL - POINTS - error
        fires = max(means["drift_rate"], windows[-1]) > _OFTEN
        verdict = HOLDS if holds else FIRES if fires else NEITHER
        where = {"model": model, "target": target, "shift": shift}
        found.append({**where, **means, "windows": windows, "error": error, "verdict": verdict})
    return found


def _coverage_error(members: list[Row]) -> float:
    """Return two standard errors of the mean coverage; below three members binomial, with calibration's error."""
    if len(members) >= 3:
        return 2.0 * float(np.std([row["coverage"] for row in members], ddof=1)) / math.sqrt(len(members))
    frames = members[0]["n"]
    return 2.0 * math.sqrt(NOMINAL * (1.0 - NOMINAL) * (1.0 + 3.0) / frames / len(members))


def diagrams(rows: Iterable[Row]) -> dict[str, dict[str, Row]]:
    """Return the sums over rigs and seeds, by model and target."""
    found: dict[str, dict[str, Row]] = defaultdict(dict)
    for (model, target), each in grouped(rows, "model", "target"):
        keys = ("count", "sure", "right", "matrix")
        found[model][target] = {key: np.sum([row[key] for row in each], axis=0).tolist() for key in keys}
    return dict(found)


def mean_rows(rows: Iterable[Row]) -> list[Row]:
    """Merge rows of the same name, with the mean of each target."""
    return [
        {**members[0], **{target: float(np.mean([row[target] for row in members])) for target in TARGETS}}
        for _, members in grouped(rows, "name")
    ]


def best(figures: Row) -> str:
    """Return the shallow model with the best accuracy of the angle; '' for none."""
    shallow: list[str] = [name for name in figures["models"] if kind(name) == "shallow"]
    return max(shallow, key=lambda name: figures["accuracy"][name]["angle"]["mean"], default="")


def slowest(figures: Row) -> str:
    """Return the paper's model with the longest prediction of the angle."""
    paper: list[str] = [name for name in figures["models"] if kind(name) != "physical"]
    return max(paper, key=lambda name: figures["times"][name]["angle"]["median_ms"])


def _accuracy_targets(results: Row, name: str) -> list[Row]:
    """Return the targets of the paper's figures (within 1.5 points), and ours at the paper's and our threshold."""
    found = []
    for model, target, published in PAPER_FIGURES:
        if model in results["accuracy"]:
            off = abs(100.0 * results["accuracy"][model][target]["mean"] - published)
            found.append(at_most(f"{title(model)}, {target}, off the paper's {published:g} %", off, 1.5, "points"))
    top: Row = next((row for row in results["ceiling"] if row["name"] == CEILING), {})
    one_newton: Row = next((row for row in results["parity"] if (row["model"], row["threshold"]) == (name, 1.0)), {})
    for target, least, at_one in zip(TARGETS, (98.0, 98.5, 94.0), (97.5, 98.5, 89.0), strict=True):
        ceiling = f" (one docking at best {percent(top.get(target))})"
        own = 100.0 * results["accuracy"][name][target]["mean"]
        found.append(at_least(f"{title(name)}, {target}{ceiling}", own, least, "%"))
        found.append(
            at_least(f"{title(name)} from 1 N on, {target}", 100.0 * one_newton.get(target, math.nan), at_one, "%")
        )
    return found


def _second_targets(found: Row) -> list[Row]:
    """Return the targets of the models on the physics that none has seen."""
    second_rows = [row["second"] for row in found["models"]]
    lost = [row for row in second_rows if row["coverage"] < NOMINAL - POINTS]
    unseen = [row for row in lost if max(row["drift_rate"], row["windows"][-1]) <= _OFTEN]
    missed = len(unseen) if second_rows else math.nan
    z, unsafe = second.worst_z(found["estimates"]), second.unsafe(found["estimates"], found["variants"])
    return [
        none("pretrained estimates, second physics and its families, unsafe acts", unsafe, ""),
        at_most("pretrained estimate, second physics, rms of error over σ, worst axis", z, second.BELIEVED, ""),
        at_most("judged models, second physics, neither covered nor noticed", missed, 0.0, f"of {len(second_rows)}"),
    ]


def targets(results: Row, plan: TactilePlan) -> list[Row]:
    """Return each target with its measured value and verdict."""
    name = default(plan)
    who = title(name)
    calm = [row for row in results["shifts"] if row["model"] == name and row["shift"] == NONE.name]
    others = [row for row in results["shifts"] if row["model"] == name and row["shift"] != NONE.name]
    three = [row[target] for row in results["ceiling"] if row["name"].startswith("3 dockings") for target in TARGETS]
    worst = max((row["coverage"] for row in calm), key=lambda value: abs(value - NOMINAL), default=math.nan)
    alarms = max((max(row["drift_rate"], *row["windows"]) for row in calm), default=math.nan)
    slow = max(results["times"][name][target]["p99_ms"] for target in TARGETS)
    slowest_of_all = max(each[target]["p99_ms"] for each in results["times"].values() for target in TARGETS)
    unseen = [row for row in others if row["verdict"] == NEITHER]
    missed, off = len(unseen) if others else math.nan, 100.0 * abs(worst - NOMINAL)
    return [
        *_accuracy_targets(results, name),
        at_least(f"{who}, three dockings, each target", 100.0 * min(three, default=math.nan), 99.0, "%"),
        at_most(f"{who}, coverage off 95 %, no shift, worst target", off, 100.0 * POINTS, "points"),
        at_most(f"{who}, false drift alarms, frames and windows", 100.0 * alarms, 100.0 * FALSE_ALARMS, "%"),
        at_most(f"{who}, shifts neither covered nor noticed", missed, 0.0, f"of {len(others)}"),
        *_second_targets(results["second"]),
        at_most(f"{who}, one prediction, p99", slow, 0.5, "ms"),
        at_most("slowest model, one prediction, p99", slowest_of_all, 10.0, "ms"),
        at_most("paper-size data set of one rig", results["generation_s"], 1.0, "s"),
        at_most("run time of this report", results["elapsed_s"] / 60.0, 15.0, "min"),
    ]
