# SPDX-License-Identifier: Apache-2.0
"""What the simulation was to reach and what it reached, and what its page says of several runs together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from deltacharger_lab.reports.formats import fixed
from deltacharger_lab.reports.simulation.scenes import LIGHT
from deltacharger_lab.reports.simulation.stability import DIVERGED
from deltacharger_lab.reports.targets import at_least, at_most, none

Row = dict[str, Any]
AT = 0.01  # s, the step of the targets


def targets(results: Row) -> list[Row]:
    """Return name, what is wanted, what was measured, its unit and whether it is met, of every target."""
    light = [point for point in results["map"] if point["model"] == LIGHT]
    at = [point for point in light if point["step"] == AT and 1e3 <= point["contact"] <= 1e7 and point["servo"] == 15.0]
    error = next(row for row in results["errors"] if row["model"] == LIGHT and row["step"] == AT)
    speed = next(row for row in results["times"] if row["model"] == LIGHT and row["step"] == AT)
    diverged = sum(point["cell"] == DIVERGED for point in light)
    broken = [row for row in results["extremes"] if row["model"] == LIGHT and not row["ok"]]
    gain = max(100.0 * row["gain"] / row["released"] for row in results["energy"])
    forces = max(point["force_percent"] for point in at)
    kept = f"of {sum(row['model'] == LIGHT for row in results['extremes'])}"
    order = results["convergence"]["swing in free air"]["order"]
    return [
        at_least("light model at 10 ms, in motion", speed["moving"], 500.0, "× real"),
        at_most("light model at 10 ms, position", error["rms_mm"], 0.15, "mm rms"),
        at_most("settled force at 10 ms, 1e3–1e7 N/m, worst", forces, 0.5, "%"),
        none("light model, diverged points of the map", diverged, f"of {len(light)}"),
        none("light model, extremes whose law is broken", len(broken), kept),
        at_most("passive charger's energy, largest gain", gain, 1.0, "%"),
        at_least("order of convergence, free motion", order, 1.0, ""),
        at_most("whole report", results["elapsed_s"] / 60.0, 10.0, "min"),
    ]


def is_calm(row: Row) -> bool:
    """Return whether a run neither diverged nor moves at its end."""
    return row["rms_mm"] is not None and row["speed"] is not None and row["speed"] < 1e-3


def settled(errors: Iterable[Row]) -> list[float]:
    """Return the forces (N) at which runs with friction came to rest, at steps up to 10 ms."""
    return [row["force_rubbing"] for row in errors if is_calm(row) and row["step"] <= 0.01 if row["force_rubbing"] > 0]


def ends(runs: Sequence[Row]) -> list[str]:
    """Return codes, and means over the dockings that charged: time (s), contact current (A), misalignment (mm)."""
    codes = ", ".join("charged" if run["code"] == "NONE" else run["code"] for run in runs)
    charged = [run for run in runs if run["code"] == "NONE"]
    columns = (("elapsed", 1), ("current", 3), ("rest_mm", 2))
    return [codes, *(fixed(_mean([run[key] for run in charged]), digits) for key, digits in columns)]


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None
