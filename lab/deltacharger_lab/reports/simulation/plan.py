# SPDX-License-Identifier: Apache-2.0
"""Plan of the simulation report."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass

from deltacharger_lab.reports.simulation.scenes import LIGHT

MUJOCO = "MuJoCo discrete"
MUJOCO_FAST = "MuJoCo implicitfast"
MUJOCO_USUAL = "MuJoCo usual implicitfast"


@dataclass(frozen=True)
class SimulationPlan:
    """One report; the defaults are those of the committed one.

    Attributes:
        reference_step: of the tiny-step reference, s.
        steps: of the compared models, s.
        order_steps: for the fit of the order of convergence, s.
        map_steps: of the stability map, s.
        map_contacts: its contact stiffnesses, N/m.
        map_servos: its servo stiffnesses, N·m/rad.
        strike_contacts: contact stiffnesses of the impacts, N/m.
        strike_servos: their servo stiffnesses, N·m/rad.
        strike_steps: of the world, s.
        tiny_steps: at which the complete light model converges to an impact, s; each half of the one before.
        repeats: minimum of every timing; the fastest counts.
        timing_s: processor time for which a timing is repeated.
        dockings: seeds of complete dockings for each model and part.
        docking_steps: of their worlds, s.
        parts: number of optional parts that dock, the first ones.
        quick: whether it is the short plan.
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
"""The short plan."""


def absent() -> dict[str, str]:
    """Return missing libraries, each with what is left out."""
    if importlib.util.find_spec("mujoco") is None:
        return {"mujoco": "install deltacharger-lab[sim]; the light model with tiny steps is then its own reference"}
    return {}


def models_here() -> tuple[str, ...]:
    """Return the names of the models available here, the light one first."""
    if absent():
        return (LIGHT,)
    from deltacharger_lab.mujoco.model import integrators

    return (LIGHT, *(name for name in (MUJOCO, MUJOCO_FAST, MUJOCO_USUAL) if name.split()[-1] in integrators()))
