# SPDX-License-Identifier: Apache-2.0
"""Slices through the workspace: condition number, and force along z per ampere of the most loaded servo."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import TORQUE_CONSTANT
from deltacharger_kinematics import Delta, DeltaGeometry, Status
from deltacharger_lab.plotting import Axes, picture
from deltacharger_lab.reports.kinematics.sets import plain_edge
from deltacharger_records.plotting import INK

_LIMITS = Status.JOINT_LIMIT | Status.SWING_LIMIT
_BEYOND = "#dfe3e8"  # out of reach, or only on the other assembly
_MARGIN = 0.140  # m around the workspace box


@dataclass(frozen=True)
class Slice:
    """One plane of points (rows, columns).

    Attributes:
        fixed: axis normal to the plane, 0–2.
        value: of that axis, m.
        horizontal: coordinates of the columns, m.
        vertical: coordinates of the rows, m.
        edge: distance to the edge of reach, m, negative outside.
        condition: number of the Jacobian; NaN if the platform cannot be on this assembly.
        force: newtons along z per ampere of the most loaded servo; NaN as above.
        allowed: 1 within joint and swing limits, else 0.
        box: of the workspace in this plane: left, lower, width, height, m.
    """

    fixed: int
    value: float
    horizontal: Array
    vertical: Array
    edge: Array
    condition: Array
    force: Array
    allowed: Array
    box: tuple[float, float, float, float]


def slice_workspace(geometry: DeltaGeometry, pixels: int) -> tuple[dict[str, float], list[Slice]]:
    """Return the workspace box in numbers; x–z at y = 0 and x–y at its lower, middle and upper z."""
    delta = Delta(geometry)
    low, high = np.array(geometry.workspace_min), np.array(geometry.workspace_max)
    levels = (low[2], 0.5 * (low[2] + high[2]), high[2])
    planes = [_slice(delta, 1, 0.0, pixels), *(_slice(delta, 2, float(z), pixels) for z in levels)]
    box = np.stack(np.meshgrid(*np.linspace(low, high, 25).T), axis=-1).reshape(-1, 3)
    condition, force = _condition(delta, box), _force(delta, box)
    figures = {
        "count": len(box),
        "condition_median": float(np.median(condition)),
        "condition_max": float(condition.max()),
        "force_min": float(force.min()),
        "force_median": float(np.median(force)),
        "force_max": float(force.max()),
        "reachable": float(np.isfinite(condition).mean()),
    }
    return figures, planes


def _slice(delta: Delta, fixed: int, value: float, pixels: int) -> Slice:
    geometry = delta.geometry
    plane = [0, 3 - fixed]  # x across; z up at some y, y up at some z
    low, high = (np.array(end)[plane] for end in (geometry.workspace_min, geometry.workspace_max))
    size = high - low + 2 * _MARGIN
    counts = (pixels, round(pixels * size[1] / size[0]))
    horizontal, vertical = (np.linspace(*each) for each in zip(low - _MARGIN, high + _MARGIN, counts, strict=True))
    grid = np.full((*counts[::-1], 3), value)
    grid[..., plane] = np.stack(np.meshgrid(horizontal, vertical), axis=-1)
    points = grid.reshape(-1, 3)
    status, inside = np.asarray(delta.inverse(points).status), plain_edge(geometry, points).min(-1)
    here = (status & np.uint32(Status.WRONG_ASSEMBLY)) == 0
    within = here & ((status & np.uint32(_LIMITS)) == 0) & (inside >= 0.0)
    numbers = (np.where(here, each, np.nan) for each in (_condition(delta, points), _force(delta, points)))
    edge, allowed, condition, force = (
        np.asarray(each, dtype=np.float64).reshape(grid.shape[:2]) for each in (inside, within, *numbers)
    )
    box = (low[0], low[1], high[0] - low[0], high[1] - low[1])
    return Slice(fixed, value, horizontal, vertical, edge, condition, force, allowed, box)


def _condition(delta: Delta, points: Array) -> Array:
    solved = delta.jacobian(points)
    finite = np.isfinite(solved.matrix).all((-2, -1))
    return np.where(finite, solved.condition, np.nan)


def _force(delta: Delta, points: Array) -> Array:
    torque = np.asarray(delta.torque(points, (0.0, 0.0, 1.0)))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(TORQUE_CONSTANT / np.abs(torque).max(-1))


def draw_condition(results: dict[str, Any], path: Path) -> None:
    """Draw the condition number of the Jacobian."""
    box = results["workspace"]
    about = f"in the workspace box (white) median {box['condition_median']:.2f}, largest {box['condition_max']:.2f}"
    levels = [1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 20.0]
    with picture(path, 13.0, 4.6, "Condition number of the Jacobian", about) as figure:
        _draw(figure, results["planes"], "condition", levels, "condition number", "viridis_r")


def draw_force(results: dict[str, Any], path: Path) -> None:
    """Draw the force along z per ampere of the most loaded servo."""
    box = results["workspace"]
    about = (
        "newtons along +z per ampere of the most loaded servo, without friction and weight; in the workspace box "
        f"(white) {box['force_min']:.1f} to {box['force_max']:.1f}, median {box['force_median']:.1f} N/A"
    )
    levels = [5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 50.0, 60.0, 80.0, 100.0]
    with picture(path, 13.0, 4.6, "Force along z", about) as figure:
        _draw(figure, results["planes"], "force", levels, "N per A", "viridis")


def _draw(figure: Any, planes: list[Slice], field: str, levels: list[float], label: str, colours: str) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import BoundaryNorm

    norm = BoundaryNorm(levels, 256, extend="max" if levels[0] == 1.0 else "both")  # no condition number is below 1
    panels = figure.subplots(1, len(planes))
    for axes, plane in zip(panels, planes, strict=True):
        _panel(axes, plane, getattr(plane, field), norm, colours)
    bar = figure.colorbar(ScalarMappable(norm, colours), ax=panels, ticks=levels, aspect=32.0, pad=0.01)
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=2, labelsize=8)
    bar.set_label(label)
    _legend(figure)


def _panel(axes: Axes, plane: Slice, field: Array, norm: Any, colours: str) -> None:
    from matplotlib.patches import Rectangle

    across, up = 1e3 * plane.horizontal, 1e3 * plane.vertical
    axes.set_facecolor(_BEYOND)
    reached = np.where(plane.edge >= 0.0, field, np.nan)
    axes.pcolormesh(across, up, reached, cmap=colours, norm=norm, shading="nearest", rasterized=True)
    axes.contour(across, up, plane.edge, levels=[0.0], colors=[INK], linewidths=1.4)
    for colour, line in (("white", 2.6), (INK, 1.2)):
        axes.contour(across, up, plane.allowed, levels=[0.5], colors=[colour], linewidths=line, linestyles="dashed")
    left, lower, width, height = (1e3 * value for value in plane.box)
    for colour, line in ((INK, 3.0), ("white", 1.6)):
        axes.add_patch(Rectangle((left, lower), width, height, fill=False, edgecolor=colour, linewidth=line))
    axes.set_aspect("equal")
    title = f"{'xyz'[plane.fixed]} = {1e3 * plane.value:.0f} mm"
    axes.set(title=title, xlabel="x, mm", ylabel=f"{'xyz'[3 - plane.fixed]}, mm")
    axes.grid(visible=False)


def _legend(figure: Any) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    figure.legend(
        handles=[
            Line2D([], [], color=INK, linewidth=1.4, label="edge of reach"),
            Line2D([], [], color=INK, linewidth=1.2, linestyle="dashed", label="joint and swing limits"),
            Patch(facecolor="white", edgecolor=INK, linewidth=0.8, label="workspace box"),
            Patch(facecolor=_BEYOND, label="out of reach, or the other assembly"),
        ],
        loc="outside lower center",
        ncols=4,
    )
