# SPDX-License-Identifier: Apache-2.0
"""Leaving the target: release from the magnets, and the way home.

The release pulls at once, holds until the platform rests beyond the magnets' reach, and proves that it is apart.
Targets yield on their wheels, so travel alone proves nothing: the pads show whether the electrodes still touch. A hard
pull parts even a robot that rolls, because its mass resists before its wheels turn.
"""

import math

import numpy as np

from deltacharger_core.script import NEXT, Script
from deltacharger_docking import codes, contact, energy, watch
from deltacharger_docking.context import REACH, SERVICE_TIMEOUT, Context
from deltacharger_docking.observation import Service
from deltacharger_kinematics import geometry, trajectory_feed

FREE_CURRENT = 0.06  # A, largest size of the contact current in free air
LIFT = 0.008  # m that the platform lifts before it moves sideways; chosen on seeds of the family 777001, then 5 and 19
RELEASE_CURRENT = 4.0  # A, current bound of each servo during release; from statics, then seeds 5 and 19
_RELEASE_TIME = 1.0  # s, longest pull against the magnets
BACK = 0.012  # m from where it first touched or parted: the arm swings by half of it when it stops there
_FARTHEST = 0.025  # m that a braked target follows at most: 5 N/mm and 2 mm of play under push and magnets
_FOLLOWS = 0.010  # m from which one that did not part counts as rolling
_SET_BACK = 0.05  # s in which the goal moves behind the platform, under the push bound
_PULLS = 3  # after which a platform that does not move is stuck
_SAME_FRAME = 0.001  # s between two dates of one tactile frame
_STILL = 0.0001  # m between two readings of a platform at rest


def take_off(context: Context, z: float) -> Script[None]:
    """Pull the electrodes off the magnets, and stay where they came to rest, or go on to `z` (m, charger_base).

    Raises:
        Stuck: the platform did not move within the allowed time, or is at home, where there is no way back.
        TargetRolls: the target came along.
        Astray: servo_state repeats one reading.
        TactileStale: the pads repeat one frame.
        Unreachable: it was released where the arm has no way back; it holds there.
        ServoFailure: the position after release is unknown; it holds there.
    """
    if _is_home(context):
        raise codes.Stuck(
            "the pads feel contact at home, so nothing was moved: move away what touches them, or check them"
        )
    for _ in range(_PULLS):
        context.lets_go = True
        try:
            yield from _release(context)
        finally:
            context.lets_go = False
            context.contact.clear()  # of what pulled and braked
        x, y, away = context.commanded
        if away > z:
            yield from context.move((x, y, z), context.parameters.travel_speed, settle=False)
        near = min(z, away) + REACH
        is_off = lambda near=near: not touches(context) and context.position[2] <= near  # noqa: E731
        if (yield from context.until(is_off, context.springs.settle_time)):
            return
    raise _stuck(context)


def lift_off(context: Context, pull: bool = False) -> Script[None]:
    """Pull off the magnets if there is contact or `pull` is set, then go straight back, to allow sideways moves.

    Raises:
        DockingError: as for `take_off`.
    """
    parameters = context.parameters
    x, y, z = context.measured()
    clear = min(max(z - LIFT, parameters.home_z), z)
    pushes = context.observation.tactile_contact or abs(context.contact.value) > FREE_CURRENT
    if touches(context) or ((pull or pushes) and not _is_home(context)):
        yield from take_off(context, clear)
    else:
        context.commanded = x, y, z
        yield from context.move((x, y, clear), parameters.travel_speed, settle=False)
    context.status.docked = False


def _is_home(context: Context) -> bool:
    lowest = max(context.parameters.home_z, context.kinematics.geometry.workspace_min[2])
    return context.position[2] < lowest + BACK


def _release(context: Context) -> Script[None]:
    """Pull the electrodes off the magnets, and hold until the platform rests beyond their reach.

    A servo jumps if its bound rises while its current is clipped. So the goal first moves behind the measured position
    under the push bound; only then may it pull. If docking ends meanwhile, an arm that flies goes on to where it would
    have come to rest: where it was last seen, the magnets would draw it in again.

    Raises:
        DockingError: as for `take_off`.
    """
    parameters, kinematics = context.parameters, context.kinematics
    while not all(map(math.isfinite, context.observation.angles)):
        yield NEXT
    context.feed.stop()
    x, y, z = context.position
    pushing = parameters.push_current
    first, last = (_behind(context, current) for current in (pushing, RELEASE_CURRENT))
    free = (z if math.isnan(context.touched) else min(z, context.touched)) - BACK  # a target that yielded swings back
    behind = kinematics.inverse(x, y, free)
    rest = behind if math.isfinite(behind[0]) else None
    begun, pushed = context.time, context.contact.value
    parted = yield from _pull(context, first, pushing, _SET_BACK, z, rest)
    pattern, pulled = context.observation.taxels, context.time
    if context.position[2] > parted - REACH:
        most, seconds = RELEASE_CURRENT, _RELEASE_TIME
        parted = yield from _pull(context, last, most, seconds, parted, rest)
    here, frame = context.measured(), context.observation.taxels
    came = here[2] > parted - REACH
    frozen = came and pattern is not None and frame is not None and np.array_equal(pattern, frame, equal_nan=True)
    if came and here[2] > z - _FOLLOWS:
        context.check_moved(pulled)
        raise _stuck(context)
    if came and not frozen:
        raise watch.rolls(context, f"it came {1000 * (z - here[2]):.0f} mm along with the magnets")
    context.decide(
        "released",
        "the electrodes are released",
        contact_current_A=pushed,
        pull_bound_A=RELEASE_CURRENT,
        time_s=context.time - begun,
        followed_m=z - parted,
    )
    context.commanded = back = (x, y, min(here[2], max(min(parted - BACK, free), parameters.home_z)))
    try:
        goal = context.planner.line(here, back, parameters.travel_speed)[-1]
    except codes.DockingError:
        context.hold()  # ends the pull
        raise
    most = RELEASE_CURRENT * parameters.torque_constant
    yield from _come_to_rest(context, goal.angles, (most, most, most), back)
    if frozen:
        raise codes.TactileStale("the pads repeat one frame, so nothing shows what they touch; restart the board")


def _behind(context: Context, current: float) -> geometry.Vector:
    """Return the goals (rad) that pull back with `current` (A) from the present angles."""
    lead, lowest = current * context.springs.compliance, context.kinematics.geometry.joint_min
    a, b, c = (max(angle - lead, lowest) for angle in context.observation.angles)
    return a, b, c


def _come_to_rest(
    context: Context, goal: geometry.Vector, bound: geometry.Vector, back: geometry.Vector
) -> Script[None]:
    """Hold `goal` (rad) until the platform, flying off the magnets, rests near `back` (m), or as long as it swings."""
    end, before, rest = context.time + context.springs.settle_time, math.inf, context.kinematics.inverse(*back)
    near = back[2] + REACH
    while context.time < end and not (abs(context.position[2] - before) < _STILL and context.position[2] < near):
        before = context.position[2]
        context.pull(goal, bound, rest)
        yield NEXT


def touches(context: Context) -> bool:
    """Return whether fresh frames of tared pads show contact."""
    seen, oldest = context.observation, contact.PRESS_AGE_MAX
    return seen.tared and seen.tactile_contact and seen.tactile_age <= oldest


def _pull(
    context: Context, goal: geometry.Vector, current: float, seconds: float, parted: float, rest: geometry.Vector | None
) -> Script[float]:
    """Pull toward the angles `goal` for this time, or until the platform is out of the magnets' reach.

    The pull is sent in every tick and lapses by itself, to `rest`, so it ends if docking stops or servo_state is
    missing. Time without a pull does not count here; it counts for the phase.

    Returns:
        z (m) where the pads last touched, at first `parted`.
    """
    constant = context.parameters.torque_constant
    bound = (current * constant,) * 3
    last, left, start, newest = context.time, seconds, parted, -math.inf
    while left > 0.0:
        z, observation = context.position[2], context.observation
        sampled = context.time - observation.tactile_age
        if not touches(context):
            if z <= parted - REACH:
                break
        elif sampled > newest + _SAME_FRAME:  # an earlier frame does not show that the target came along until now
            newest, parted = sampled, min(parted, z)
            if z < start - _FARTHEST or _is_home(context):
                break
        known = observation.servos_valid and observation.servo_age <= contact.PRESS_AGE_MAX
        if known:
            context.pull(goal, bound, rest)
        yield NEXT
        left -= (
            min(context.time - last, trajectory_feed.PULL_HORIZON) if known else 0.0
        )  # a pull lapses after PULL_HORIZON
        last = context.time
    return parted


def _stuck(context: Context) -> codes.Stuck:
    context.hold()
    context.decide("stuck", "the magnets do not release", contact_current_A=context.contact.value)
    return codes.Stuck(
        f"the magnets held against {RELEASE_CURRENT:.1f} A per servo for "
        f"{_RELEASE_TIME:.1f} s; move the target away by hand, or use weaker magnets"
    )


RETRACT_TIMEOUT = 20.0  # s, limit for RETRACT
_OFF_TIME = 0.1  # s: servo_node switches the torque off within some cycles


def retract(context: Context, wanted: bool = False) -> Script[None]:
    """Open the contactor, confirm it, release the magnets, go home and switch the torque off.

    Args:
        context: shared state.
        wanted: a client requested it; then the torque is also switched on for a limp arm away from home.
    """
    parameters = context.parameters
    context.enter(codes.State.RETRACT, math.inf)
    context.evidence.forget()
    yield from energy.de_energise(context)  # has its own limit: the phase must not expire while electrodes may be live
    if wanted:
        yield from context.answered()
    context.deadline = context.time + RETRACT_TIMEOUT
    while contact.PRESS_AGE_MAX < context.observation.servo_age <= parameters.age_max:
        yield NEXT
    observation = context.observation
    if observation.servo_age > parameters.age_max or observation.hardware_error:
        context.status.docked &= observation.tactile_contact  # the magnets still hold it
        yield from go_limp(context)
        return
    strayed = math.dist(context.measured(), parameters.home) > LIFT and wanted
    needed = strayed or observation.tactile_contact
    if needed and not observation.torque_enabled:
        yield from context.torque_on()
    if needed or observation.torque_enabled:
        begun = context.time
        yield from lift_off(context, pull=strayed and not observation.torque_enabled)
        context.touched = math.nan
        yield from context.move(parameters.home, parameters.travel_speed, settle=False)
        yield from context.wait(context.springs.settle_time)
        if touches(context) or context.touched - context.felt > REACH:  # at the end it may touch too lightly to feel
            raise watch.rolls(context, "it followed the arm home")
        away = math.dist(context.position, parameters.home)
        context.decide("retracted", "the arm is home" if away <= LIFT else "the arm stayed", away_m=away)
        if away > LIFT:
            context.check_moved(begun)
            raise codes.Stuck(f"the arm stayed {1000 * away:.0f} mm from home; free it from the target by hand")
    context.status.docked = False
    yield from energy.prove_dead(context)
    reply = yield from context.ask(Service.TORQUE_OFF, codes.ServoFailure, SERVICE_TIMEOUT)
    if not reply.success:
        raise codes.ServoFailure(f"the servos' torque was not switched off: {reply.message}")
    # Otherwise the next goal could read an old servo_state and send a trajectory to limp servos.
    if not (yield from context.until(lambda: not context.observation.torque_enabled, parameters.age_max)):
        raise codes.ServoFailure("servo_state still reports torque on; check servo_node, or cut the servos' power")
    context.decide("limp", "the servos' torque is off")
    if touches(context):  # it rolled on until now
        raise watch.rolls(context, "it followed the arm home")


def go_limp(context: Context) -> Script[None]:
    """Hold, order the torque off without waiting for the reply, and wait until servo_node must have done it."""
    context.hold()
    context.decide("limp", "the servos are ordered to switch their torque off where the arm is")
    context.send(Service.TORQUE_OFF)
    yield from context.wait(_OFF_TIME)
