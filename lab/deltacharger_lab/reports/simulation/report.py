# SPDX-License-Identifier: Apache-2.0
"""Measures the simulated charger's mechanics and writes the report: figures as JSON, a page, pictures, the package's
map."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from deltacharger_bringup.records.replay.picture import BLUE, FAINT, GREEN, INK, ORANGE, PURPLE, RED
from deltacharger_core.machine import SERVO_STIFFNESS
from deltacharger_lab.plotting import Axes, note, picture
from deltacharger_lab.reports import formats, pool
from deltacharger_lab.reports.report import Progress, Report, at_least, at_most, none
from deltacharger_lab.reports.simulation import impact, lean, models, scenes

_COLOURS = {scenes.LIGHT: BLUE, scenes.MUJOCO: ORANGE, scenes.MUJOCO_FAST: GREEN, scenes.MUJOCO_USUAL: PURPLE}
_FLOOR = 1e-7  # % of force error, drawn for smaller ones
_DIVERGED_AT = 30.0  # mm, where a diverged run is drawn


def _error_time(results: dict[str, Any], path: Path) -> None:
    known = "MuJoCo" if scenes.MUJOCO in results["models"] else "the light model"
    finest = f"{1000.0 * results['reference_step']:g} ms"
    about = f"1.2 s of docking with friction against {known} in steps of {finest}; each point is a step, in ms"
    with picture(path, 13.5, 5.0, "Error against run time", about) as figure:
        left, middle, right = figure.subplots(1, 3)
        columns = ((left, "rms_mm", "path, mm rms"), (middle, "peak_percent", "peak force, %"))
        for axes, key, text in (*columns, (right, "force_percent", "solver tolerance: settled force, %")):
            for name in results["models"]:
                _curve(axes, results, name, key)
            axes.set(title=text, xscale="log", yscale="log", xlabel="processor time per simulated second, ms")
        left.set_ylim(5e-4, 60.0)
        left.axhline(0.15, color=RED, linewidth=1.0, linestyle="--")
        left.axvline(2.0, color=RED, linewidth=1.0, linestyle="--")
        left.text(2.2, 5e-3, "targets: 0.15 mm,\n500 × real time", color=RED, fontsize=8, va="top", ha="left")
        middle.set_ylim(1e-2, 200.0)
        middle.axhline(models.PEAK_LIMIT, color=RED, linewidth=1.0, linestyle="--")
        right.axhline(models.FORCE_LIMIT, color=RED, linewidth=1.0, linestyle="--")
        right.text(0.98, 0.7, "target: 0.5 %", color=RED, fontsize=8, ha="right", transform=right.get_yaxis_transform())
        right.plot([], [], "x", color=FAINT, label="diverged or restless")
        right.legend(loc=(0.02, 0.26), fontsize=8)


def _curve(axes: Axes, results: dict[str, Any], name: str, key: str) -> None:
    times = {row["step"]: 1000.0 / row["moving"] for row in results["times"] if row["model"] == name}
    rows = [row for row in results["errors"] if row["model"] == name]
    calm = [row for row in rows if row[key] == row[key] and row["speed"] < 1e-3]
    x, y = [times[row["step"]] for row in calm], [max(abs(row[key]), _FLOOR) for row in calm]
    axes.plot(x, y, "o-", color=_COLOURS[name], markersize=4, linewidth=1.4, label=name)
    for time, row, value in zip(x, calm, y, strict=True):
        note(axes, f"{1000.0 * row['step']:g}", (time, value), (3, 4), fontsize=7, ha="left")
    lost = [times[row["step"]] for row in rows if row not in calm]
    top = _DIVERGED_AT if key == "rms_mm" else 100.0
    axes.plot(lost, [top] * len(lost), "x", color=_COLOURS[name], markersize=6)


def _map(results: dict[str, Any], path: Path) -> None:
    names = [name for name in results["models"] if any(point["model"] == name for point in results["map"])]
    about = f"path error in mm rms at {SERVO_STIFFNESS:g} N·m/rad; crosses: diverged or does not come to rest"
    with picture(path, 3.6 * len(names) + 0.8, 4.6, "Stability map", about) as figure:
        from matplotlib.colors import LogNorm

        rows = figure.subplots(1, len(names), squeeze=False)[0]
        for index, (axes, name) in enumerate(zip(rows, names, strict=True)):
            points = [point for point in results["map"] if point["model"] == name and point["servo"] == SERVO_STIFFNESS]
            steps = sorted({point["step"] for point in points})
            contacts = sorted({point["contact"] for point in points})
            values = [[float("nan")] * len(steps) for _ in contacts]
            for point in points:
                column, row = steps.index(point["step"]), contacts.index(point["contact"])
                if point["cell"] == models.DIVERGED:
                    axes.plot(column, row, "x", color=RED, markersize=7)
                    continue
                values[row][column] = max(point["path_mm"], 1e-3)
                colour = "white" if point["path_mm"] < 0.03 else INK
                axes.text(column, row, f"{point['path_mm']:.2g}", ha="center", va="center", fontsize=6, color=colour)
            axes.imshow(values, origin="lower", aspect="auto", cmap="viridis", norm=LogNorm(1e-3, 1.0))
            axes.set_xticks(range(len(steps)), [f"{1000.0 * step:g}" for step in steps], fontsize=7)
            axes.set_yticks(range(len(contacts)), [formats.tens(each) for each in contacts] if not index else [])
            axes.set(title=name, xlabel="step, ms")
            axes.grid(visible=False)
        rows[0].set_ylabel("contact stiffness, N/m per electrode")


PICTURES = {
    "simulation-error-time.png": _error_time,
    "simulation-map.png": _map,
}


TARGET_STEP = 0.01  # s
PEAKS = "peak force at the steps docking uses (5 to 20 ms), contact ≤ 1e6 N/m, worst"


def build(plan: scenes.SimulationPlan, directory: Path, command: str, progress: Progress) -> dict[str, Any]:
    """Measure, write page, figures, pictures and the module with the map into `directory`, and return the figures.

    Raises:
        ModuleNotFoundError: scipy or jinja2 is missing.
        OSError: a file cannot be written.
        KeyboardInterrupt: interrupted; nothing was written.
    """
    report = Report("simulation", command, ("mujoco", "numpy", "scipy", "matplotlib"), measures_with=["scipy"])
    results, names = report.results, scenes.models_here()
    results |= {
        "quick": plan.quick,
        "models": list(names),
        "absent": scenes.absent(),
        "steps": list(plan.steps),
        "reference_step": plan.reference_step,
    }
    progress("run times, alone")
    results["times"] = models.times(plan, names)
    results["lean_times"] = lean.times(plan)
    _measure(results, plan, names, progress)
    progress("pictures")
    report.draw(PICTURES, directory)
    results["targets"] = targets(results)
    return report.write(directory, is_calm=is_calm, settled=settled, ends=ends, stability=models, impact=impact)


def _measure(results: dict[str, Any], plan: scenes.SimulationPlan, names: tuple[str, ...], progress: Progress) -> None:
    """Put the measurements into `results`."""
    known = scenes.MUJOCO if scenes.MUJOCO in names else scenes.LIGHT
    first = [
        pool.ReportTask("reference", models.both, (name, plan.reference_step))
        for name in names
        if name in (scenes.LIGHT, scenes.MUJOCO)
    ]
    first += [
        pool.ReportTask("axis", impact.axis_docking, (contact, servo), 0.1 + contact / 1e9)
        for contact in sorted({*plan.map_contacts, 1e5})
        for servo in sorted({*plan.map_servos, SERVO_STIFFNESS})
    ]
    begun = pool.work(first, progress)
    references, axis = begun["reference"], {(each["contact"], each["servo"]): each for each in begun["axis"]}
    exact = next(each for each in references if each["name"] == known)
    exact["axis"] = axis[1e5, SERVO_STIFFNESS]
    found = pool.work(tasks(plan, names, exact, axis), progress)
    paths = [each["rubbing"]["trace"] for each in references]
    results["references_apart_mm"] = 1000.0 * scenes.rms(*paths) if len(paths) == 2 else None
    for name in ("errors", "dockings"):
        results[name] = found[name]
    for name in ("map", "strikes", "others", "lean", "lean_rough"):
        results[name] = pool.joined(found.get(name, []))
    results["tolerances"] = found["tolerances"][0]


def tasks(
    plan: scenes.SimulationPlan,
    names: tuple[str, ...],
    exact: dict[str, Any],
    axis: dict[tuple[float, float], dict[str, Any]],
) -> list[pool.ReportTask]:
    """Return all work that needs no idle computer; `axis` has the converged dockings by contact and servo stiffness."""
    found = [pool.ReportTask(*each) for each in impact.tasks(plan, names)]
    for name in names:
        for step in plan.steps:
            found.append(pool.ReportTask("errors", models.errors, (name, step, exact), 0.0005 / step))
        servos = plan.map_servos if name == scenes.LIGHT else (SERVO_STIFFNESS,)
        for servo in servos:
            for contact in plan.map_contacts:
                arguments = (name, servo, contact, plan.map_steps, axis[contact, servo])
                found.append(pool.ReportTask("map", models.column, arguments, 0.0002 / plan.map_steps[0]))
    for case in models.docking_cases(plan, names):
        found.append(pool.ReportTask("dockings", models.complete_docking, case, 2.0))
    return [*found, *lean.tasks(plan, names)]


def targets(results: dict[str, Any]) -> list[dict[str, Any]]:
    """Return every target with its measured value and verdict."""
    light = [point for point in results["map"] if point["model"] == scenes.LIGHT]
    at = [
        point
        for point in light
        if point["step"] == TARGET_STEP and 1e3 <= point["contact"] <= 1e7 and point["servo"] == SERVO_STIFFNESS
    ]
    error = next(row for row in results["errors"] if row["model"] == scenes.LIGHT and row["step"] == TARGET_STEP)
    speed = next(row for row in results["times"] if row["model"] == scenes.LIGHT and row["step"] == TARGET_STEP)
    diverged = sum(point["cell"] == models.DIVERGED for point in light)
    forces = max(point["force_percent"] for point in at)
    peaks = impact.at_docking(results["strikes"], grazing=False)
    return [
        at_least("light model at 10 ms, in motion", speed["moving"], 500.0, "× real"),
        at_most("light model at 10 ms, position", error["rms_mm"], 0.15, "mm rms"),
        at_most("solver tolerance: settled force at 10 ms, 1e3–1e7 N/m, worst", forces, models.FORCE_LIMIT, "%"),
        at_most(PEAKS, impact.at_docking(results["strikes"]), models.PEAK_LIMIT, "%"),
        at_most(f"{PEAKS} of strikes that do not graze the stop", peaks, models.PEAK_LIMIT, "%"),
        none("light model, diverged points of the map", diverged, f"of {len(light)}"),
        *lean.targets(results),
        at_most("run time of this report", results["elapsed_s"] / 60.0, 10.0, "min"),
    ]


def is_calm(row: dict[str, Any]) -> bool:
    """Return whether a run neither diverged nor moves at its end."""
    return row["rms_mm"] is not None and row["speed"] is not None and row["speed"] < 1e-3


def settled(errors: Iterable[dict[str, Any]]) -> list[float]:
    """Return the forces (N) at rest of runs with friction, at steps up to 10 ms that are right without friction."""
    calm = [
        row for row in errors if is_calm(row) and row["step"] <= 0.01 and abs(row["force_percent"]) < models.FORCE_LIMIT
    ]
    return [row["force_rubbing"] for row in calm if row["force_rubbing"] > 0]


def ends(runs: Sequence[dict[str, Any]]) -> list[str]:
    """Return codes, and means over the dockings that charged: time (s), contact current (A), misalignment (mm)."""
    codes = ", ".join("charged" if run["code"] == "NONE" else run["code"] for run in runs)
    charged = [run for run in runs if run["code"] == "NONE"]
    columns = (("elapsed", 1), ("current", 3), ("rest_mm", 2))
    means = (sum(run[key] for run in charged) / len(charged) if charged else None for key, _ in columns)
    return [codes, *(formats.fixed(mean, digits) for mean, (_, digits) in zip(means, columns, strict=True))]
