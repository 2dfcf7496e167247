# SPDX-License-Identifier: Apache-2.0
"""The stability map: contact stiffness × step × servo stiffness, and the module in which the package keeps it."""

from __future__ import annotations

import math
from typing import Any

from deltacharger_lab.reports.simulation.plan import SimulationPlan
from deltacharger_lab.reports.simulation.scenes import PUSH, Arm, docking, model_world, rms, settled_exactly, world
from deltacharger_lab.reports.simulation.usual import was_reset

DIVERGED, FORCE_OFF, PATH_OFF, PEAK_OFF, PROVEN = "d", "f", "p", "s", "+"
FORCE_LIMIT, PATH_LIMIT, PEAK_LIMIT = 0.5, 0.3, 15.0  # %, mm rms and %: largest errors of a proven point
REST = 1e-4  # m/s, largest speed of a world at rest
MODULE = "stability_map.py"


def column(
    name: str, servo: float, contact: float, steps: tuple[float, ...], exact: dict[str, Any]
) -> list[dict[str, Any]]:
    """Return the points of a servo and contact stiffness, judged against the converged reference's path and peak."""
    parameters = world(contact, servo, friction=0.0, gravity_y=0.0)
    force = settled_exactly(parameters, PUSH)
    points = []
    for step in steps:
        found = docking(name, parameters, step)
        rough = roughly(name, servo, contact, step)
        off = 100.0 * abs(found["force"] / force - 1.0)
        path = 1000.0 * rms(found["trace"], exact["trace"])
        point = {"model": name, "servo": servo, "contact": contact, "step": step, "force_percent": off}
        peak = 100.0 * (found["peak"] / exact["peak"] - 1.0)
        point |= {"path_mm": path, "peak_percent": peak, "speed": found["speed"], **rough}
        points.append({**point, "cell": _cell(point)})
    return points


def _cell(point: dict[str, Any]) -> str:
    if not point["bounded"] or not math.isfinite(point["force_percent"]) or not point["speed"] < REST:
        return DIVERGED
    if not point["force_percent"] <= FORCE_LIMIT:
        return FORCE_OFF
    if not point["path_mm"] <= PATH_LIMIT:
        return PATH_OFF
    return PROVEN if abs(point["peak_percent"]) <= PEAK_LIMIT else PEAK_OFF


def roughly(name: str, servo: float, contact: float, step: float, **changes: Any) -> dict[str, Any]:
    """Treat the arm roughly: full speed against the target, sideways, limp, torn off; `changes` as in `world`.

    Returns:
        bounded (whether every number stayed finite and bounded), imbalance (worst, N).
    """
    arm = Arm(model_world(name, world(contact, servo, **changes), step), step)
    bounded, imbalance = True, 0.0
    stages: tuple[tuple[tuple[float, float, float] | None, float], ...] = (
        ((0.0, 0.0, 0.05), 0.5),
        ((0.0, 0.0, 0.11), 0.4),
        ((0.03, 0.02, 0.09), 0.3),
        (None, 0.2),
        ((0.03, 0.02, 0.03), 0.6),
    )
    for point, seconds in stages:
        if point is None:
            arm.release()
        else:
            arm.aim(point)
        for _ in range(max(1, round(seconds / max(step, 0.005)))):
            arm.run(max(step, 0.005))
            bounded = bounded and arm.is_bounded() and not was_reset(arm.world)
            imbalance = max(imbalance, arm.world.mechanics.imbalance)
        if not bounded:
            break
    return {"bounded": bounded, "imbalance": imbalance}


def cells(points: list[dict[str, Any]], plan: SimulationPlan) -> list[list[str]]:
    """Return for each servo stiffness, for each contact stiffness, a character for each step."""
    found = {(point["servo"], point["contact"], point["step"]): point["cell"] for point in points}
    return [
        ["".join(found[servo, contact, step] for step in plan.map_steps) for contact in plan.map_contacts]
        for servo in plan.map_servos
    ]
