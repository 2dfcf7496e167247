# SPDX-License-Identifier: Apache-2.0
"""Parts that a scene may omit: the same docking with and without each, its cost and its effect."""

from __future__ import annotations

import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from deltacharger_driver.emulators.power import PortParameters
from deltacharger_lab.reports.simulation.models import complete_docking
from deltacharger_lab.reports.simulation.plan import SimulationPlan
from deltacharger_lab.reports.simulation.scenes import LIGHT, Arm
from deltacharger_sim.parameters import (
    CableParameters,
    ContactParameters,
    MagnetParameters,
    PlatformParameters,
    ServoParameters,
    StandParameters,
    WorldParameters,
)
from deltacharger_sim.world import TactileSource, World

STEP = 0.01
PARTS: dict[str, WorldParameters] = {
    "as delivered": WorldParameters(),
    "without magnets": WorldParameters(magnets=MagnetParameters(force=0.0)),
    "without gear friction": WorldParameters(servo=ServoParameters(friction=0.0, friction_share=0.0)),
    "without electrodes' friction": WorldParameters(contact=ContactParameters(friction=0.0)),
    "without weight": WorldParameters(gravity_y=0.0),
    "without current noise": WorldParameters(servo=ServoParameters(current_noise=0.0, current_noise_share=0.0)),
    "with play, 6 mrad": WorldParameters(servo=ServoParameters(backlash=0.006)),
    "with sagging stall torque, 0.9 Ω": WorldParameters(servo=ServoParameters(stall_sag=1.0, supply_resistance=0.9)),
    "with commands 20 ms late": WorldParameters(servo=ServoParameters(command_latency=0.02)),
    "with readings 20 ms late": WorldParameters(servo=ServoParameters(reading_latency=0.02)),
    "with a platform that tilts, 5 mrad/(N·m)": WorldParameters(platform=PlatformParameters(compliance=0.005)),
    "with a cable, 100 N/m and 2 N": WorldParameters(cable=CableParameters(stiffness=100.0, drag=2.0)),
    "with robots that give way, 5 kN/m": WorldParameters(stand=StandParameters(stiffness=5000.0)),
    "with a target that takes no current": WorldParameters(port=PortParameters(accepts=False)),
}
PADS = "with the pads' model, 120 Hz"


def costs(plan: SimulationPlan) -> list[dict[str, Any]]:
    """Return for each part the µs of a world's step while it moves into contact, and the memory (kB) of a world.

    The fastest of the repeats counts. Parts take turns, so that a busy machine affects all equally.
    """
    makers: dict[str, Callable[[], World]] = {name: partial(World, each) for name, each in PARTS.items()}
    makers[PADS] = _with_pads
    fastest: dict[str, float] = {}
    for _ in range(2 * plan.repeats):
        for name, make in makers.items():
            fastest[name] = min(fastest.get(name, 1e9), _microseconds(make, name == PADS))
    return [{"part": name, "step_us": fastest[name], "memory_kb": _memory(make)} for name, make in makers.items()]


def _with_pads() -> World:
    from deltacharger_sim.pads.source import ContactSource

    source: TactileSource = ContactSource(None, 900, 1)
    return World(WorldParameters(), source, 1)


def _microseconds(make: Callable[[], World], pads: bool = False) -> float:
    """Return µs per step of 10 ms over an approach, a push and a slide; with `pads` read once a step."""
    arm = Arm(make(), STEP)
    arm.go((0.0, 0.0, 0.07), 0.6)
    steps, started = 0, time.process_time()
    for point in ((0.0, 0.0, 0.079), (0.0, 0.0, 0.0865), (0.004, 0.002, 0.0865), (0.0, 0.0, 0.0865)):
        arm.aim(point)
        for _ in range(15):
            arm.world.step(STEP)
            steps += 1
            if pads:
                arm.world.taxels()
    return (time.process_time() - started) / steps * 1e6


def _memory(make: Callable[[], World]) -> float:
    """Return the memory of a world after 200 steps (kB), by Python's count."""
    make()  # loading is not counted
    tracemalloc.start()
    arm = Arm(make(), STEP)
    arm.go((0.0, 0.0, 0.0865), 2.0)
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return kept / 1024.0


def answer(name: str, numbers: tuple[int, ...]) -> list[dict[str, Any]]:
    """Return results of complete dockings with a part: code, time, contact current, misalignment at rest, final arm."""
    return [{"part": name, **complete_docking(LIGHT, STEP, number, PARTS[name])} for number in numbers]


def imports() -> list[dict[str, Any]]:
    """Return the cost of importing each model in a new process: s and MB of resident memory; empty without /proc."""
    if not Path("/proc/self/statm").exists():
        return []
    text = (
        "import resource,time; t=time.perf_counter(); {0}; s=time.perf_counter()-t; "
        "pages=int(open('/proc/self/statm').read().split()[1]); print(s, pages*resource.getpagesize()/2**20)"
    )
    cases = {
        "nothing": "pass",
        "the light world": "import deltacharger_sim.world",
        "the light world and the pads' model": "import deltacharger_sim.world, deltacharger_sim.pads.source",
        "the MuJoCo world": "import deltacharger_lab.mujoco.world as m; m.mujoco_model.load()",
    }
    rows = []
    for name, code in cases.items():
        ended = subprocess.run([sys.executable, "-c", text.format(code)], capture_output=True, text=True, check=False)
        if ended.returncode == 0:
            seconds, memory = map(float, ended.stdout.split())
            rows.append({"what": name, "seconds": seconds, "memory_mb": memory})
    return rows
