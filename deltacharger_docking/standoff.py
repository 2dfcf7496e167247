# SPDX-License-Identifier: Apache-2.0
"""What the arm shows of itself in free air before it touches: how its servos brake, what its gears and cable rub.

First the goals jump, and each servo's readings show its damping, whatever its gear rubs: with a goal that stands, Kt I
= k (goal − angle) − d ω. At the standoff the platform is weighed on a way back and on the way forward again; half of
the difference is friction. The last reading, at rest after a motion along +z, is the tare: friction then has the sign
of pushing.
"""

import math
from itertools import permutations

from deltacharger_core.script import NEXT, Script
from deltacharger_docking import arm, codes, release
from deltacharger_docking.context import SETTLE_TOUCHING, Context
from deltacharger_kinematics import swing as swings
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.swing import SwingReading

# Chosen on seeds of the family 777001, then 5 and 19.
_APPROACH_SPEED = 0.18  # m/s, peak speed toward the standoff, at which a target nearer than told is met
# Chosen on seeds 5 and 43.
_RUN_UP_SPEED = 0.045  # m/s, peak speed of the run-up before the tare
_RUN_UP = 0.004  # m, travel along +z before the tare: gives friction the sign of pushing

APPROACH_TIMEOUT = 20.0  # s, limit for APPROACH
_MOST_DAMPED = 3.0  # times what is critical; such a servo creeps, and a D gain that high makes its current chatter
_JUMP_CURRENT, _LONGEST_JUMP = 0.9, 0.35  # A and rad: twice what sound gears rub, and 40 mm
_FREE = 0.9  # of the torque bound, below which a current follows the error
_LATE, _HEARD = 0.15, 0.005  # s until a servo hears of a jump at the latest; rad that show it
_SWINGS = 5.0  # rad of the servo's own oscillation that are recorded
_TRIES = 4
_NEARER = 3  # places before which the arm tries to tare
_PAUSE, _SAME = 0.04, 0.001  # s: of docking, after which its pull may have lapsed; between two dates of one reading
_STRONGER = 1.3  # by which the pull must exceed the magnets
_LOOSE, _LONGER = 0.3, 3  # share of a run-up that each servo must follow, and how often it is doubled
_LAGS, _LONGEST_RUN_UP = 3.0, 0.02  # what a run-up must exceed to follow by _LOOSE; m
_MOST_FRICTION = 0.6  # A of a servo; worn gears take up to 0.5
_APART = 2.0  # times the others' friction that makes one servo the culprit
_WRONG_WEIGHT = 0.25  # N·m by which servos carry another weight than the arm's; cables pull with up to 0.23
_EXPLAINED = 0.5  # share of it that exchanged servos may leave, so that they explain it


def approach(context: Context, target: Vector) -> Script[float]:
    """Move to the standoff before `target` (m, charger_base), learn how the servos brake and rub, and tare there.

    Whoever touches on the way is nearer than told: the arm lets go and begins again before it. Zero is measured only
    in free air.

    Returns:
        z of the target, m: as told, or where the pads met it.

    Raises:
        ServoFailure: a servo swings or creeps, friction takes what pushing needs, or two servos are exchanged.
        Stuck: the pull would not release the magnets.
        NoContact: the pads feel contact wherever the arm would tare, or live ones (power: none) touch before.
    """
    parameters = context.parameters
    context.enter(codes.State.APPROACH, APPROACH_TIMEOUT)
    x, y, z = target
    context.check_way((x, y, z - parameters.standoff))  # before anything moves
    yield from _check_swing(context, z - parameters.standoff)
    for _ in range(_NEARER):
        if not (yield from _tare(context, (x, y, z))):
            _check_pull(context, (x, y, z))
            return z
        context.decide("nearer", "the target is nearer than told", z_m=context.position[2])
        if parameters.always_live:
            break
        yield from context.wait(SETTLE_TOUCHING)
        z = context.position[2]
        yield from release.take_off(context, max(z - parameters.standoff, parameters.home_z))
    raise codes.NoContact("the pads feel contact before the standoff: check the target's coordinates, and the pads")


def _tare(context: Context, target: Vector) -> Script[bool]:
    """Weigh the platform at the standoff on a way back and forward again, and tare; return whether the pads touched."""
    parameters, speed = context.parameters, _RUN_UP_SPEED
    x, y, z = target
    standoff = x, y, z - parameters.standoff
    if (yield from _free_move(context, standoff, _APPROACH_SPEED, settle=False)):
        return True
    lag = max(standoff[2] - context.position[2], 0.0)  # mostly by friction, which a run-up reverses
    speed *= min(1.0, context.springs.softness)  # stiff servos overshoot, which turns friction's sign
    run_up = max(_RUN_UP * max(1.0, context.springs.softness), min(_LAGS * lag, _LONGEST_RUN_UP))
    for _ in range(_LONGER):
        yield from context.move((x, y, max(standoff[2] - run_up, min(parameters.home_z, standoff[2]))), speed)
        down, currents, angles = context.contact.force, context.contact.currents, context.observation.angles
        if (yield from _free_move(context, standoff, speed)):
            return True
        turns = [now - then for now, then in zip(context.observation.angles, angles, strict=True)]
        if min(turns) * sum(context.kinematics.jacobian(*standoff)[6:]) >= _LOOSE * run_up:
            break
        run_up *= 2.0  # friction held the arm: so short a way does not show all of it
    _learn_friction(context, down, currents)
    _check_order(context, currents)
    context.decide("zero", "the contact current is tared at the standoff", contact_current_A=context.contact.value)
    context.contact.tare()
    a, b, c = (goal - now for goal, now in zip(standoff, context.position, strict=True))
    context.lead = a, b, c
    return False


def _free_move(context: Context, goal: Vector, speed: float, settle: bool = True) -> Script[bool]:
    """Move to `goal` (m) at most until the pads feel something; return whether they do."""
    touched = yield from context.move(goal, speed, settle, until=lambda: context.observation.tactile_contact)
    return touched or context.observation.tactile_contact


def _check_swing(context: Context, farthest: float) -> Script[None]:
    """Let the arm jump, up to z = `farthest` m, and refuse servos that would swing in contact or lag behind."""
    springs, rows, current = context.springs, [], _JUMP_CURRENT
    for _ in range(_TRIES):
        last = yield from _swing(context, farthest, current)
        rows += last
        servos = swings.fit_swing(rows, context.parameters.torque_constant)
        unknown = [index for index, each in enumerate(servos) if math.isnan(each.damping)]
        creeping = [index + 1 for index in unknown if current > _JUMP_CURRENT and swings.creeps(last, index)]
        if creeping or all(each.damping - each.damping_stddev >= swings.LEAST_DAMPING for each in servos):
            break
        if unknown:  # softer servos than expected hardly turn
            current *= 2.0
    springs.learn_swing(servos)
    values = {f"damping_{number}_Nms_per_rad": each.damping for number, each in enumerate(servos, 1)}
    text = "how the servos spring and brake"
    context.decide("swing", text, stiffness_Nm_per_rad=springs.stiffness, **values)
    most = 2.0 * _MOST_DAMPED * springs.stiffness / springs.frequency
    for number, each in enumerate(servos, 1):
        value = each.damping
        if swings.surely_swings(each):
            braked = f"its damping is {value:.2f} N·m·s/rad, below {swings.LEAST_DAMPING}"
            raise codes.ServoFailure(f"servo {number} swings: {braked}: raise position_d_gain")
        if value - swings.SURELY * each.damping_stddev > most or number in creeping:
            raise codes.ServoFailure(
                f"servo {number} creeps: damping above {most:.1f} N·m·s/rad; lower position_d_gain"
            )


def _swing(context: Context, farthest: float, current: float) -> Script[list[SwingReading]]:
    """Let the goals jump by `current` (A) along z, forward unless that passes `farthest` (m); return the readings."""
    parameters, springs, kinematics = context.parameters, context.springs, context.kinematics
    geometry, (x, y, z) = kinematics.geometry, context.position
    jump = min(current * springs.compliance, _LONGEST_JUMP)
    way = jump * sum(kinematics.jacobian(x, y, z)[6:])
    jump = jump if z + way < farthest else -jump
    a, b, c = (min(max(angle + jump, geometry.joint_min), geometry.joint_max) for angle in context.angles)
    held = kinematics.holding_torque(x, y, z, parameters.gravity)
    bound = context.planner.bound(held)
    observation, seen = context.observation, []
    if observation.servos_valid:  # the reference, before the jump
        seen.append((context.time - observation.servo_age, observation.angles, observation.currents))
    # It swings only once it has heard of the jump, which its angles show.
    lasts, latest, end = _SWINGS / springs.frequency, context.time + _LATE, math.inf
    while context.time < end:
        if context.is_blind:  # the pull lapses, and the swing begins again with the next data
            seen.clear()
            latest, end = context.time + _LATE, math.inf
        else:
            context.pull((a, b, c), bound)
        yield NEXT
        if context.pause > _PAUSE:  # the goal may have gone back
            break
        observation, measured = context.observation, context.time - context.observation.servo_age
        seen.extend(reading for reading in observation.earlier if not seen or reading[0] > seen[-1][0])
        new = observation.servos_valid and not (seen and measured < seen[-1][0] + _SAME)
        if new and not context.is_blind:
            seen.append((measured, observation.angles, observation.currents))
            if end == math.inf and (context.time > latest or _differ(seen[0][1], seen[-1][1])):
                end = context.time + lasts
    context.commanded = context.measured()
    most = tuple(_FREE * torque / parameters.torque_constant for torque in bound)
    return swings.swing_readings(seen, (a, b, c), most)


def _differ(before: Vector, after: Vector) -> bool:
    return any(abs(now - then) > _HEARD for then, now in zip(before, after, strict=True))


def _learn_friction(context: Context, down: float, currents: Vector) -> None:
    """Take half of the difference between weighing forward, now, and back: force (N) and currents (A)."""
    parameters, contact, springs = context.parameters, context.contact, context.springs
    springs.friction_force = max(0.5 * (contact.force - down), 0.0)
    constant = parameters.torque_constant
    held = context.kinematics.holding_torque(*context.position, parameters.gravity)
    forward = [constant * current for current in contact.currents]
    halves = [0.5 * (now - constant * then) for now, then in zip(forward, currents, strict=True)]
    a, b, c = (max(half, 0.0) for half in halves)
    springs.friction = a, b, c
    each = zip(forward, held, springs.friction, strict=True)
    a, b, c = (max(abs(now) - abs(weight), rubs) for now, weight, rubs in each)
    springs.beyond_weight = a, b, c
    context.decide(
        "friction",
        "what gears and cable rub",
        friction_force_N=springs.friction_force,
        **{f"friction_{number}_Nm": value for number, value in enumerate(springs.friction, 1)},
    )
    taken = max(springs.friction) / constant
    if taken <= _MOST_FRICTION:
        return
    worst = max(range(3), key=lambda index: springs.friction[index])
    others = [value for index, value in enumerate(springs.friction) if index != worst]
    alone = springs.friction[worst] > _APART * max(others)
    culprit = f"the gear of servo {worst + 1}" if alone else "the cable or all gears"
    takes = f"free motion takes {taken:.2f} A, more than {_MOST_FRICTION:g} A"
    raise codes.ServoFailure(f"{culprit} rubs: {takes}; free the cable, or replace the servo")


def _check_order(context: Context, back: Vector) -> None:
    """Refuse servos that carry the arm's weight as others should: each reaches its goal, but the arm goes elsewhere.

    Without friction, half of the sum of the currents (A) on the ways `back` and forward, now, is the weight.
    """
    kinematics, parameters = context.kinematics, context.parameters
    halves = zip(context.contact.currents, back, strict=True)
    carried = [0.5 * parameters.torque_constant * (forward + before) for forward, before in halves]
    left: dict[tuple[int, ...], float] = {}
    for limbs in permutations(range(3)):  # of servos 1 to 3
        a, b, c = (context.observation.angles[limbs.index(limb)] for limb in range(3))
        held = kinematics.holding_torque(*kinematics.forward(a, b, c), parameters.gravity)
        left[limbs] = math.dist(carried, [held[limb] for limb in limbs])
    right, told = min(left, key=left.__getitem__), left[0, 1, 2]
    if not (told > max(_WRONG_WEIGHT, math.hypot(*context.springs.friction)) and left[right] < _EXPLAINED * told):
        return
    moves = ", ".join(f"servo {servo} limb {limb}" for servo, limb in enumerate(right, 1) if limb != servo - 1)
    weight = f"the arm's weight lies on the servos as if {moves} moved"
    raise codes.ServoFailure(f"{weight}: check each servo's id (docs/hardware.md), or docking_node's gravity")


def _check_pull(context: Context, target: Vector) -> None:
    """Refuse a target whose magnets the arm could not leave.

    Raises:
        Stuck: less friction, the pull is below 1.3 times the magnets.
    """
    parameters, springs = context.parameters, context.springs
    torque = release.RELEASE_CURRENT * parameters.torque_constant
    pull = context.kinematics.force(*target, (torque, torque, torque))[2]
    left = (1.0 - arm.LOAD_SHARES[1]) * pull - springs.friction_force
    needed = _STRONGER * parameters.magnet_force
    if left < needed:
        pulls = f"{release.RELEASE_CURRENT:.1f} A pull with {left:.0f} N, and the magnets need {needed:.0f}"
        raise codes.Stuck(f"the arm could not let go: {pulls}: free the cable, or use weaker magnets")
