# SPDX-License-Identifier: Apache-2.0
"""The arm at ease on the target: the servos' currents approach a common value, as far as friction holds."""

from __future__ import annotations

import math

from deltacharger_core.script import NEXT, Script
from deltacharger_docking.codes import State
from deltacharger_docking.context import RESPONSE_MAX, RESPONSE_MIN, Context
from deltacharger_docking.press import CONTACT_TIMEOUT
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.trajectory_feed import Waypoint

# Chosen in earlier campaigns whose seeds were not kept; the current was once moved to 0.57 A to meet a target.
_EASE_CURRENT_MAX = 0.57  # A, largest common current of the servos at ease
_EASE_SPARED_MAX = 0.03  # A, by which that limit reduces the current at ease at most
_SLIP_MAX = 0.0004  # m, sideways travel from which the platform slips
_SLIP_UNDO_SHARE = 0.4  # share of the easing motion that is undone after a slip

_EASE_TOLERANCE = 0.015  # A, allowed error of a servo's current at ease
_EASE_TIME_MIN = 0.25  # s, shortest time of one easing round
_EASE_LAGS = 4.0  # shortest time of a round in servo lags, damping / stiffness
_EASE_ROUNDS = 4  # most easing rounds; each corrects the stiffness
_SLIP_BACK_TIME = 0.3  # duration of undoing as a share of the round's time
_SIGMAS = 2.0  # of the readings' noise that easing does not follow
_POINTS = 16  # of the line in joint angles; receivers interpolate linearly, so more would not help


def ease(context: Context) -> Script[None]:
    """Bring each servo to the common current that presses in the middle of the band, as far as friction holds."""
    context.enter(State.CONTACT, CONTACT_TIMEOUT)
    place, hottest = context.position, _hottest(context)
    holds, response = True, 1.0 / context.springs.compliance
    for _ in range(_EASE_ROUNDS):
        before = context.contact.currents
        wanted = _wanted(context, holds)
        asked = tuple(goal - now for goal, now in zip(wanted, before, strict=True))
        known = all(map(math.isfinite, (*asked, *context.goal_angles)))
        noise = _SIGMAS * context.contact.currents_error
        if not known or max(map(abs, asked)) <= max(_EASE_TOLERANCE, noise):
            break
        slipped = yield from _adjust(context, (asked[0] / response, asked[1] / response, asked[2] / response), place)
        yield from context.rest()
        if slipped:
            holds = False
            continue
        got = sum(a * (now - then) for a, now, then in zip(asked, context.contact.currents, before, strict=True))
        share = got / sum(a * a for a in asked)
        response *= min(max(share, RESPONSE_MIN), RESPONSE_MAX)
    context.decide(
        "eased",
        "friction carries the weight" if holds else "friction carries a part of the weight",
        hottest_before_A=hottest,
        hottest_A=_hottest(context),
        contact_current_A=context.contact.value,
        slip_m=math.dist(place[:2], context.position[:2]),
    )


def _hottest(context: Context) -> float:
    return max(map(abs, context.contact.currents))


def _wanted(context: Context, holds: bool) -> Vector:
    """Return currents (A) that press in the middle of the band.

    Equal ones if friction still `holds` the weight, else the present ones plus what the push lacks.
    """
    x, y, z = context.position
    contact, kinematics, parameters = context.contact, context.kinematics, context.parameters
    constant = parameters.torque_constant
    now = contact.currents
    a, b, c = (current * constant for current in now)
    missing = (parameters.current_target - contact.value) / contact.per_force
    if holds:
        alike = kinematics.force(x, y, z, (constant, constant, constant))[2]
        common = (kinematics.force(x, y, z, (a, b, c))[2] + missing) / alike if alike else math.nan
        common = max(min(common, _EASE_CURRENT_MAX), common - _EASE_SPARED_MAX)
        return common, common, common
    d, e, f = kinematics.torque(x, y, z, (0.0, 0.0, missing))
    return now[0] + d / constant, now[1] + e / constant, now[2] + f / constant


def _adjust(context: Context, change: Vector, place: Vector) -> Script[bool]:
    """Move the goal angles by `change` (rad); on a slip from `place` undo a part; return whether it slipped."""
    duration = max(_EASE_TIME_MIN, _EASE_LAGS * context.springs.lag)
    start, began = context.goal_angles, context.time
    context.follow(_ramp(context, start, change, duration))
    while context.feed.is_under_way(context.time):
        slip = math.dist(place[:2], context.position[:2])
        if slip > _SLIP_MAX:
            done = min((context.time - began) / duration, 1.0)
            back, lasts = -_SLIP_UNDO_SHARE * done, _SLIP_BACK_TIME * duration
            here = _shifted(start, change, done)
            context.decide("slipped", "friction no longer holds the platform", share=done, slip_m=slip)
            context.follow(_ramp(context, here, (back * change[0], back * change[1], back * change[2]), lasts))
            yield from context.wait(lasts)
            return True
        yield NEXT
    return False


def _ramp(context: Context, start: Vector, change: Vector, duration: float) -> tuple[Waypoint, ...]:
    """Return a line of joint angles (rad) from `start` by `change`, inside the joint limits, with the push bound."""
    x, y, z = context.position
    geometry = context.kinematics.geometry
    bound = context.planner.bound(context.kinematics.holding_torque(x, y, z, context.parameters.gravity))
    points = []
    for index in range(1, _POINTS + 1):
        share = index / _POINTS
        d, e, f = (min(max(angle, geometry.joint_min), geometry.joint_max) for angle in _shifted(start, change, share))
        points.append(Waypoint(share * duration, (d, e, f), bound))
    return tuple(points)


def _shifted(start: Vector, change: Vector, share: float) -> Vector:
    return start[0] + share * change[0], start[1] + share * change[1], start[2] + share * change[2]
