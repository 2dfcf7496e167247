# SPDX-License-Identifier: Apache-2.0
"""From single measurements to what the page says: means, intervals, verdicts, targets."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable
from typing import Any

import numpy as np

from deltacharger_lab.reports.formats import grouped
from deltacharger_lab.reports.tactile.plan import TARGETS, TactilePlan, default, kind, title
from deltacharger_lab.reports.tactile.shifts import NONE
from deltacharger_lab.reports.targets import at_least, at_most
from deltacharger_tactile.classifiers.reliability import NOMINAL

HOLDS, FIRES, NEITHER = "coverage holds", "drift check fires", "NEITHER"
POINTS = 0.015
"""By which coverage may miss its nominal value."""
FALSE_ALARMS = 0.01
_OFTEN = 0.5  # share of frames or windows from which the drift check counts as firing

Row = dict[str, Any]


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
        means = {
            key: float(np.mean([row[key] for row in members]))
            for key in ("accuracy", "coverage", "act_rate", "drift_rate")
        }
        windows = np.mean([row["windows"] for row in members], axis=0).tolist()
        error = _coverage_error(members)
        holds = means["coverage"] >= NOMINAL - POINTS - error
        fires = max(means["drift_rate"], windows[-1]) > _OFTEN
        verdict = HOLDS if holds else FIRES if fires else NEITHER
        where = {"model": model, "target": target, "shift": shift}
        found.append({**where, **means, "windows": windows, "error": error, "verdict": verdict})
    return found


def _coverage_error(members: list[Row]) -> float:
    """Two standard errors of the mean coverage; of few rigs and seeds from the binomial, calibration included."""
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
    """Return rows of the same name as one, with the mean of each target."""
    return [
        {**members[0], **{target: float(np.mean([row[target] for row in members])) for target in TARGETS}}
        for _, members in grouped(rows, "name")
    ]


def best(figures: Row) -> str:
    """Return the shallow model that tells the angle best; '' without any."""
    shallow: list[str] = [name for name in figures["models"] if kind(name) == "shallow"]
    return max(shallow, key=lambda name: figures["accuracy"][name]["angle"]["mean"], default="")


def slowest(figures: Row) -> str:
    """Return the model of the paper that takes longest to tell the angle."""
    paper: list[str] = [name for name in figures["models"] if kind(name) != "physical"]
    return max(paper, key=lambda name: figures["times"][name]["angle"]["median_ms"])


def targets(results: Row, plan: TactilePlan) -> list[Row]:
    """Return each target with what was measured and whether it is met."""
    name = default(plan)
    who = title(name)
    accuracy = results["accuracy"][name]
    calm = [row for row in results["shifts"] if row["model"] == name and row["shift"] == NONE.name]
    others = [row for row in results["shifts"] if row["model"] == name and row["shift"] != NONE.name]
    three = [row[target] for row in results["ceiling"] if row["name"].startswith("3 dockings") for target in TARGETS]
    worst = max((row["coverage"] for row in calm), key=lambda value: abs(value - NOMINAL), default=math.nan)
    alarms = max((max(row["drift_rate"], *row["windows"]) for row in calm), default=math.nan)
    slow = max(results["times"][name][target]["p99_ms"] for target in TARGETS)
    unseen = [row for row in others if row["verdict"] == NEITHER]
    missed, off = len(unseen) if others else math.nan, 100.0 * abs(worst - NOMINAL)
    return [
        at_least(f"{who}, angle", 100.0 * accuracy["angle"]["mean"], 98.0, "%"),
        at_least(f"{who}, vertical", 100.0 * accuracy["vertical"]["mean"], 98.5, "%"),
        at_least(f"{who}, horizontal", 100.0 * accuracy["horizontal"]["mean"], 92.0, "%"),
        at_least(f"{who}, three dockings, each target", 100.0 * min(three, default=math.nan), 99.0, "%"),
        at_most(f"{who}, coverage off 95 %, no shift, worst target", off, 100.0 * POINTS, "points"),
        at_most(f"{who}, false drift alarms, frames and windows", 100.0 * alarms, 100.0 * FALSE_ALARMS, "%"),
        at_most(f"{who}, shifts neither covered nor noticed", missed, 0.0, f"of {len(others)}"),
        at_most(f"{who}, one prediction, p99", slow, 1.0, "ms"),
        at_most("paper-size data set of one rig", results["generation_s"], 1.0, "s"),
        at_most("whole comparison", results["elapsed_s"] / 60.0, 15.0, "min"),
    ]
