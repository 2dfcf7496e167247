# SPDX-License-Identifier: Apache-2.0
"""What the simulation was to reach, and what it reached."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from deltacharger_lab.reports.simulation.map import DIVERGED
from deltacharger_lab.reports.simulation.scenes import LIGHT

AT = 0.01  # s, the step of the targets


def targets(results: dict[str, Any]) -> list[dict[str, Any]]:
    """Return name, what is wanted, what was measured, its unit and whether it is met, of every target."""
    light = [point for point in results["map"] if point["model"] == LIGHT]
    at = [point for point in light if point["step"] == AT and 1e3 <= point["contact"] <= 1e7 and point["servo"] == 15.0]
    error = next(row for row in results["errors"] if row["model"] == LIGHT and row["step"] == AT)
    speed = next(row for row in results["times"] if row["model"] == LIGHT and row["step"] == AT)
    diverged = sum(point["cell"] == DIVERGED for point in light)
    broken = [row for row in results["extremes"] if row["model"] == LIGHT and not row["ok"]]
    gain = max(100.0 * row["gain"] / row["released"] for row in results["energy"])
    forces = max(point["force_percent"] for point in at)
    rows = (
        ("light model at 10 ms, in motion", "≥ 500", speed["moving"], "× real", speed["moving"] >= 500.0),
        ("light model at 10 ms, position", "≤ 0.15", error["rms_mm"], "mm rms", error["rms_mm"] <= 0.15),
        ("settled force at 10 ms, 1e3–1e7 N/m, worst", "≤ 0.5", forces, "%", forces <= 0.5),
        ("light model, diverged points of the map", "= 0", diverged, f"of {len(light)}", diverged == 0),
        ("light model, extremes whose law is broken", "= 0", len(broken), f"of {_count(results)}", not broken),
        ("passive charger's energy, largest gain", "≤ 1", gain, "%", gain <= 1.0),
        ("order of convergence, free motion", "≥ 1", _order(results), "", _order(results) >= 1.0),
        ("whole report", "≤ 10", results["elapsed_s"] / 60.0, "min", results["elapsed_s"] <= 600.0),
    )
    keys = ("name", "wanted", "measured", "unit", "met")
    return [dict(zip(keys, row, strict=True)) for row in rows]


def _count(results: dict[str, Any]) -> int:
    return sum(row["model"] == LIGHT for row in results["extremes"])


def _order(results: dict[str, Any]) -> float:
    return float(results["convergence"]["swing in free air"]["order"])


def outcomes(rows: Sequence[dict[str, Any]], by: str) -> list[dict[str, Any]]:
    """Return for each model and step, or part, how its whole dockings ended, in their order."""
    found: dict[Any, list[dict[str, Any]]] = {}
    for row in rows:
        found.setdefault((row["model"], row["step"]) if by == "model" else row[by], []).append(row)
    return [{"of": key, "runs": runs} for key, runs in found.items()]


def same(runs: Sequence[dict[str, Any]], as_delivered: Sequence[dict[str, Any]]) -> bool:
    """Return whether dockings ended as others did, by their codes."""
    return [run["code"] for run in runs] == [run["code"] for run in as_delivered]


def mean(runs: Sequence[dict[str, Any]], key: str) -> float:
    """Return the mean over the dockings that charged; NaN where none did."""
    values = [run[key] for run in runs if run.get("code") == "NONE"]
    return sum(values) / len(values) if values else math.nan
