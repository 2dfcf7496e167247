# SPDX-License-Identifier: Apache-2.0
"""How much the simulation's report measures."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass

from deltacharger_lab.reports.simulation.scenes import LIGHT

MUJOCO = "MuJoCo discrete"
MUJOCO_FAST = "MuJoCo implicitfast"
MUJOCO_USUAL = "MuJoCo usual implicitfast"


@dataclass(frozen=True)
class SimulationPlan:
    """One report; the defaults are those of the one that is committed.

    Attributes:
        reference_step: of the tiny-step reference, s.
        steps: of the models that are compared, s.
        order_steps: from which the order of convergence is fitted, s.
        map_steps: of the stability map, s.
        map_contacts: its contact stiffnesses, N/m.
        map_servos: its servo stiffnesses, N·m/rad.
        strike_contacts: contact stiffnesses of the impacts, N/m.
        strike_servos: their servo stiffnesses, N·m/rad.
        strike_steps: of the world, s.
        tiny_steps: at which the whole light model converges to an impact, s; each half of the one before.
        repeats: of every timing, at least; the fastest counts.
        timing_s: of processor time that a timing is repeated for.
        dockings: whole dockings for each model and part, by their seeds.
        docking_steps: of their worlds, s.
        parts: how many of the parts that a scene may leave out dock, the first of them.
        quick: whether it is for a first look.
    """

    reference_step: float = 5e-5
    steps: tuple[float, ...] = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1)
    order_steps: tuple[float, ...] = (5e-4, 1e-3, 2e-3, 5e-3, 1e-2)
    map_steps: tuple[float, ...] = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1)
    map_contacts: tuple[float, ...] = (1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9)
    map_servos: tuple[float, ...] = (2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0)
    strike_contacts: tuple[float, ...] = (1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9)
    strike_servos: tuple[float, ...] = (2.0, 2.5, 15.0, 40.0)
    strike_steps: tuple[float, ...] = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2)
    tiny_steps: tuple[float, ...] = (2e-4, 1e-4, 5e-5, 2.5e-5)
    repeats: int = 5
    timing_s: float = 0.5
    dockings: tuple[int, ...] = (1, 2, 3, 4)
    docking_steps: tuple[float, ...] = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1)
    parts: int = 100
    quick: bool = False


QUICK = SimulationPlan(
    reference_step=2e-4,
    steps=(1e-3, 5e-3, 1e-2, 1e-1),
    order_steps=(1e-3, 2e-3, 5e-3, 1e-2),
    map_steps=(1e-3, 1e-2, 1e-1),
    map_contacts=(1e3, 1e5, 1e9),
    map_servos=(15.0,),
    strike_contacts=(1e3, 1e5, 1e6, 1e7),
    strike_servos=(15.0,),
    strike_steps=(5e-3, 1e-2, 2e-2),
    tiny_steps=(2e-4, 1e-4, 5e-5),
    repeats=2,
    timing_s=0.2,
    dockings=(1,),
    docking_steps=(1e-2,),
    parts=2,
    quick=True,
)
"""For a first look."""


def absent() -> dict[str, str]:
    """Return what is not installed and which rows and pictures go without it."""
    if importlib.util.find_spec("mujoco") is None:
        return {"mujoco": "install deltacharger[sim]; the light model with tiny steps is then its own reference"}
    return {}


def models_here() -> tuple[str, ...]:
    """Return the names of the models that can be measured here, the light one first."""
    if absent():
        return (LIGHT,)
    from deltacharger_sim.mujoco_model import integrators

    return (LIGHT, *(name for name in (MUJOCO, MUJOCO_FAST, MUJOCO_USUAL) if name.split()[-1] in integrators()))
