# SPDX-License-Identifier: Apache-2.0
"""What the simulation was to reach, and what it reached."""

from __future__ import annotations

from typing import Any

from deltacharger_lab.reports.simulation.scenes import LIGHT
from deltacharger_lab.reports.simulation.stability import DIVERGED
from deltacharger_lab.reports.targets import at_least, at_most, none

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
