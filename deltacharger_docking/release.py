# SPDX-License-Identifier: Apache-2.0
"""Release from the magnets: pull, check that the platform follows, and pull again if not."""

from __future__ import annotations

import math
from dataclasses import replace

from deltacharger_core.machine import SERVO_STIFFNESS
from deltacharger_core.script import NEXT, Script
from deltacharger_docking.codes import DockingError, Stuck
from deltacharger_docking.context import Context
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.trajectory_feed import PULL_HORIZON, pull


def take_off(context: Context, z: float) -> Script[None]:
    """Pull the electrodes off the magnets and go straight back to `z` (m, charger_base).

    Soft electrodes follow the pull after the pads have lost contact, so only the way back shows whether the magnets
    have released. If the platform does not follow, it is pulled again, and farther.

    Raises:
        Stuck: the platform did not move within the allowed time.
        Unreachable: it was released where the arm has no way back; it holds there.
        ServoFailure: the position after release is unknown; it holds there.
    """
    parameters = context.parameters
    lacks = max((1.0 - parameters.return_share) * (context.measured()[2] - z), parameters.return_shortfall)
    first = min(_softness(context) * parameters.release_travel, parameters.spring_travel)
    for travel in (first, *[parameters.spring_travel] * (parameters.release_pulls_max - 1)):
        yield from release(context, travel)
        x, y, _ = context.position
        yield from context.move((x, y, z), parameters.travel_speed, settle=False)
        end = context.time + context.springs.settle_time
        while context.position[2] > z + lacks and context.time < end:
            yield NEXT
        if not context.position[2] > z + lacks:
            return
    raise _stuck(context)


def lift_off(context: Context, pull: bool = False) -> Script[None]:
    """Pull off the magnets if there is contact or `pull` is set, then go straight back, to allow sideways moves."""
    parameters = context.parameters
    x, y, z = context.measured()
    clear = min(max(z - parameters.lift, parameters.home_z), z)
    if pull or context.observation.tactile_contact or abs(context.contact.value) > parameters.free_current:
        yield from take_off(context, clear)
    else:
        context.commanded = x, y, z
        yield from context.move((x, y, clear), parameters.travel_speed, settle=False)
    context.status.docked = False


def release(context: Context, travel: float) -> Script[None]:
    """Pull the electrodes off the magnets until the platform has moved back by `travel` m.

    A servo jumps if its bound rises while its current is clipped. So the goal first moves behind the measured position
    under the push bound; only then may it pull. The bound drops as soon as the platform has moved.

    Raises:
        DockingError: as for `take_off`.
    """
    parameters, geometry = context.parameters, context.kinematics.geometry
    while not all(map(math.isfinite, context.observation.angles)):
        yield NEXT
    context.feed.stop()
    x, y, z = context.position
    lead = parameters.release_current * context.springs.compliance
    a, b, c = (max(angle - lead, geometry.joint_min) for angle in context.observation.angles)
    goal = a, b, c
    begun, pushed = context.time, context.contact.value
    yield from _pull(context, goal, parameters.push_current, z - travel, parameters.setting_back_time)
    yield from _pull(context, goal, parameters.release_current, z - travel, parameters.release_time)
    if not _is_off(context, z - travel):
        raise _stuck(context)
    context.decide(
        "released",
        "the electrodes are released",
        contact_current_A=pushed,
        pull_bound_A=parameters.release_current,
        time_s=context.time - begun,
    )
    try:
        free = context.measured()
        context.commanded = (x, y, free[2] - _softness(context) * parameters.release_behind)
        line = context.planner.line(free, context.commanded, parameters.travel_speed)
    except DockingError:
        context.hold()  # ends the pull
        raise
    context.follow(line, retreats=True)
    if context.is_blind:
        context.send_piece((replace(line[-1], time=0.0),))  # ends the pull here also
    yield NEXT


def _softness(context: Context) -> float:
    """Return how much softer than usual the servos are, at least 1: magnets pull a soft arm back from farther away."""
    return max(SERVO_STIFFNESS / context.springs.stiffness, 1.0)


def _is_off(context: Context, z: float) -> bool:
    """Return whether the platform is back at `z` m; with contact at the pads, farther by the travel of springs."""
    observation, parameters = context.observation, context.parameters
    held = observation.tactile_contact and observation.tactile_age <= parameters.tactile_age_max
    return context.position[2] <= (z - (parameters.spring_travel - parameters.release_travel) if held else z)


def _pull(context: Context, goal: Vector, current: float, z: float, seconds: float) -> Script[None]:
    """Pull toward the angles `goal` for this time, or until the platform is off at `z` m.

    The pull is sent in every tick and lapses by itself, so it ends if docking stops or servo_state is missing. Time
    without a pull does not count here; it counts for the phase.
    """
    constant = context.parameters.torque_constant
    bound, push = ((each * constant,) * 3 for each in (current, context.parameters.push_current))
    last, left = context.time, seconds
    while left > 0.0 and not _is_off(context, z):
        observation = context.observation
        known = observation.servos_valid and observation.servo_age <= context.parameters.press_age_max
        if known:
            context.send_piece(pull(goal, bound, _standing(context), push))
        yield NEXT
        left -= min(context.time - last, PULL_HORIZON) if known else 0.0  # a pull lapses after PULL_HORIZON
        last = context.time


def _standing(context: Context) -> Vector:
    """Return the angles (rad) that keep the arm in place, with its weight compensated."""
    geometry, stiffness = context.kinematics.geometry, context.springs.stiffness
    held = context.kinematics.holding_torque(*context.position, context.parameters.gravity)
    wanted = (angle + torque / stiffness for angle, torque in zip(context.observation.angles, held, strict=True))
    a, b, c = (min(max(angle, geometry.joint_min), geometry.joint_max) for angle in wanted)
    return a, b, c


def _stuck(context: Context) -> Stuck:
    context.hold()
    context.decide("stuck", "the magnets do not release", contact_current_A=context.contact.value)
    parameters = context.parameters
    return Stuck(
        f"the magnets held against {parameters.release_current:.1f} A per servo for "
        f"{parameters.release_time:.1f} s; move the target away by hand or raise release_current"
        f"{context.springs.contradiction}"
    )
