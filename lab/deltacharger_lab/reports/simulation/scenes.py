# SPDX-License-Identifier: Apache-2.0
"""Common parts of the simulation report: the models, an arm commanded by platform positions, and a docking."""

import functools
import importlib.util
import logging
import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from deltacharger_core.machine import SERVO_STIFFNESS, STALL_CURRENT, TORQUE_CONSTANT
from deltacharger_kinematics import geometry, scalar
from deltacharger_lab.mujoco.world import MujocoMechanics, mujoco_world
from deltacharger_sim.pads import approach
from deltacharger_sim.parameters import ContactParameters, ServoParameters, WorldParameters
from deltacharger_sim.world import World
from deltacharger_tactile.contact import ContactModel


def as_users_set_it(world: World) -> World:
    """Return the world with MuJoCo's usual settings, called "usual" in the report.

    The world's MuJoCo gives contacts a stiffness at rest (`solref` negative) and switches off the guard that keeps time
    constants at two steps or more (`refsafe`), so the stiffness is as requested at any step. A usual model keeps the
    guard and MuJoCo's automatic reset, and gives positive time constants, here those of the same springs, critically
    damped; if two steps are longer, the guard softens the contact instead of letting it diverge.
    """
    mechanics = world.mechanics
    assert isinstance(mechanics, MujocoMechanics)
    import mujoco

    model: Any = mechanics.model
    for flag in (mujoco.mjtDisableBit.mjDSBL_REFSAFE, mujoco.mjtDisableBit.mjDSBL_AUTORESET):
        model.opt.disableflags &= ~int(flag)
    for rows in (model.pair_solref, model.jnt_solref):
        for row in rows:
            if row[0] < 0.0:
                row[:] = (1.0 / math.sqrt(-row[0]), 1.0)
    return world


def was_reset(world: World) -> bool:
    """Return whether MuJoCo met numbers that it could not continue with, and was reset."""
    data: Any = getattr(world.mechanics, "data", None)
    return data is not None and any(int(warning.number) for warning in data.warning)


DELTA = scalar.ScalarDelta()
LIGHT = "light"
TICK = 0.1  # s between commands of the docking; every step of the report divides it
SAMPLE = 0.01  # s between compared positions, if the step allows
TRAVEL, PUSH = 0.060, 0.086  # m of command along z before and at the end of the docking
COMPARED = ServoParameters(friction_share=0.0)  # MuJoCo has no friction by load
_FAR = 0.3  # m from the origin that no arm reaches
PATH_TICKS, HOLD = 12, 1.0  # of the compared path; s of rest after it, until the force is read


def model_world(name: str, parameters: WorldParameters, step: float) -> World:
    """Return a world of the light model, or of MuJoCo with an integrator and steps of `step` s."""
    if name == LIGHT:
        return World(parameters)
    # The report measures where it diverges.
    logging.getLogger("deltacharger_lab.mujoco.world").setLevel(logging.ERROR)
    found = mujoco_world(parameters, step=step, integrator=name.split()[-1])
    return as_users_set_it(found) if "usual" in name else found


class Arm:
    """A world whose servos are commanded by platform positions, with a lead for the arm's weight."""

    def __init__(self, world: World, step: float) -> None:
        self.world = world
        self.step = step
        self.trace: list[geometry.Vector] = []
        self.used = 0.0
        values = world.parameters
        self.gravity = (values.gravity_x, values.gravity_y, values.gravity_z)

    def aim(self, point: geometry.Vector, bound: float = STALL_CURRENT, lead: bool = True) -> None:
        """Command all servos toward `point` (m, charger_base) with at most `bound` A each."""
        held = DELTA.holding_torque(*point, self.gravity) if lead else (0.0, 0.0, 0.0)
        stiffness = self.world.parameters.servo.stiffness
        goals = (angle + torque / stiffness for angle, torque in zip(DELTA.inverse(*point), held, strict=True))
        self.turn(goals, bound)

    def turn(self, goals: Iterable[float], bound: float = STALL_CURRENT) -> None:
        """Command the servos to angles (rad) with at most `bound` A each."""
        for index, goal in enumerate(goals):
            self.world.command(index, True, goal, bound)

    def release(self) -> None:
        """Take all torque off."""
        for index in range(3):
            self.world.command(index, False, 0.0, 0.0)

    def run(self, seconds: float, sample: float = math.inf) -> None:
        """Advance, keep the position every `sample` s, and add the processor time to `used` (s)."""
        every = max(1, round(sample / self.step)) if sample < math.inf else 0
        started = time.process_time()
        for index in range(1, max(1, round(seconds / self.step)) + 1):
            self.world.step(self.step)
            if every and index % every == 0:
                self.trace.append(self.world.mechanics.position)
        self.used += time.process_time() - started

    def go(self, point: geometry.Vector, seconds: float = 1.0, bound: float = STALL_CURRENT, lead: bool = True) -> None:
        """Aim and wait."""
        self.aim(point, bound, lead)
        self.run(seconds)

    @property
    def speed(self) -> float:
        """The fastest of the platform's velocities along the axes, m/s."""
        return max(map(abs, self.world.mechanics.velocity))

    def is_bounded(self) -> bool:
        """Return whether every number is finite and the platform within reach of any arm."""
        mechanics = self.world.mechanics
        numbers = (*mechanics.position, *mechanics.velocity, *mechanics.torques, mechanics.contact_force)
        return all(map(math.isfinite, numbers)) and max(map(abs, mechanics.position)) < _FAR

    def contact_current(self) -> float:
        """Per-servo current that pushes along +z (A), as docking computes it but without noise."""
        position = self.world.mechanics.position
        if math.isnan(position[0]):
            return math.nan
        held = DELTA.holding_torque(*position, self.gravity)
        push = [torque - hold for torque, hold in zip(self.world.mechanics.torques, held, strict=True)]
        force = DELTA.force(*position, (push[0], push[1], push[2]))[2]
        return force * sum(DELTA.jacobian(*position)[6:]) / (3.0 * TORQUE_CONSTANT)


def commanded(tick: int) -> float:
    """Return the z (m) that a tick of the docking commands."""
    return TRAVEL + (PUSH - TRAVEL) * min((tick + 1) / 8.0, 1.0)


def docking(model: str, parameters: WorldParameters, step: float) -> dict[str, Any]:
    """Approach, snap, push and hold: positions every SAMPLE, settled force and current, and run time.

    Returns:
        trace (list of m), force (N), peak (N), current (A), tilt (rad about x and y), share (of the left pad), speed
        (final, m/s; NaN if MuJoCo was reset), and the speed of one core relative to real time in
        motion (`moving`) and in total (`all`).
    """
    arm = Arm(model_world(model, parameters, step), step)
    arm.go((0.0, 0.0, TRAVEL), 1.0)
    arm.used = 0.0
    for tick in range(PATH_TICKS):
        arm.aim((0.0, 0.0, commanded(tick)))
        arm.run(TICK, max(SAMPLE, step))
    trace, moved = arm.trace, arm.used
    hold = HOLD * max(1.0, SERVO_STIFFNESS / parameters.servo.stiffness)
    arm.run(hold)
    mechanics = arm.world.mechanics
    return {
        "trace": trace,
        "force": mechanics.contact_force,
        "peak": arm.world.record.peak_force,
        "current": arm.contact_current(),
        "tilt": mechanics.tilt,
        "share": left_share(arm.world),
        "speed": math.nan if was_reset(arm.world) else arm.speed,
        "moving": PATH_TICKS * TICK / max(moved, 1e-6),
        "all": (PATH_TICKS * TICK + hold) / max(arm.used, 1e-6),
    }


def left_share(world: World) -> float:
    """Return the share of the force on the left pad, 0 to 1, by the contact model of straight ridges; NaN if apart."""
    mechanics, pose = world.mechanics, world.misalignment
    if pose is None or not all(map(math.isfinite, pose)):
        return math.nan
    tilt = (0.0, 0.0) if mechanics.lean is None else approach(mechanics.lean.residual)
    left, right = _contact_model().solve(pose, mechanics.contact_force, tilt)[0].sum(axis=(1, 2))
    return float(left / (left + right))


@functools.cache
def _contact_model() -> ContactModel:
    return ContactModel()


def rms(trace: Sequence[geometry.Vector], exact: Sequence[geometry.Vector]) -> float:
    """Return the rms distance (m) of positions from those of a finer or equal sampling of the same time."""
    every = len(exact) // len(trace)
    squares = [math.dist(place, exact[(index + 1) * every - 1]) ** 2 for index, place in enumerate(trace)]
    return math.sqrt(sum(squares) / len(squares))


def world(
    stiffness: float = 1e5, servo: float = SERVO_STIFFNESS, friction: float | None = None, **changes: Any
) -> WorldParameters:
    """Return parameters of a contact and servo stiffness; `friction` of the gears (N·m), None = default."""
    gears = replace(COMPARED, stiffness=servo, friction=COMPARED.friction if friction is None else friction)
    return WorldParameters(servo=gears, contact=ContactParameters(stiffness=stiffness), **changes)


def settled_exactly(parameters: WorldParameters, command: float) -> float:
    """Return the contact force (N) at rest on the axis, weightless, by bisection of springs and magnets.

    It uses no integrator; `command` is the commanded z (m), at which the target is touched.
    """
    goal, wall = DELTA.inverse(0.0, 0.0, command)[0], parameters.target.z
    low, high = wall, wall + 0.025
    for _ in range(200):
        z = 0.5 * (low + high)
        lever = sum(DELTA.jacobian(0.0, 0.0, z)[6:]) / 3.0
        pushed = parameters.servo.stiffness * (goal - DELTA.inverse(0.0, 0.0, z)[0]) / lever + parameters.magnets.force
        low, high = (z, high) if pushed > electrode_force(parameters.contact, z - wall) else (low, z)
    return electrode_force(parameters.contact, 0.5 * (low + high) - wall)


def electrode_force(contact: ContactParameters, depth: float) -> float:
    """Return the force (N) of both electrodes at a compression (m)."""
    return 2.0 * contact.stiffness * depth + contact.hard_stop_stiffness * max(depth - contact.hard_stop, 0.0)


MUJOCO = "MuJoCo discrete"
MUJOCO_FAST = "MuJoCo implicitfast"
MUJOCO_USUAL = "MuJoCo usual implicitfast"


@dataclass(frozen=True)
class SimulationPlan:
    """One report; the defaults are those of the committed one.

    Attributes:
        reference_step: of the tiny-step reference, s.
        steps: of the compared models, s.
        map_steps: of the stability map, s.
        map_contacts: its contact stiffnesses, N/m.
        map_servos: its servo stiffnesses, N·m/rad.
        strike_contacts: contact stiffnesses of the impacts, N/m.
        strike_servos: their servo stiffnesses, N·m/rad.
        strike_steps: of the world, s.
        repeats: minimum of every timing; the fastest counts.
        timing_s: processor time for which a timing is repeated.
        dockings: seeds of complete dockings for each model.
        docking_steps: of their worlds, s.
        quick: whether it is the short plan.
    """

    reference_step: float = 5e-5
    steps: tuple[float, ...] = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1)
    map_steps: tuple[float, ...] = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1)
    map_contacts: tuple[float, ...] = (1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9)
    map_servos: tuple[float, ...] = (2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0)
    strike_contacts: tuple[float, ...] = (1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9)
    strike_servos: tuple[float, ...] = (2.0, 2.5, 15.0, 40.0)
    strike_steps: tuple[float, ...] = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2)
    repeats: int = 5
    timing_s: float = 0.5
    dockings: tuple[int, ...] = (1, 2, 3, 4)
    docking_steps: tuple[float, ...] = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1)
    quick: bool = False


QUICK = SimulationPlan(
    reference_step=2e-4,
    steps=(1e-3, 5e-3, 1e-2, 1e-1),
    map_steps=(1e-3, 1e-2, 1e-1),
    map_contacts=(1e3, 1e5, 1e9),
    map_servos=(15.0,),
    strike_contacts=(1e3, 1e5, 1e6, 1e7),
    strike_servos=(15.0,),
    strike_steps=(5e-3, 1e-2, 2e-2),
    repeats=2,
    timing_s=0.2,
    dockings=(1,),
    docking_steps=(1e-2,),
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
    from deltacharger_lab.mujoco.world import integrators

    return (LIGHT, *(name for name in (MUJOCO, MUJOCO_FAST, MUJOCO_USUAL) if name.split()[-1] in integrators()))
