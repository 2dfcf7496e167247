# SPDX-License-Identifier: Apache-2.0
"""Pictures of the simulation's report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_core.machine import SERVO_STIFFNESS
from deltacharger_lab.plotting import Axes, note, picture
from deltacharger_lab.reports.formats import tens
from deltacharger_lab.reports.simulation.energy import PARTS
from deltacharger_lab.reports.simulation.impact import worst
from deltacharger_lab.reports.simulation.lean_picture import remaining_yaw
from deltacharger_lab.reports.simulation.plan import MUJOCO, MUJOCO_FAST, MUJOCO_USUAL
from deltacharger_lab.reports.simulation.scenes import LIGHT
from deltacharger_lab.reports.simulation.stability import DIVERGED, FORCE_LIMIT, PEAK_LIMIT
from deltacharger_records.plotting import BLUE, FAINT, GREEN, INK, ORANGE, PURPLE, RED

_COLOURS = {LIGHT: BLUE, MUJOCO: ORANGE, MUJOCO_FAST: GREEN, MUJOCO_USUAL: PURPLE}
_FLOOR = 1e-7  # % of force error, drawn for smaller ones
_DIVERGED_AT = 30.0  # mm, where a diverged run is drawn


def _error_time(results: dict[str, Any], path: Path) -> None:
    known = "MuJoCo" if MUJOCO in results["models"] else "the light model"
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
        middle.axhline(PEAK_LIMIT, color=RED, linewidth=1.0, linestyle="--")
        right.axhline(FORCE_LIMIT, color=RED, linewidth=1.0, linestyle="--")
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
                if point["cell"] == DIVERGED:
                    axes.plot(column, row, "x", color=RED, markersize=7)
                    continue
                values[row][column] = max(point["path_mm"], 1e-3)
                colour = "white" if point["path_mm"] < 0.03 else INK
                axes.text(column, row, f"{point['path_mm']:.2g}", ha="center", va="center", fontsize=6, color=colour)
            axes.imshow(values, origin="lower", aspect="auto", cmap="viridis", norm=LogNorm(1e-3, 1.0))
            axes.set_xticks(range(len(steps)), [f"{1000.0 * step:g}" for step in steps], fontsize=7)
            axes.set_yticks(range(len(contacts)), [tens(each) for each in contacts] if not index else [])
            axes.set(title=name, xlabel="step, ms")
            axes.grid(visible=False)
        rows[0].set_ylabel("contact stiffness, N/m per electrode")


def _energy(results: dict[str, Any], path: Path) -> None:
    step = 0.005
    rows = [row for row in results["energy"] if row["step"] == step]
    about = f"steps of {1000.0 * step:g} ms; left: energy above its final value; right: losses by part"
    with picture(path, 11.0, 4.6, "Energy of a charger that is not driven", about) as figure:
        left, right = figure.subplots(1, 2)
        for row, colour in zip(rows, (BLUE, ORANGE, GREEN, PURPLE), strict=True):
            times, values = zip(*row["course"], strict=True)
            start = values[0]
            left.plot(times, [value / start for value in values], color=colour, linewidth=1.4, label=row["scene"])
        left.set(xlabel="time, s", ylabel="share of the energy to lose")
        left.legend(fontsize=8)
        whole, end = np.array([sum(row["lost"].values()) for row in rows]), np.zeros(len(rows))
        for part, colour in zip(PARTS, (PURPLE, ORANGE, BLUE, GREEN, FAINT), strict=True):
            share = 100.0 * np.array([row["lost"][part] for row in rows]) / whole
            right.barh(range(len(rows)), share, left=end, color=colour, label=part)
            end = end + share
        right.set_yticks(range(len(rows)), [row["scene"].replace(", ", ",\n") for row in rows], fontsize=8)
        right.invert_yaxis()
        right.set_xlabel("% of the energy lost")
        right.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.02, 1.0), ncols=len(PARTS), columnspacing=0.9)


def _impact(results: dict[str, Any], path: Path) -> None:
    about = "worst error in % of all servos and strikes, without those that graze the stop, against the reference"
    with picture(path, 10.0, 4.4, "Peak force of an impact", about) as figure:
        from matplotlib.colors import LogNorm

        rows = [row for row in results["strikes"] if not row["grazes"]]
        steps, contacts = (sorted({row[key] for row in rows}) for key in ("step", "contact"))
        panels = figure.subplots(1, 2)
        titles = {"percent": "resolved within the step", "ends_percent": "forces at steps' ends"}
        for axes, (key, title) in zip(panels, titles.items(), strict=True):
            values = [[worst(rows, key, step=step, contact=contact) for step in steps] for contact in contacts]
            shown = [[max(abs(value), 0.1) for value in row] for row in values]
            axes.imshow(shown, origin="lower", aspect="auto", cmap="viridis", norm=LogNorm(0.5, 100.0))
            for index, row in enumerate(values):
                for column, value in enumerate(row):
                    colour = "white" if abs(value) < PEAK_LIMIT else INK
                    axes.text(column, index, f"{value:+.1f}", ha="center", va="center", fontsize=8, color=colour)
            axes.set_xticks(range(len(steps)), [f"{1000.0 * step:g}" for step in steps])
            axes.set_yticks(range(len(contacts)), [tens(each) for each in contacts])
            axes.set(title=title, xlabel="step, ms", ylabel="contact stiffness, N/m per electrode")
            axes.grid(visible=False)


def _docking(results: dict[str, Any], path: Path) -> None:
    about = "approach, snap, push, pull off; commands every 0.1 s"
    with picture(path, 10.0, 5.2, "One docking by every model", about) as figure:
        top, bottom = figure.subplots(2, 1, sharex=True)
        styles = {(LIGHT, 0.001): (BLUE, "-", 1.8), (LIGHT, 0.01): (GREEN, "--", 1.4), (LIGHT, 0.1): (PURPLE, ":", 1.4)}
        for each in results["traces"]:
            colour, line, width = styles.get((each["model"], each["step"]), (ORANGE, "-", 1.0))
            time, z, force = zip(*each["course"], strict=True)
            label = f"{each['model']}, {1000.0 * each['step']:g} ms"
            top.plot(time, [1000.0 * value for value in z], line, color=colour, linewidth=width, label=label)
            bottom.plot(time, force, line, color=colour, linewidth=width)
        top.axhline(80.0, color=FAINT, linewidth=0.8)
        top.set_ylabel("z, mm")
        bottom.set(ylabel="contact force, N", xlabel="time, s")
        top.legend(fontsize=8, loc="lower right")


PICTURES = {
    "simulation-error-time.png": _error_time,
    "simulation-map.png": _map,
    "simulation-impact.png": _impact,
    "simulation-energy.png": _energy,
    "simulation-docking.png": _docking,
    "simulation-lean.png": remaining_yaw,
}
