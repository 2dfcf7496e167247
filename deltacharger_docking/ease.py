# SPDX-License-Identifier: Apache-2.0
"""The arm at ease on the target: the servos' currents approach a common value, as far as friction holds."""

from __future__ import annotations

import math

from deltacharger_core.script import NEXT, Script
from deltacharger_docking.codes import State
from deltacharger_docking.context import Context
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.trajectory_feed import Waypoint

_SIGMAS = 2.0  # of the readings' noise that easing does not follow
_POINTS = 16  # of the line in joint angles; receivers interpolate linearly, so more would not help


def ease(context: Context) -> Script[None]:
    """Bring each servo to the common current that presses in the middle of the band, as far as friction holds."""
    parameters = context.parameters
    context.enter(State.CONTACT, parameters.contact_timeout)
    place, hottest = context.position, _hottest(context)
    holds, response = True, 1.0 / context.springs.compliance
    for _ in range(parameters.ease_rounds):
        before = context.contact.currents
        wanted = _wanted(context, holds)
        asked = tuple(goal - now for goal, now in zip(wanted, before, strict=True))
        known = all(map(math.isfinite, (*asked, *context.goal_angles)))
        noise = _SIGMAS * context.contact.currents_error
        if not known or max(map(abs, asked)) <= max(parameters.ease_tolerance, noise):
            break
        slipped = yield from _adjust(context, (asked[0] / response, asked[1] / response, asked[2] / response), place)
        yield from context.rest()
        if slipped:
            holds = False
            continue
        got = sum(a * (now - then) for a, now, then in zip(asked, context.contact.currents, before, strict=True))
        share = got / sum(a * a for a in asked)
        response *= min(max(share, parameters.response_min), parameters.response_max)
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
        common = max(min(common, parameters.ease_current_max), common - parameters.ease_spared_max)
        return common, common, common
    d, e, f = kinematics.torque(x, y, z, (0.0, 0.0, missing))
    return now[0] + d / constant, now[1] + e / constant, now[2] + f / constant


def _adjust(context: Context, change: Vector, place: Vector) -> Script[bool]:
    """Move the goal angles by `change` (rad); on a slip from `place` undo a part; return whether it slipped."""
    parameters = context.parameters
    duration = max(parameters.ease_time_min, parameters.ease_lags * context.springs.lag)
    start, began = context.goal_angles, context.time
    context.follow(_ramp(context, start, change, duration))
    while context.feed.is_under_way(context.time):
        slip = math.dist(place[:2], context.position[:2])
        if slip > parameters.slip_max:
            done = min((context.time - began) / duration, 1.0)
            back, lasts = -parameters.slip_undo_share * done, parameters.slip_back_time * duration
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
