# SPDX-License-Identifier: Apache-2.0
"""Error against run time of every model, integrator and step, order of convergence, and complete dockings."""

from __future__ import annotations

import itertools
import math
import statistics
import time
import warnings
from typing import Any

from deltacharger_kinematics.geometry import Vector
from deltacharger_lab.reports.simulation.plan import MUJOCO, SimulationPlan
from deltacharger_lab.reports.simulation.scenes import (
    COMPARED,
    LIGHT,
    PUSH,
    Arm,
    docking,
    model_world,
    rms,
    settled_exactly,
    world,
)
from deltacharger_sim.parameters import TargetParameters, WorldParameters
from deltacharger_sim.proven import UnprovenWarning

_MOST_RUNS = 200  # of one timing
WITH_FRICTION = world()
WITHOUT = world(friction=0.0, gravity_y=0.0)
TARGETS = {
    1: TargetParameters(x=0.003, y=-0.002, roll=0.035),
    2: TargetParameters(x=-0.004, y=0.003, z=0.083, roll=-0.07),
    3: TargetParameters(z=0.077, roll=0.19),
    4: TargetParameters(x=0.001, y=0.001, roll=0.0),
}
"""Targets of complete dockings: the third is turned by 11°, beyond the limit of charging."""


def both(name: str, step: float) -> dict[str, Any]:
    """Return the docking of a model with friction and weight (`rubbing`) and without (`free`)."""
    return {"name": name, "rubbing": docking(name, WITH_FRICTION, step), "free": docking(name, WITHOUT, step)}


def errors(name: str, step: float, exact: dict[str, Any]) -> dict[str, Any]:
    """Return the errors of a model at a step (s): path in mm rms, forces in %, current in A; NaN if it diverged.

    The peak is that of the docking without friction and weight, against the converged one of `exact["axis"]`.
    """
    found = both(name, step)
    force = settled_exactly(WITHOUT, PUSH)
    return {
        "model": name,
        "step": step,
        "rms_mm": 1000.0 * rms(found["rubbing"]["trace"], exact["rubbing"]["trace"]),
        "rms_free_mm": 1000.0 * rms(found["free"]["trace"], exact["free"]["trace"]),
        "peak_percent": 100.0 * (found["free"]["peak"] / exact["axis"]["peak"] - 1.0),
        "force_percent": 100.0 * (found["free"]["force"] / force - 1.0),
        "force_rubbing": found["rubbing"]["force"],
        "current_error": found["free"]["current"] - exact["free"]["current"],
        "speed": max(found["free"]["speed"], found["rubbing"]["speed"]),
    }


def times(plan: SimulationPlan, names: tuple[str, ...]) -> list[dict[str, Any]]:
    """Return each model's speed relative to real time, in motion and in total; the fastest of the repeats."""
    rows = []
    for name, step in itertools.product(names, plan.steps):
        runs: list[dict[str, Any]] = []
        began = time.process_time()
        while len(runs) < (plan.repeats if step >= 1e-3 else 1) or (
            time.process_time() - began < plan.timing_s and len(runs) < _MOST_RUNS
        ):
            runs.append(docking(name, WITH_FRICTION, step))
        row = {"model": name, "step": step, "runs": len(runs)}
        rows.append({**row, "moving": max(run["moving"] for run in runs), "all": max(run["all"] for run in runs)})
    return rows


def convergence(plan: SimulationPlan) -> dict[str, Any]:
    """Return the light model's error for each step: a swing in free air, and the docking without friction.

    The slope of log(error) over log(step) by least squares is the order; kinematics that are linear in a step have 1.
    """
    found = {}
    for name, run in (("swing in free air", _swing), ("docking, no friction", _docking)):
        exact = run(plan.order_steps[0] / 10.0)
        sizes = [rms(run(step), exact) for step in plan.order_steps]
        pairs = [(math.log(step), math.log(size)) for step, size in zip(plan.order_steps, sizes, strict=True)]
        slope = statistics.linear_regression(*zip(*pairs, strict=True)).slope
        found[name] = {"steps": list(plan.order_steps), "rms_mm": [1000.0 * size for size in sizes], "order": slope}
    return found


def _swing(step: float) -> list[Vector]:
    """Move by a distance that no step takes in halves."""
    arm = Arm(model_world(LIGHT, world(friction=0.0, target=TargetParameters(present=False)), step), step)
    arm.aim((0.004, -0.006, 0.012))
    arm.run(0.5, 0.01)
    return arm.trace


def _docking(step: float) -> list[Vector]:
    found: list[Vector] = docking(LIGHT, WITHOUT, step)["trace"]
    return found


def trace(name: str, step: float) -> dict[str, Any]:
    """Return time (s), z (m) and contact force (N) through the docking and a pull-off, for a picture."""
    arm = Arm(model_world(name, WITH_FRICTION, step), step)
    arm.go((0.0, 0.0, 0.06), 1.0)
    begin, course = arm.world.time, []
    every = max(1, round(0.005 / step))
    for index in range(24):
        share = min((index + 1) / 8.0, 1.0) if index < 16 else 1.0 - (index - 15) / 8.0
        arm.aim((0.0, 0.0, 0.06 + 0.026 * share), 2.8)
        for count in range(1, round(0.1 / step) + 1):
            arm.world.step(step)
            if count % every == 0:
                mechanics = arm.world.mechanics
                course.append([arm.world.time - begin, mechanics.position[2], mechanics.contact_force])
    return {"model": name, "step": step, "course": course}


def complete_docking(name: str, step: float, number: int, parameters: WorldParameters | None = None) -> dict[str, Any]:
    """Dock once with the real state machine; return code, duration, current and misalignment.

    Args:
        name: of the model.
        step: of the world, s; MuJoCo takes steps of 1 ms in it.
        number: of the docking: target and seed.
        parameters: of the world; None = default, without friction by load. Its target and step are replaced.
    """
    import dataclasses

    from deltacharger_sim.pads.source import ContactSource
    from deltacharger_sim.shared_world import SharedWorld
    from deltacharger_sim.virtual.virtual_charger import VirtualCharger

    parameters = dataclasses.replace(parameters or WorldParameters(servo=COMPARED), target=TARGETS[number], step=step)
    tactile = ContactSource(None, 900, number)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnprovenWarning)  # the effect of long steps is measured here
        charger = VirtualCharger(parameters, seed=number, tactile=tactile)
    if name != LIGHT:
        from deltacharger_lab.mujoco.world import mujoco_world

        charger.world = mujoco_world(parameters, tactile, number, step=min(step, 1e-3), integrator=name.split()[-1])
        charger.plant = SharedWorld(charger.world, clock=lambda: charger.now)
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


def docking_cases(plan: SimulationPlan, names: tuple[str, ...]) -> list[tuple[str, float, int]]:
    """Return (model, step, docking) of all complete dockings: light model at all steps, MuJoCo in steps of 1 ms."""
    cases = [(LIGHT, step, number) for step in plan.docking_steps for number in plan.dockings]
    if MUJOCO in names:
        cases += [(MUJOCO, 5e-3, number) for number in plan.dockings]
    return cases
