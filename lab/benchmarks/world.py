# SPDX-License-Identifier: Apache-2.0
"""Run time and accuracy of the simulated world: the figures of docs/simulation.md.

    python lab/benchmarks/world.py [--json]

It measures through the public World: run time of a step, statics, magnets, settled force over contact stiffness and
step, and the path of a docking over the step. Takes a few seconds.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import time
from collections.abc import Iterator
from typing import Any

from deltacharger_core.machine import TORQUE_CONSTANT
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_sim.parameters import (
    ContactParameters,
    MagnetParameters,
    ServoParameters,
    TargetParameters,
    WorldParameters,
)
from deltacharger_sim.world import World

DELTA = ScalarDelta()
STIFFNESSES = (1e3, 1e4, 1e5, 1e6, 1e7, 1e9)
STEPS = (0.001, 0.002, 0.005, 0.010, 0.020, 0.100)


class Arm:
    """A world whose servos follow platform positions, with a lead for the weight of the arm."""

    def __init__(self, parameters: WorldParameters | None = None, step: float = 0.005) -> None:
        self.world = World(parameters or WorldParameters())
        self.dt = step
        servo = self.world.parameters.servo
        self.stiffness = servo.stiffness
        world = self.world.parameters
        self.gravity = (world.gravity_x, world.gravity_y, world.gravity_z)

    def aim(self, point: Vector, bound: float = 4.1, lead: bool = True) -> None:
        """Command all servos toward `point` (m, charger_base) with at most `bound` A each."""
        held = DELTA.holding_torque(*point, self.gravity)
        for index, (angle, torque) in enumerate(zip(DELTA.inverse(*point), held, strict=True)):
            self.world.command(index, True, angle + (torque / self.stiffness if lead else 0.0), bound)

    def run(self, seconds: float) -> None:
        """Advance the world."""
        for _ in range(max(1, round(seconds / self.dt))):
            self.world.step(self.dt)

    def go(self, point: Vector, seconds: float = 1.0, bound: float = 4.1, lead: bool = True) -> None:
        """Aim and wait."""
        self.aim(point, bound, lead)
        self.run(seconds)

    def contact_current(self) -> float:
        """Current per servo that pushes along +z, A, as docking computes it, without noise."""
        position = self.world.mechanics.position
        held = DELTA.holding_torque(*position, self.gravity)
        push = [torque - hold for torque, hold in zip(self.world.mechanics.torques, held, strict=True)]
        return DELTA.force(*position, (push[0], push[1], push[2]))[2] * lever(position) / TORQUE_CONSTANT


def lever(position: Vector) -> float:
    """Mean dz/dangle, m/rad."""
    return sum(DELTA.jacobian(*position)[6:]) / 3.0


def without_friction(**changes: Any) -> ServoParameters:
    return ServoParameters(friction=0.0, friction_share=0.0, **changes)


def microseconds(arm: Arm, seconds: float) -> float:
    """Median time of a step (µs) over blocks of 20, so that pauses of a busy machine do not count."""
    blocks = []
    for _ in range(max(1, round(seconds / arm.dt / 20))):
        start = time.perf_counter()
        for _ in range(20):
            arm.world.step(arm.dt)
        blocks.append((time.perf_counter() - start) / 20 * 1e6)
    return statistics.median(blocks)


def cost(step: float) -> dict[str, float]:
    """µs per step at rest and in motion, in free air and in contact."""
    result = {}
    arm = Arm(step=step)
    arm.go((0.0, 0.0, 0.03))
    result["free, at rest"] = microseconds(arm, 1.0)
    arm.aim((0.03, 0.03, 0.06))
    result["free, moving"] = microseconds(arm, 0.4)
    arm.go((0.0, 0.0, 0.07))
    arm.go((0.0, 0.0, 0.086))
    result["docked, at rest"] = microseconds(arm, 1.0)
    arm.aim((0.02, 0.01, 0.086))
    result["docked, pushed sideways"] = microseconds(arm, 0.4)
    return result


def statics(stiffness: float) -> dict[str, float]:
    """Sag by weight at three depths (mm), and the contact current of a 5 mm step (A)."""
    result = {}
    for depth in (0.0, 0.03, 0.08):
        arm = Arm(WorldParameters(servo=without_friction(stiffness=stiffness), target=TargetParameters(present=False)))
        arm.go((0.0, 0.0, depth), 2.0, lead=False)
        result[f"sag at z = {1000 * depth:.0f} mm, mm"] = -1000.0 * arm.world.mechanics.position[1]
    arm = Arm(WorldParameters(servo=without_friction(stiffness=stiffness), magnets=MagnetParameters(force=0.0)))
    arm.go((0.0, 0.0, 0.081), 2.0)
    before = arm.contact_current()
    arm.go((0.0, 0.0, 0.086), 2.0)
    result["5 mm step, A"] = arm.contact_current() - before
    return result


def twenty_newtons() -> float:
    """Current per servo (A) at 20 N and (0, 0, 80 mm), without weight and friction."""
    world = WorldParameters(
        servo=without_friction(),
        magnets=MagnetParameters(force=0.0),
        contact=ContactParameters(stiffness=1e9),
        gravity_y=0.0,
    )
    arm = Arm(world)
    low, high = 0.080, 0.100
    for _ in range(25):
        middle = 0.5 * (low + high)
        arm.go((0.0, 0.0, middle), 1.0)
        low, high = (middle, high) if arm.world.push() < 20.0 else (low, middle)
    return statistics.mean(arm.world.mechanics.torques) / TORQUE_CONSTANT


def magnets(stiffness: float, rubs: bool = True) -> dict[str, float]:
    """Approach in steps of 0.25 mm, press until the servos push again, pull off; return the events."""
    servo = ServoParameters(stiffness=stiffness) if rubs else without_friction(stiffness=stiffness)
    arm = Arm(WorldParameters(servo=servo))
    arm.go((0.0, 0.0, 0.060))
    command, gap, current = 0.060, math.nan, math.nan
    while arm.world.mechanics.contact_force == 0.0:
        gap, current = arm.world.mechanics.gap, arm.contact_current()
        command += 0.00025
        arm.go((0.0, 0.0, command), 0.6)
    snapped, after = command, arm.contact_current()
    while arm.contact_current() < 0.0:
        command += 0.00025
        arm.go((0.0, 0.0, command), 0.3)
    zero = command
    release = 0.0
    while arm.world.mechanics.contact_force > 0.0:
        release = min(release, arm.contact_current())
        command -= 0.00025
        arm.go((0.0, 0.0, command), 0.2)
    return {
        "gap before the snap, mm": 1000.0 * gap,
        "before, A": current,
        "after, A": after,
        "zero after, mm of command": 1000.0 * (zero - snapped),
        "release, A": release,
    }


def settled_exactly(stiffness: float, contact: ContactParameters, reference: float) -> float:
    """Contact force (N) at rest on the axis, by bisection of springs against magnets, without integration."""
    low, high = 0.080, 0.105
    for _ in range(200):
        z = 0.5 * (low + high)
        torque = stiffness * (reference - DELTA.inverse(0.0, 0.0, z)[0])
        pushed = torque / lever((0.0, 0.0, z)) + 60.0
        low, high = (z, high) if pushed > electrode_force(contact, z - 0.080) else (low, z)
    return electrode_force(contact, 0.5 * (low + high) - 0.080)


def electrode_force(contact: ContactParameters, depth: float) -> float:
    return 2.0 * contact.stiffness * depth + contact.hard_stop_stiffness * max(depth - contact.hard_stop, 0.0)


def settled(stiffness: float, step: float) -> tuple[float, float]:
    """(relative error of the settled contact force, largest speed left in m/s) for one contact stiffness and step."""
    contact = ContactParameters(stiffness=stiffness)
    arm = Arm(WorldParameters(servo=without_friction(), contact=contact, gravity_y=0.0), step)
    arm.go((0.0, 0.0, 0.070))
    arm.go((0.0, 0.0, 0.086), 2.0)
    exact = settled_exactly(arm.stiffness, contact, DELTA.inverse(0.0, 0.0, 0.086)[0])
    return arm.world.mechanics.contact_force / exact - 1.0, max(abs(v) for v in arm.world.mechanics.velocity)


def imbalance(stiffness: float, step: float) -> float:
    """Largest unbalanced force (N) after a step during contact, 25 mm of sliding and pulling off."""
    arm = Arm(WorldParameters(contact=ContactParameters(stiffness=stiffness)), step)
    points = [(0.0, 0.0, 0.07), (0.0, 0.0, 0.08), (0.0, 0.0, 0.088)]
    points += [(0.001 * side, 0.002 * side, 0.086) for side in range(1, 26)]
    points += [(0.025, 0.05, 0.086 - 0.002 * index) for index in range(25)]
    worst = 0.0
    for point in points:
        arm.aim(point, 2.8)
        for _ in range(max(1, round(0.2 / step))):
            arm.run(step)
            worst = max(worst, arm.world.mechanics.imbalance)
    return worst


def path(step: float) -> list[Vector]:
    """Platform positions every 100 ms of a 1.2 s docking with the default world."""
    arm = Arm(step=step)
    arm.go((0.0, 0.0, 0.06), 1.0)
    points = []
    for index in range(12):
        arm.go((0.0, 0.0, 0.06 + 0.026 * min((index + 1) / 8.0, 1.0)), 0.1)
        points.append(arm.world.mechanics.position)
    return points


def path_errors() -> Iterator[tuple[float, float, float]]:
    """(step s, rms distance from the path at 0.2 ms in mm, wall time ms of the 2.2 s) per step."""
    exact = path(0.0002)
    for step in STEPS:
        start = time.perf_counter()
        points = path(step)
        wall = 1000.0 * (time.perf_counter() - start)
        squares = [math.dist(a, b) ** 2 for a, b in zip(points, exact, strict=True)]
        yield step, 1000.0 * math.sqrt(statistics.mean(squares)), wall


def measure() -> dict[str, Any]:
    """Measure everything."""
    return {
        "cost_us": {str(step): cost(step) for step in (0.001, 0.005, 0.020)},
        "twenty_newtons_A": twenty_newtons(),
        "statics": {str(k): statics(k) for k in (2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0)},
        "magnets": {str(k): magnets(k) for k in (5.0, 10.0, 15.0, 20.0)},
        "magnets_without_friction": magnets(15.0, rubs=False),
        "settled": {f"{k:.0e}": {str(step): settled(k, step) for step in STEPS} for k in STIFFNESSES},
        "imbalance": {f"{k:.0e}": {str(step): imbalance(k, step) for step in STEPS} for k in STIFFNESSES},
        "path": {str(step): {"rms_mm": error, "wall_ms": wall} for step, error, wall in path_errors()},
    }


def show(figures: dict[str, Any]) -> None:
    """Print the tables of docs/simulation.md."""
    print("Cost of a step, µs\n")
    table("step s", figures["cost_us"], "{:.0f}")
    print(f"\n20 N at the dock: {figures['twenty_newtons_A']:.4f} A per servo\n\nStatics without friction\n")
    table("servo stiffness N·m/rad", figures["statics"], "{:.3f}")
    print("\nMagnets\n")
    table(
        "servo stiffness N·m/rad",
        {**figures["magnets"], "15, no friction": figures["magnets_without_friction"]},
        "{:.2f}",
    )
    print("\nError of the settled force, % (rows: contact stiffness N/m, columns: step s)\n")
    errors = {k: {step: 100.0 * value[0] for step, value in row.items()} for k, row in figures["settled"].items()}
    table("", errors, "{:+.5f}")
    fastest = max(value[1] for row in figures["settled"].values() for value in row.values())
    print(f"\nlargest speed left after 2 s: {fastest:.1e} m/s\n\nLargest imbalance while sliding and tearing off, N\n")
    table("", figures["imbalance"], "{:.1g}")
    print("\nPath of a docking against a step of 0.2 ms\n")
    table("step s", figures["path"], "{:.3f}")


def table(corner: str, rows: dict[str, dict[str, float]], form: str) -> None:
    columns = list(next(iter(rows.values())))
    print("| " + " | ".join([corner, *columns]) + " |\n|" + "---|" * (len(columns) + 1))
    for name, row in rows.items():
        print("| " + " | ".join([name, *(form.format(row[column]) for column in columns)]) + " |")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="one JSON object instead of tables")
    options = parser.parse_args()
    figures = measure()
    if options.json:
        print(json.dumps(figures))
    else:
        show(figures)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
