# SPDX-License-Identifier: Apache-2.0
"""Error against run time of every model, integrator and step, and complete dockings."""

import itertools
import math
import time
from typing import Any

from deltacharger_lab.reports.simulation import scenes
from deltacharger_sim.parameters import TargetParameters, WorldParameters

_MOST_RUNS = 200  # of one timing
WITH_FRICTION = scenes.world()
WITHOUT = scenes.world(friction=0.0, gravity_y=0.0)
TARGETS = {
    1: TargetParameters(x=0.003, y=-0.002, roll=0.035),
    2: TargetParameters(x=-0.004, y=0.003, z=0.083, roll=-0.07),
    3: TargetParameters(z=0.077, roll=0.19),
    4: TargetParameters(x=0.001, y=0.001, roll=0.0),
}
"""Targets of complete dockings: the third is turned by 11°, beyond the limit of charging."""


def both(name: str, step: float) -> dict[str, Any]:
    """Return the docking of a model with friction and weight (`rubbing`) and without (`free`)."""
    return {
        "name": name,
        "rubbing": scenes.docking(name, WITH_FRICTION, step),
        "free": scenes.docking(name, WITHOUT, step),
    }


def errors(name: str, step: float, exact: dict[str, Any]) -> dict[str, Any]:
    """Return the errors of a model at a step (s): path in mm rms, forces in %, current in A; NaN if it diverged.

    The peak is that of the docking without friction and weight, against the converged one of `exact["axis"]`.
    """
    found = both(name, step)
    force = scenes.settled_exactly(WITHOUT, scenes.PUSH)
    return {
        "model": name,
        "step": step,
        "rms_mm": 1000.0 * scenes.rms(found["rubbing"]["trace"], exact["rubbing"]["trace"]),
        "rms_free_mm": 1000.0 * scenes.rms(found["free"]["trace"], exact["free"]["trace"]),
        "peak_percent": 100.0 * (found["free"]["peak"] / exact["axis"]["peak"] - 1.0),
        "force_percent": 100.0 * (found["free"]["force"] / force - 1.0),
        "force_rubbing": found["rubbing"]["force"],
        "current_error": found["free"]["current"] - exact["free"]["current"],
        "speed": max(found["free"]["speed"], found["rubbing"]["speed"]),
    }


def times(plan: scenes.SimulationPlan, names: tuple[str, ...]) -> list[dict[str, Any]]:
    """Return each model's speed relative to real time, in motion and in total; the fastest of the repeats."""
    rows = []
    for name, step in itertools.product(names, plan.steps):
        runs: list[dict[str, Any]] = []
        began = time.process_time()
        while len(runs) < (plan.repeats if step >= 1e-3 else 1) or (
            time.process_time() - began < plan.timing_s and len(runs) < _MOST_RUNS
        ):
            runs.append(scenes.docking(name, WITH_FRICTION, step))
        row = {"model": name, "step": step, "runs": len(runs)}
        rows.append({**row, "moving": max(run["moving"] for run in runs), "all": max(run["all"] for run in runs)})
    return rows


def complete_docking(name: str, step: float, number: int) -> dict[str, Any]:
    """Dock once with the real state machine; return code, duration, current and misalignment.

    Args:
        name: of the model.
        step: of the world, s; MuJoCo takes steps of 1 ms in it.
        number: of the docking: target and seed.
    """
    from deltacharger_sim.pads import ContactSource
    from deltacharger_sim.virtual.virtual_charger import VirtualCharger
    from deltacharger_sim.world import SharedWorld

    parameters = WorldParameters(servo=scenes.COMPARED, target=TARGETS[number])
    tactile = ContactSource(None, 900, number)
    charger = VirtualCharger(parameters, seed=number, tactile=tactile)
    if name != scenes.LIGHT:
        from deltacharger_lab.mujoco.world import mujoco_world

        charger.world = mujoco_world(parameters, tactile, number, step=min(step, 1e-3), integrator=name.split()[-1])
        charger.plant = SharedWorld(charger.world, clock=lambda: charger.now)
    charger.world.dt = step
    try:
        outcome = charger.dock()
    except TimeoutError as error:
        return {"model": name, "step": step, "docking": number, "code": "NOT ENDED", "about": str(error)}
    truth = charger.world.snapshot()
    rest = 1000.0 * math.hypot(*truth.misalignment[:2]) if truth.misalignment else math.nan
    return {
        "model": name,
        "step": step,
        "docking": number,
        "code": outcome.code.name,
        "elapsed": outcome.elapsed,
        "current": outcome.contact_current,
        "alignments": outcome.alignments,
        "rest_mm": rest,
        "shorts": charger.world.record.energised_shorts,
    }


def docking_cases(plan: scenes.SimulationPlan, names: tuple[str, ...]) -> list[tuple[str, float, int]]:
    """Return (model, step, docking) of all complete dockings: light model at all steps, MuJoCo in steps of 1 ms."""
    cases = [(scenes.LIGHT, step, number) for step in plan.docking_steps for number in plan.dockings]
    if scenes.MUJOCO in names:
        cases += [(scenes.MUJOCO, 5e-3, number) for number in plan.dockings]
    return cases


DIVERGED, FORCE_OFF, PATH_OFF, PEAK_OFF, PROVEN = "d", "f", "p", "s", "+"
FORCE_LIMIT, PATH_LIMIT, PEAK_LIMIT = 0.5, 0.3, 15.0  # %, mm rms and %: largest errors of a proven point
REST = 1e-4  # m/s, largest speed of a world at rest


def column(
    name: str, servo: float, contact: float, steps: tuple[float, ...], exact: dict[str, Any]
) -> list[dict[str, Any]]:
    """Return the points of a servo and contact stiffness, judged against the converged reference's path and peak."""
    parameters = scenes.world(contact, servo, friction=0.0, gravity_y=0.0)
    force = scenes.settled_exactly(parameters, scenes.PUSH)
    points = []
    for step in steps:
        found = scenes.docking(name, parameters, step)
        rough = roughly(name, servo, contact, step)
        off = 100.0 * abs(found["force"] / force - 1.0)
        path = 1000.0 * scenes.rms(found["trace"], exact["trace"])
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
    arm = scenes.Arm(scenes.model_world(name, scenes.world(contact, servo, **changes), step), step)
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
            bounded = bounded and arm.is_bounded() and not scenes.was_reset(arm.world)
            imbalance = max(imbalance, arm.world.mechanics.imbalance)
        if not bounded:
            break
    return {"bounded": bounded, "imbalance": imbalance}
