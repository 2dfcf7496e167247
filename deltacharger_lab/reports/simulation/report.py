# SPDX-License-Identifier: Apache-2.0
"""Measures the simulated charger's mechanics and writes the report: figures as JSON, a page, pictures, the package's
map."""

from __future__ import annotations

import datetime
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from deltacharger_lab.reports.machine import machine
from deltacharger_lab.reports.pool import Task, joined, work
from deltacharger_lab.reports.simulation import (
    energy as simulation_energy,
)
from deltacharger_lab.reports.simulation import (
    extremes as simulation_extremes,
)
from deltacharger_lab.reports.simulation import (
    map as simulation_map,
)
from deltacharger_lab.reports.simulation import (
    models as simulation_models,
)
from deltacharger_lab.reports.simulation import (
    parts as simulation_parts,
)
from deltacharger_lab.reports.simulation import (
    plan as simulation_plan,
)
from deltacharger_lab.reports.simulation import (
    summary as simulation_summary,
)
from deltacharger_lab.reports.simulation.page import write_page
from deltacharger_lab.reports.simulation.pictures import draw_all
from deltacharger_lab.reports.simulation.plan import MUJOCO, Plan
from deltacharger_lab.reports.simulation.scenes import LIGHT
from deltacharger_ros.outcomes import json_ready

PAGE, FIGURES = "simulation.md", "simulation.json"
ENERGY_STEPS = (0.0001, 0.001, 0.005, 0.01, 0.05)


def build(plan: Plan, directory: Path, command: str, progress: Callable[[str], None]) -> dict[str, Any]:
    """Measure, write page, figures, pictures and the module with the map into `directory`, and return the figures.

    Raises:
        OSError: a file cannot be written.
        KeyboardInterrupt: interrupted; nothing was written.
    """
    started = time.monotonic()
    names = simulation_plan.models()
    results: dict[str, Any] = {
        "machine": machine(("mujoco", "numpy", "matplotlib")),
        "command": command,
        "date": datetime.date.today().isoformat(),
        "quick": plan.quick,
        "models": list(names),
        "absent": simulation_plan.absent(),
        "steps": list(plan.steps),
        "reference_step": plan.reference_step,
    }
    progress("run times, alone")
    results["times"] = simulation_models.times(plan, names)
    results["costs"] = simulation_parts.costs(plan)
    results["imports"] = simulation_parts.imports()
    _measure(results, plan, names, progress)
    progress("pictures")
    results["pictures"], results["missing_pictures"] = draw_all(results, directory)
    results["elapsed_s"] = time.monotonic() - started
    results["targets"] = simulation_summary.targets(results)
    for bulky in ("reference", "traces"):
        del results[bulky]
    (directory / FIGURES).write_text(json.dumps(json_ready(results), indent=1, ensure_ascii=False) + "\n", "utf-8")
    light = [point for point in results["map"] if point["model"] == LIGHT]
    (directory / simulation_map.MODULE).write_text(simulation_map.source(light, plan, command), "utf-8")
    write_page(results, directory / PAGE)
    return results


def _measure(results: dict[str, Any], plan: Plan, names: tuple[str, ...], progress: Callable[[str], None]) -> None:
    known = MUJOCO if MUJOCO in names else LIGHT
    first = [Task("reference", simulation_models.reference, (name, plan.reference_step)) for name in names[:2]]
    references = work(first, progress)["reference"]
    exact = next(each for each in references if each["name"] == known)
    found = work(tasks(plan, names, exact), progress)
    results["reference"] = exact
    results["references_apart_mm"] = _apart(references)
    results["errors"] = found["errors"]
    results["map"] = joined(found["map"])
    results["extremes"] = found["extremes"]
    results["energy"] = found["energy"]
    results["convergence"] = found["convergence"][0]
    results["dockings"] = found["dockings"]
    results["parts"] = joined(found["parts"])
    results["traces"] = found["traces"]


def _apart(references: list[dict[str, Any]]) -> float | None:
    """Return how far the tiny-step paths of the two models are apart (mm rms); None where there is one model."""
    from deltacharger_lab.reports.simulation.scenes import rms

    if len(references) < 2:
        return None
    first, second = (each["rubbing"]["trace"] for each in references)
    return 1000.0 * rms(first, second)


def tasks(plan: Plan, names: tuple[str, ...], exact: dict[str, Any]) -> list[Task]:
    """Return all work that need not be alone."""
    found = [Task("convergence", simulation_models.convergence, (plan,), 4.0)]
    for name in names:
        for step in plan.steps:
            found.append(Task("errors", simulation_models.errors, (name, step, exact), 0.0005 / step))
        servos = plan.map_servos if name == LIGHT else (15.0,)
        for servo in servos:
            for contact in plan.map_contacts:
                arguments = (name, servo, contact, plan.map_steps, plan.map_steps[0])
                found.append(Task("map", simulation_map.column, arguments, 0.0002 / plan.map_steps[0]))
    for index in range(len(simulation_extremes.SCENES)):
        steps = (0.01,) if plan.quick else simulation_extremes.STEPS
        runs = [(LIGHT, step) for step in steps] + [(MUJOCO, 0.001)] * (MUJOCO in names)
        found += [Task("extremes", simulation_extremes.judge, (index, *run), 0.3) for run in runs]
    finer = ENERGY_STEPS[1:4] if plan.quick else ENERGY_STEPS
    for scene_name in simulation_energy.scenes():
        found += [Task("energy", simulation_energy.scene, (scene_name, step), 0.0001 / step) for step in finer]
    for case in simulation_models.docking_cases(plan, names):
        found.append(Task("dockings", simulation_models.whole_docking, case, 2.0))
    docked = list(simulation_parts.PARTS)[: plan.parts]
    found += [Task("parts", simulation_parts.answer, (name, plan.dockings), 5.0) for name in docked]
    found += [Task("traces", simulation_models.trace, (LIGHT, step), 0.2) for step in (0.001, 0.01, 0.1)]
    if MUJOCO in names:
        found.append(Task("traces", simulation_models.trace, (MUJOCO, 0.001), 0.5))
    return found
