# SPDX-License-Identifier: Apache-2.0
"""Energy: a charger that is not driven never gains any; its losses are listed part by part."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from deltacharger_kinematics.geometry import LIMB_DIRECTIONS, Vector
from deltacharger_lab.reports.simulation.scenes import Arm
from deltacharger_sim.mechanics import END_STOP, GEAR_BRISTLE, Mechanics
from deltacharger_sim.parameters import MagnetParameters, ServoParameters, WorldParameters
from deltacharger_sim.touch import LATERAL_MOST
from deltacharger_sim.world import World

PARTS = ("servos' damping", "gears' viscosity", "gears' friction", "electrodes' friction", "the step itself")
_NONE = MagnetParameters(force=0.0)


def scenes() -> dict[str, tuple[WorldParameters, Vector, tuple[Vector, ...]]]:
    """Return by name: parameters, start position of the arm, and commands for 1.5 s after it (none = limp)."""
    limp = ServoParameters(unpowered_friction=0.0, friction=0.0)
    falling = WorldParameters(servo=limp, magnets=_NONE, gravity_y=-4.0, gravity_z=6.0)
    rubbing = ServoParameters(unpowered_friction=0.02)
    sliding = WorldParameters(servo=rubbing, magnets=_NONE, gravity_x=5.0, gravity_y=-3.0, gravity_z=8.0)
    return {
        "limp, falls onto target and stops": (falling, (0.0, 0.0, 0.05), ()),
        "limp, swings off centre": (falling, (0.03, 0.0, 0.05), ()),
        "limp with friction, slides on the target": (sliding, (0.0, 0.02, 0.07), ()),
        "servos hold a goal, magnets snap": (WorldParameters(), (0.0, 0.0, 0.072), ((0.0, 0.0, 0.079),)),
    }


def scene(name: str, step: float) -> dict[str, Any]:
    """Return the energy balance (J) of a scene at a step (s).

    Returns:
        released (energy that can be lost), gain (largest rise above the lowest energy so far), lost by part, and the
        course of the energy above its end.
    """
    parameters, start, commands = scenes()[name]
    arm = Arm(World(parameters), step)
    arm.go(start, 1.5)
    arm.release() if not commands else arm.aim(commands[0])
    goals = None if not commands else arm.world._reference
    course, lost = [energy(arm.world, goals)], dict.fromkeys(PARTS, 0.0)
    for _ in range(round(1.5 / step)):
        now = _light(arm.world)
        before = now.position, now.angles, now.gear, now.rub
        arm.world.step(step)
        _dissipated(arm.world, before, step, lost)
        course.append(energy(arm.world, goals))
    gain = float(np.max(course - np.minimum.accumulate(course)))
    lost["the step itself"] = course[0] - course[-1] - sum(lost.values())
    released = course[0] - min(course)
    every = max(1, len(course) // 150)
    kept = [[index * step, value - course[-1]] for index, value in enumerate(course)][::every]
    return {"scene": name, "step": step, "released": released, "gain": gain, "lost": lost, "course": kept}


def _light(arm: World) -> Mechanics:
    assert isinstance(arm.mechanics, Mechanics)  # the only one that reports its friction
    return arm.mechanics


def _dissipated(arm: World, before: Any, step: float, lost: dict[str, float]) -> None:
    """Add the loss of each part in a step: its work minus the energy in its bristle."""
    mechanics, servo, contact = _light(arm), arm.parameters.servo, arm.parameters.contact
    position, angles, gears, rub = before
    for index in range(3):
        turned = mechanics.angles[index] - angles[index]
        gear = mechanics.gear[index]
        held = 0.5 * (gear * gear - gears[index] ** 2) / GEAR_BRISTLE
        lost["gears' friction"] += -gear * turned - held
        lost["gears' viscosity"] += servo.viscosity * turned * turned / step
        if arm._enabled[index]:
            lost["servos' damping"] += servo.damping * turned * turned / step
    side = min(2.0 * contact.stiffness, LATERAL_MOST)
    for index in range(2):
        moved = mechanics.position[index] - position[index]
        held = 0.5 * (mechanics.rub[index] ** 2 - rub[index] ** 2) / side
        lost["electrodes' friction"] += -mechanics.rub[index] * moved - held


def energy(arm: World, goals: Vector | None) -> float:
    """Return kinetic, elastic, magnetic energy and weight (J); `goals` (rad) of holding servos, None = limp.

    The servos' springs count while no current bound is reached.
    """
    mechanics, parameters, geometry = _light(arm), arm.parameters, arm.geometry
    mass = geometry.platform_mass + 1.5 * geometry.rod_mass
    gravity = (parameters.gravity_x, parameters.gravity_y, parameters.gravity_z)
    total = 0.5 * mass * sum(speed * speed for speed in mechanics.velocity)
    total += 0.5 * parameters.servo.inertia * sum(rate * rate for rate in mechanics.rates)
    total -= mass * sum(pull * place for pull, place in zip(gravity, mechanics.position, strict=True))
    elbow = 0.5 * geometry.rod_mass * geometry.arm
    for index, (angle, (cosine, sine)) in enumerate(zip(mechanics.angles, LIMB_DIRECTIONS, strict=True)):
        out = gravity[0] * cosine + gravity[1] * sine
        total -= elbow * (gravity[2] * math.sin(angle) + out * math.cos(angle))
        beyond = max(geometry.joint_min - angle, angle - geometry.joint_max, 0.0)
        total += 0.5 * END_STOP * beyond * beyond + 0.5 * mechanics.gear[index] ** 2 / GEAR_BRISTLE
        if goals is not None:
            total += 0.5 * parameters.servo.stiffness * (goals[index] - angle) ** 2
    return total + _contact_energy(arm)


def _contact_energy(arm: World) -> float:
    mechanics, contact, magnets = _light(arm), arm.parameters.contact, arm.parameters.magnets
    depth = max(-mechanics.gap, 0.0)
    total = contact.stiffness * depth * depth
    total += 0.5 * contact.hard_stop_stiffness * max(depth - contact.hard_stop, 0.0) ** 2
    total += 0.5 * (mechanics.rub[0] ** 2 + mechanics.rub[1] ** 2) / min(2.0 * contact.stiffness, LATERAL_MOST)
    open_gap = max(mechanics.gap, 0.0)
    return total - magnets.force * (magnets.range / (1.0 + open_gap / magnets.range) + depth)
