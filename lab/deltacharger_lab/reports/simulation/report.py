# SPDX-License-Identifier: Apache-2.0
"""Measures the simulated charger's mechanics and writes the report: figures as JSON, a page, pictures, the package's
map."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from deltacharger_core.machine import SERVO_STIFFNESS
from deltacharger_lab.reports.formats import fixed
from deltacharger_lab.reports.page import rendered
from deltacharger_lab.reports.pool import ReportTask, joined, work
from deltacharger_lab.reports.report import Progress, Report, at_least, at_most, none
from deltacharger_lab.reports.simulation import energy, extremes, impact, lean, models, parts, stability
from deltacharger_lab.reports.simulation.pictures import PICTURES
from deltacharger_lab.reports.simulation.plan import MUJOCO, SimulationPlan, absent, models_here
from deltacharger_lab.reports.simulation.scenes import LIGHT, rms

TARGET_STEP = 0.01  # s
PEAKS = "peak force at the steps docking uses (5 to 20 ms), contact ≤ 1e6 N/m, worst"
ENERGY_STEPS = (0.0001, 0.001, 0.005, 0.01, 0.05)


def build(plan: SimulationPlan, directory: Path, command: str, progress: Progress) -> dict[str, Any]:
    """Measure, write page, figures, pictures and the module with the map into `directory`, and return the figures.

    Raises:
        ModuleNotFoundError: scipy or jinja2 is missing.
        OSError: a file cannot be written.
        KeyboardInterrupt: interrupted; nothing was written.
    """
    report = Report("simulation", command, ("mujoco", "numpy", "scipy", "matplotlib"), measures_with=["scipy"])
    results, names = report.results, models_here()
    results |= {
        "quick": plan.quick,
        "models": list(names),
        "absent": absent(),
        "steps": list(plan.steps),
        "reference_step": plan.reference_step,
    }
    progress("run times, alone")
    results["times"] = models.times(plan, names)
    results["lean_times"] = lean.times(plan)
    results["costs"] = parts.costs(plan)
    results["imports"] = parts.imports()
    traces = _measure(results, plan, names, progress)
    progress("pictures")
    report.draw(PICTURES, directory, traces=traces)
    results["targets"] = targets(results)
    light = [point for point in results["map"] if point["model"] == LIGHT]
    shown = {"command": command, "plan": plan, "stability": stability, "rows": stability.cells(light, plan)}
    (directory / stability.MODULE).write_text(rendered(f"{stability.MODULE}.j2", shown), "utf-8")
    return report.write(directory, is_calm=is_calm, settled=settled, ends=ends, stability=stability, impact=impact)


def _measure(
    results: dict[str, Any], plan: SimulationPlan, names: tuple[str, ...], progress: Progress
) -> list[dict[str, Any]]:
    """Put the measurements into `results`, and return the traces that are only drawn."""
    known = MUJOCO if MUJOCO in names else LIGHT
    first = [
        ReportTask("reference", models.both, (name, plan.reference_step)) for name in names if name in (LIGHT, MUJOCO)
    ]
    first += [
        ReportTask("axis", impact.axis_docking, (contact, servo), 0.1 + contact / 1e9)
        for contact in sorted({*plan.map_contacts, 1e5})
        for servo in sorted({*plan.map_servos, SERVO_STIFFNESS})
    ]
    begun = work(first, progress)
    references, axis = begun["reference"], {(each["contact"], each["servo"]): each for each in begun["axis"]}
    exact = next(each for each in references if each["name"] == known)
    exact["axis"] = axis[1e5, SERVO_STIFFNESS]
    found = work(tasks(plan, names, exact, axis), progress)
    paths = [each["rubbing"]["trace"] for each in references]
    results["references_apart_mm"] = 1000.0 * rms(*paths) if len(paths) == 2 else None
    for name in ("errors", "extremes", "energy", "dockings", "lean_remains"):
        results[name] = found[name]
    for name in ("map", "parts", "strikes", "tiny_steps", "others", "lean", "lean_rough"):
        results[name] = joined(found.get(name, []))
    for name in ("convergence", "integrators", "tolerances", "lean_order"):
        results[name] = found[name][0]
    return found["traces"]


def tasks(
    plan: SimulationPlan,
    names: tuple[str, ...],
    exact: dict[str, Any],
    axis: dict[tuple[float, float], dict[str, Any]],
) -> list[ReportTask]:
    """Return all work that needs no idle computer; `axis` has the converged dockings by contact and servo stiffness."""
    found = [ReportTask("convergence", models.convergence, (plan,), 4.0)]
    found += [ReportTask(*each) for each in impact.tasks(plan, names)]
    for name in names:
        for step in plan.steps:
            found.append(ReportTask("errors", models.errors, (name, step, exact), 0.0005 / step))
        servos = plan.map_servos if name == LIGHT else (SERVO_STIFFNESS,)
        for servo in servos:
            for contact in plan.map_contacts:
                arguments = (name, servo, contact, plan.map_steps, axis[contact, servo])
                found.append(ReportTask("map", stability.column, arguments, 0.0002 / plan.map_steps[0]))
    for index in range(len(extremes.SCENES)):
        steps = (0.01,) if plan.quick else extremes.STEPS
        runs = [(LIGHT, step) for step in steps] + [(MUJOCO, 0.001)] * (MUJOCO in names)
        found += [ReportTask("extremes", extremes.judge, (index, *run), 0.3) for run in runs]
    finer = ENERGY_STEPS[1:4] if plan.quick else ENERGY_STEPS
    for scene_name in energy.scenes():
        found += [ReportTask("energy", energy.scene, (scene_name, step), 0.0001 / step) for step in finer]
    for case in models.docking_cases(plan, names):
        found.append(ReportTask("dockings", models.complete_docking, case, 2.0))
    docked = list(parts.PARTS)[: plan.parts]
    found += [ReportTask("parts", parts.answer, (name, plan.dockings), 5.0) for name in docked]
    found += [ReportTask("traces", models.trace, (LIGHT, step), 0.2) for step in (0.001, 0.01, 0.1)]
    found += lean.tasks(plan, names)
    if MUJOCO in names:
        found.append(ReportTask("traces", models.trace, (MUJOCO, 0.001), 0.5))
    return found


def targets(results: dict[str, Any]) -> list[dict[str, Any]]:
    """Return every target with its measured value and verdict."""
    light = [point for point in results["map"] if point["model"] == LIGHT]
    at = [
        point
        for point in light
        if point["step"] == TARGET_STEP and 1e3 <= point["contact"] <= 1e7 and point["servo"] == SERVO_STIFFNESS
    ]
    error = next(row for row in results["errors"] if row["model"] == LIGHT and row["step"] == TARGET_STEP)
    speed = next(row for row in results["times"] if row["model"] == LIGHT and row["step"] == TARGET_STEP)
    diverged = sum(point["cell"] == stability.DIVERGED for point in light)
    broken = [row for row in results["extremes"] if row["model"] == LIGHT and not row["ok"]]
    gain = max(100.0 * row["gain"] / row["released"] for row in results["energy"])
    forces = max(point["force_percent"] for point in at)
    kept = f"of {sum(row['model'] == LIGHT for row in results['extremes'])}"
    peaks = impact.at_docking(results["strikes"], grazing=False)
    order = results["convergence"]["swing in free air"]["order"]
    return [
        at_least("light model at 10 ms, in motion", speed["moving"], 500.0, "× real"),
        at_most("light model at 10 ms, position", error["rms_mm"], 0.15, "mm rms"),
        at_most("solver tolerance: settled force at 10 ms, 1e3–1e7 N/m, worst", forces, stability.FORCE_LIMIT, "%"),
        at_most(PEAKS, impact.at_docking(results["strikes"]), stability.PEAK_LIMIT, "%"),
        at_most(f"{PEAKS} of strikes that do not graze the stop", peaks, stability.PEAK_LIMIT, "%"),
        none("light model, diverged points of the map", diverged, f"of {len(light)}"),
        none("light model, extremes whose law is broken", len(broken), kept),
        at_most("passive charger's energy, largest gain", gain, 1.0, "%"),
        at_least("order of convergence, free motion", order, 1.0, ""),
        *lean.targets(results),
        at_most("run time of this report", results["elapsed_s"] / 60.0, 10.0, "min"),
    ]


def is_calm(row: dict[str, Any]) -> bool:
    """Return whether a run neither diverged nor moves at its end."""
    return row["rms_mm"] is not None and row["speed"] is not None and row["speed"] < 1e-3


def settled(errors: Iterable[dict[str, Any]]) -> list[float]:
    """Return the forces (N) at rest of runs with friction, at steps up to 10 ms that are right without friction."""
    calm = [
        row
        for row in errors
        if is_calm(row) and row["step"] <= 0.01 and abs(row["force_percent"]) < stability.FORCE_LIMIT
    ]
    return [row["force_rubbing"] for row in calm if row["force_rubbing"] > 0]


def ends(runs: Sequence[dict[str, Any]]) -> list[str]:
    """Return codes, and means over the dockings that charged: time (s), contact current (A), misalignment (mm)."""
    codes = ", ".join("charged" if run["code"] == "NONE" else run["code"] for run in runs)
    charged = [run for run in runs if run["code"] == "NONE"]
    columns = (("elapsed", 1), ("current", 3), ("rest_mm", 2))
    means = (sum(run[key] for run in charged) / len(charged) if charged else None for key, _ in columns)
    return [codes, *(fixed(mean, digits) for mean, (_, digits) in zip(means, columns, strict=True))]
