# SPDX-License-Identifier: Apache-2.0
"""Scenes at the limits of the world's inputs, each with the law that it must keep."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from deltacharger_core.machine import GRAVITY, MAGNET_FORCE, TORQUE_CONSTANT
from deltacharger_kinematics.geometry import Vector
from deltacharger_lab.reports.simulation.impact import axis_extreme
from deltacharger_lab.reports.simulation.scenes import COMPARED, DELTA, Arm, model_world, world
from deltacharger_lab.reports.simulation.stability import REST
from deltacharger_sim.parameters import (
    LEVER,
    ContactParameters,
    MagnetParameters,
    TargetParameters,
    WorldParameters,
)
from deltacharger_sim.world import World

STEPS = (0.001, 0.005, 0.01, 0.1)
_FREE = TargetParameters(present=False)
_NO_PULL = MagnetParameters(force=0.0)
_CORNER = (0.055, 0.055, 0.1)
_TILT = math.radians(30.0)

Verdict = tuple[bool, str]
"""Whether the law holds, and the figure that shows it."""


@dataclass(frozen=True)
class ExtremeScene:
    """One extreme.

    Attributes:
        name: of the scene.
        law: that it must keep.
        parameters: of its world.
        play: moves the arm; returns whether the law holds, and the figure that shows it.
    """

    name: str
    law: str
    parameters: WorldParameters
    play: Callable[[Arm], Verdict]


def judge(index: int, name: str, step: float) -> dict[str, Any]:
    """Play SCENES[index] with a model and return scene, law, model, step, ok and about."""
    scene = SCENES[index]
    arm = Arm(model_world(name, scene.parameters, min(step, 0.001) if name != "light" else step), step)
    ok, about = scene.play(arm)
    ok = ok and arm.is_bounded()
    return {"scene": scene.name, "law": scene.law, "model": name, "step": step, "ok": ok, "about": about}


def _carries(point: Vector, lead: bool = True) -> Callable[[Arm], Verdict]:
    """At rest the servos carry exactly the weight, and the led arm is at its goal."""

    def play(arm: Arm) -> Verdict:
        arm.go(point, 3.0, lead=lead)
        mechanics = arm.world.mechanics
        held = DELTA.holding_torque(*mechanics.position, arm.gravity)
        off = max(abs(a - b) for a, b in zip(held, mechanics.torques, strict=True))
        away = math.dist(mechanics.position, point)
        return off < 1e-4 and (away < 1e-5 or not lead), f"{off:.1e} N·m off, {1000.0 * away:.3g} mm from its goal"

    return play


def _mirrored(arm: Arm) -> Verdict:
    """The sag under the reversed gravity is the mirror image of the light model's under the usual one."""
    usual = Arm(World(replace(arm.world.parameters, gravity_y=GRAVITY[1])), arm.step)
    for each in (arm, usual):
        each.go((0.0, 0.0, 0.08), 3.0, lead=False)
    sag, mirrored = (1000.0 * each.world.mechanics.position[1] for each in (arm, usual))
    return abs(sag + mirrored) < 0.01, f"{sag:+.4f} mm of sag; {abs(sag + mirrored):.1e} mm from the mirror image"


def _impact(arm: Arm) -> Verdict:
    arm.go((0.0, 0.0, 0.07), 1.0)
    arm.aim((0.0, 0.0, 0.1))
    arm.run(2.0)
    peak = arm.world.record.peak_force
    most = 3.0 * arm.world.parameters.servo.stall_torque / LEVER + MAGNET_FORCE
    settled = arm.world.mechanics.contact_force
    exact = axis_extreme(arm.world.parameters).peak
    about = f"peak {peak:.0f} N (converged {exact:.0f}), settles at {settled:.1f} N, {arm.speed:.0e} m/s left"
    return arm.speed < REST and 60.0 < settled < most, about


def _slides(lowest: float, highest: float) -> Callable[[Arm], Verdict]:
    """Pushed sideways by 20 mm of command, the platform follows by a share between two bounds."""

    def play(arm: Arm) -> Verdict:
        arm.go((0.0, 0.0, 0.07), 1.0)
        arm.go((0.0, 0.0, 0.0865), 1.0)
        arm.go((0.02, 0.0, 0.0865), 2.0)
        moved = arm.world.mechanics.position[0] / 0.02
        return (
            lowest <= moved <= highest and arm.speed < REST,
            f"{100.0 * moved:.2f} % of the way, {arm.speed:.0e} m/s left",
        )

    return play


def _no_side(arm: Arm) -> Verdict:
    """Pushed sideways without friction, the arm rests with its servos pressing only along z."""
    arm.go((0.0, 0.0, 0.07), 1.0)
    arm.go((0.0, 0.0, 0.0865), 1.0)
    arm.go((0.02, 0.0, 0.0865), 2.5)
    mechanics = arm.world.mechanics
    side = math.hypot(*DELTA.force(*mechanics.position, mechanics.torques)[:2])
    about = f"{side:.0e} N sideways at x = {1e3 * mechanics.position[0]:.2f} mm"
    return side < 1e-2 and mechanics.contact_force > 0.0, about


def _corner(arm: Arm) -> Verdict:
    x, y, z = _CORNER
    arm.go((x, y, z - 0.01), 1.5)
    arm.go((x, y, z + 0.005), 2.5)
    mechanics = arm.world.mechanics
    force = DELTA.force(*mechanics.position, mechanics.torques)[2]
    off = abs(force - mechanics.contact_force)
    return off < 1e-2 and mechanics.contact_force > 5.0, f"{mechanics.contact_force:.2f} N; servos {off:.1e} N off"


def _edges(arm: Arm) -> Verdict:
    """Commands to corners of the joints' range and beyond, past nearly singular poses: it ends within its stops."""
    geometry = arm.world.geometry
    low, high, nearest = geometry.joint_min, geometry.joint_max, 1.0
    for goals in ((3.0, 3.0, 3.0), (low, high, high), (-3.0, -3.0, 3.0), (high, low, low), (low, low, low)):
        arm.turn(goals)
        for _ in range(max(1, round(1.0 / max(arm.step, 0.01)))):
            arm.run(max(arm.step, 0.01))
            solved = DELTA.solve_forward(*arm.world.mechanics.angles)
            nearest = min(nearest, abs(solved[2]) if solved else nearest)
    beyond = max(max(angle - high, low - angle) for angle in arm.world.mechanics.angles)
    about = f"{max(beyond, 0.0):.1e} rad beyond a stop; smallest determinant of the rods {nearest:.2g}"
    return beyond < 0.01, about


def _one_limp(arm: Arm) -> Verdict:
    arm.go((0.0, 0.0, 0.07), 1.0)
    arm.go((0.0, 0.0, 0.0865), 1.0)
    arm.world.command(1, False, 0.0, 0.0)
    arm.run(2.0)
    mechanics = arm.world.mechanics
    ok = abs(mechanics.torques[1]) < 1e-9 and arm.speed < REST and mechanics.contact_force > 0.0
    return ok, f"{mechanics.contact_force:.1f} N, {arm.speed:.0e} m/s left"


def _not_a_number(arm: Arm) -> Verdict:
    arm.go((0.0, 0.0, 0.05), 2.0)
    before = arm.world.mechanics.position
    arm.turn([math.nan] * 3)
    arm.run(0.5)
    arm.turn([math.inf] * 3)
    arm.run(0.5)
    moved = math.dist(before, arm.world.mechanics.position)
    return moved < 1e-5, f"moves by {moved:.1e} m"


def _no_bound(arm: Arm) -> Verdict:
    arm.go((0.0, 0.0, 0.05), 1.0)
    arm.turn([0.3] * 3, math.nan)
    arm.run(0.5)
    torque = max(map(abs, arm.world.mechanics.torques)) / TORQUE_CONSTANT
    return torque < 1e-9, f"{torque:.1e} A"


def _snaps(arm: Arm) -> Verdict:
    arm.go((0.0, 0.0, 0.079), 2.0)
    arm.go((0.0, 0.0, 0.081), 2.0)
    mechanics = arm.world.mechanics
    ok = mechanics.contact_force > 250.0 and arm.speed < REST
    return ok, f"{mechanics.contact_force:.1f} N, {arm.speed:.0e} m/s left"


_SLIPPERY = replace(COMPARED, friction=0.0)


def _hung(**gravity: Any) -> WorldParameters:
    """Return a world without friction and target, in which the arm hangs."""
    return WorldParameters(servo=_SLIPPERY, target=_FREE, **gravity)


_WEIGHT = "at rest the servos carry the weight"
_LEANING = _hung(gravity_y=GRAVITY[1] * math.cos(_TILT), gravity_z=GRAVITY[1] * math.sin(_TILT))
_ICE = WorldParameters(servo=_SLIPPERY, contact=ContactParameters(friction=0.0), gravity_y=0.0)
_AT_CORNER = replace(_ICE, magnets=_NO_PULL, target=TargetParameters(x=_CORNER[0], y=_CORNER[1], z=_CORNER[2]))
_STICKY = WorldParameters(servo=COMPARED, contact=ContactParameters(friction=10.0))
_SNAPPY = replace(world(), magnets=MagnetParameters(force=300.0, range=0.0002), target=TargetParameters(z=0.08))
_BEYOND = "all joints to and beyond their limits, nearly singular"
_ASIDE = (0.02, 0.01, 0.08)
SCENES = (
    ExtremeScene("base tilted by 30°", _WEIGHT, _LEANING, _carries(_ASIDE)),
    ExtremeScene("no gravity", "at rest no torque", _hung(gravity_y=0.0), _carries(_ASIDE)),
    ExtremeScene("gravity reversed", "sags the other way by as much", _hung(gravity_y=-GRAVITY[1]), _mirrored),
    ExtremeScene("20 mm beyond the target at full speed", "comes to rest", world(), _impact),
    ExtremeScene("the same on 1e9 N/m", "comes to rest", world(1e9), _impact),
    ExtremeScene("the same on 1e3 N/m", "comes to rest", world(1e3), _impact),
    ExtremeScene("no friction anywhere, pushed sideways", "rests without lateral force", _ICE, _no_side),
    ExtremeScene("friction of 10, pushed sideways", "holds", _STICKY, _slides(-0.001, 0.02)),
    ExtremeScene("contact at a corner of the workspace", "servos and contact press alike", _AT_CORNER, _corner),
    ExtremeScene(_BEYOND, "ends at the stops", world(target=_FREE), _edges),
    ExtremeScene("one servo without power while docked", "stays docked", world(), _one_limp),
    ExtremeScene("goals that are NaN and infinite", "nothing moves", world(), _not_a_number),
    ExtremeScene("current bound NaN", "no current", world(), _no_bound),
    ExtremeScene("magnets of 300 N that reach 0.2 mm", "snaps and rests", _SNAPPY, _snaps),
)
