# SPDX-License-Identifier: Apache-2.0
"""Steps 4 and 6 of Algorithm 1: press until the current is in its band, ease the arm, lift off and move aside."""

import math
from collections.abc import Callable

from deltacharger_core.script import NEXT, Script
from deltacharger_docking import clearance, codes, release
from deltacharger_docking.contact import PRESS_AGE_MAX
from deltacharger_docking.context import RESPONSE_MAX, RESPONSE_MIN, SETTLE_TOUCHING, Context, KnownContact
from deltacharger_docking.parameters import BAND_MARGIN
from deltacharger_docking.place import FORCE_ERROR
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.trajectory_feed import Waypoint

# Chosen on seeds of the family 777001, then 5 and 19.
_SEARCH_FROM = 0.007  # m, distance before the expected contact where the search begins
_NEAR = 0.004  # m, distance before the known contact where press_speed begins
# From statics of the arm, then seeds 5 and 19.
_AIM_BELOW = 0.02  # A, how far below the band's middle a press on a known contact aims
_STEP_SHARE = 0.7  # largest share of the way to the band in one step
_STEP_NEAR = 0.75  # share of the band's lower end from which one step goes all the way
_OVERSHOOT_BACK_OFF = 0.35  # A, contact current to release after an overshoot

_COARSE_STEP = 0.0025  # m, largest step in free air
_STEP_MAX = 0.015  # m, longest pressing step, however soft the contact seems
_STEP_ABOVE = 0.1  # A above the band that a step on a stiff contact may reach
_RESPONSE_VISIBLE = 0.02  # A, least change between two readings that shows the response
_OVERSHOOTS_MAX = 3  # overshoots of the band after which contact fails
CONTACT_TIMEOUT = 45.0  # s, limit for CONTACT
ALIGN_TIMEOUT = 45.0  # s, limit for one ALIGN
_DIFFERS = 16.0  # N by which the pads' rise may exceed the currents'; faultless 12, once 22 on a robot that swung
_LEVEL = 0.25  # share of the force that the lighter pad has on faces that lie flat
_PROBABLY = 0.003  # m beyond the expected contact, up to which it is usually met

Look = Callable[[], Script[clearance.MisalignmentEstimate | None]]
"""Measures at the first contact; returns the estimate if it forbids pressing further."""


def contact(context: Context, depth: float, look: Look | None = None) -> Script[clearance.MisalignmentEstimate | None]:
    """Press until the contact current rests in its band.

    Args:
        context: shared state; the platform stands before the target.
        depth: largest z (m, charger_base) at which contact is searched.
        look: measures before pressing further; None = press without.

    Returns:
        The estimate that forbade pressing further, else None.

    Raises:
        NoContact: there was no contact up to `depth`.
        NoTactileContact: the servos push but the pads measure no force.
        Overcurrent: the band was overshot too often.
    """
    context.enter(codes.State.CONTACT, CONTACT_TIMEOUT)
    estimate = yield from _meet(context, depth, look)
    if estimate is not None:
        return estimate
    yield from _into_band(context, depth)
    context.known_contact = KnownContact(context.commanded[2], context.position[2], context.contact.value)
    check_pads(context)
    return None


def check_pads(context: Context) -> None:
    """Record that the electrodes rest on the target, if the pads feel it too.

    Raises:
        TactileStale: no frames tell it.
        NoTactileContact: the servos push but the pads measure no force.
    """
    observation = context.observation
    if observation.tactile_age > context.parameters.age_max:
        raise codes.TactileStale("tactile frames stopped during contact; check the board's cable and tactile_node")
    if not observation.tactile_contact:
        raise codes.NoTactileContact(
            f"the servos push with {context.contact.value:.2f} A but no taxel measures 1 N: the pads missed the "
            "ridges, there is an obstacle, or gears or cable rub more than at the tare"
        )
    context.decide(
        "contact",
        "the electrodes rest on the target",
        contact_current_A=context.contact.value,
        contact_force_N=context.contact.force,
        z_m=context.position[2],
    )


def move_aside(context: Context, x: float, y: float) -> Script[None]:
    """Lift off, and move the command by (x, y) m.

    The command moves by the error of the measured pose. This also corrects friction and soft servos, which keep the
    platform short of its command.

    Raises:
        Unreachable: the way there leaves the arm's reach; the platform was not lifted.
    """
    parameters = context.parameters
    commanded, z = context.commanded, context.position[2]
    place = commanded[0] + x, commanded[1] + y, z - release.LIFT
    context.check_way((*context.position[:2], place[2]), place, (*place[:2], z))
    context.enter(codes.State.ALIGN, ALIGN_TIMEOUT)
    yield from release.take_off(context, place[2])
    context.status.docked = False  # until the electrodes rest again
    context.evidence.forget()
    yield from context.move(place, parameters.travel_speed, settle=False)


def step_to(context: Context, z: float) -> Script[None]:
    """Set the commanded z (m) and come to rest; wait while servo_state is too old to press.

    Raises:
        NoContact: the command is beyond the arm's reach.
    """
    while context.observation.servo_age > PRESS_AGE_MAX:
        yield NEXT
    try:
        yield from context.move((*_beside(context), z), context.parameters.press_speed)
    except codes.Unreachable as error:
        raise codes.NoContact(f"no contact before the arm's limit: {error}") from error


def slope_expected(context: Context) -> float:
    """Return the contact current per metre of command (A/m) for a rigid target and the servos' stiffness.

    dI/dz = k / (J_z Kt · 3 J_z) · J_z: 0.006 A/mm for each N·m/rad of servo stiffness at the dock.
    """
    x, y, z = context.position
    jacobian = context.kinematics.jacobian(x, y, z)
    lever = (jacobian[6] + jacobian[7] + jacobian[8]) / 3.0
    return 1.0 / (3.0 * lever * context.springs.compliance)


def _meet(context: Context, depth: float, look: Look | None) -> Script[clearance.MisalignmentEstimate | None]:
    """Press the target until the contact current is near its band: at a known place directly, else after a search.

    The arm moves fast where it cannot strike anything. If a known place is wrong, the search starts there. With `look`
    it searches, because a direct press leaves no time to measure, unless the port shows by its voltage when to look.
    """
    parameters, known, (x, y, z) = context.parameters, context.known_contact, context.commanded
    context.drawn = math.nan
    while context.observation.servo_age > PRESS_AGE_MAX:
        yield NEXT
    context.contact.clear()
    try:
        if known is None or (look is not None and not context.port_shown):
            return (yield from _search(context, depth, look))
        before = max(known.measured - _NEAR, z)
        touched = yield from context.move((x, y, before), parameters.travel_speed, False, lambda: _touches(context))
        if touched and context.position[2] < before:
            return (yield from _press_on(context, look))
        wanted = known.commanded + (parameters.current_target - _AIM_BELOW - known.current) / slope_expected(context)
        rise = slope_expected(context) * parameters.press_speed
        too_hard = yield from context.move(
            (x, y, wanted),
            parameters.press_speed,
            until=lambda: context.contact.value > parameters.current_max or context.is_dark,
            spare=lambda: 0.5 * (parameters.current_max - context.contact.value) / rise,
        )
        if _touches(context):
            _note_drawn(context)
        if context.is_dark and look is not None and (estimate := (yield from look())) is not None:
            return estimate
        if too_hard:
            yield from context.rest()
        elif not _touches(context):
            yield from _search(context, depth)
    except codes.Unreachable:
        pass  # the steps that follow show whether the arm's limit is before the target
    return None


def _search(context: Context, depth: float, look: Look | None = None) -> Script[clearance.MisalignmentEstimate | None]:
    """Move along z to the start of the search, then slowly up to `depth` (m) until contact; continue pressing there."""
    parameters, (x, y, z) = context.parameters, context.commanded
    expected = depth - parameters.search_depth
    free = expected - _SEARCH_FROM
    legs = [(free, parameters.travel_speed)] if z < free else []
    depth = _deepest(context, depth)
    # The first line of the search starts faster than the long one.
    legs += [(end, parameters.search_speed) for end in (expected + _PROBABLY, depth) if z < end]
    for end, speed in legs:
        if (yield from context.move((x, y, end), speed, settle=end == depth, until=lambda: _touches(context))):
            return (yield from _press_on(context, look))
    return None


def _touches(context: Context) -> bool:
    """Return whether the pads touch; the currents alone must show a full push, for friction and inertia show some."""
    return context.observation.tactile_contact or context.contact.value > context.parameters.current_min


def _press_on(context: Context, look: Look | None = None) -> Script[clearance.MisalignmentEstimate | None]:
    """Continue pressing from where the platform stops, to a share of the band that is safe on a rigid target."""
    parameters, end = context.parameters, context.time + SETTLE_TOUCHING
    highest = -math.inf
    while context.time < end and context.position[2] > highest:
        highest = context.position[2]
        yield NEXT
    _note_drawn(context)
    if look is not None and (estimate := (yield from look())) is not None:
        return estimate
    z = context.commanded[2]
    pressing = context.position[2] + context.lead[2]
    pressing += _STEP_SHARE * parameters.current_target / slope_expected(context)
    yield from context.move((*_beside(context), max(z, pressing)), parameters.press_speed)
    return None


def _note_drawn(context: Context) -> None:
    context.drawn = context.position[0] - context.commanded[0] + context.lead[0]


def _beside(context: Context) -> tuple[float, float]:
    """Return the command along x and y: in contact where the magnets drew the platform, which else strains the arm."""
    if not context.observation.tactile_contact:
        return context.commanded[:2]
    return context.position[0] + context.lead[0], context.position[1] + context.lead[1]


def _into_band(context: Context, depth: float) -> Script[None]:
    """Step coarsely until the current leaves its baseline, then by the missing current; enter the band from below."""
    parameters = context.parameters
    low, high = parameters.current_min + BAND_MARGIN, parameters.current_max
    response, overshoots = 1.0, 0  # response: the slope's share of the expected one
    start, contradictions = (context.felt_forces, context.contact.force), 0
    while True:
        contradictions = contradictions + 1 if (told := _contradiction(context, *start)) else 0
        if contradictions > 1:  # a robot that swings makes one
            raise codes.ServoFailure(told)
        expected = slope_expected(context)
        slope = response * expected
        before, z = context.contact.value, context.commanded[2]
        if low <= before <= high or (
            low > before >= parameters.current_min and context.is_bound(context.contact.currents)
        ):
            return
        if before > high:
            overshoots += 1
            context.decide(
                "overshoot", "the push is above its band and is reduced", contact_current_A=before, times=overshoots
            )
            if overshoots > _OVERSHOOTS_MAX:
                raise codes.Overcurrent(
                    f"contact current overshot to {before:.2f} A {overshoots} times; is the target moving?"
                )
            yield from step_to(context, z - _OVERSHOOT_BACK_OFF / slope)
            continue
        check_depth(context, depth)
        touching = abs(before) > release.FREE_CURRENT or context.observation.tactile_contact
        if touching:
            far = before < _STEP_NEAR * low
            share = _STEP_SHARE ** (far + overshoots)  # a worn gear holds, then gives way
            step = share * (parameters.current_target - before) / slope
            most = parameters.current_max + _STEP_ABOVE
            stiff = (most - before) / expected  # soft springs may bottom within the step
            step = min(step, _STEP_MAX, max(stiff, 0.0))
        else:
            step = min(_COARSE_STEP, _STEP_SHARE * parameters.current_min / expected)
        yield from step_to(context, z + step)
        after = context.contact.value
        if touching and before > 0.0 and after - before > _RESPONSE_VISIBLE:
            measured = (after - before) / (step * expected)
            response = min(max(measured, RESPONSE_MIN), RESPONSE_MAX)


def _contradiction(context: Context, before: tuple[float, float], told: float) -> str:
    """Return how pads and currents contradict each other on the push since `before` and `told` (N); '' = they do not.

    Only on faces that lie flat: on others the magnets close while the arm presses, which pads feel too.
    """
    felt = sum(before)
    if not _LEVEL * felt <= min(before):
        return ""
    felt, told = sum(context.felt_forces) - felt, context.contact.force - told
    if not felt - context.springs.true_force(told)[1] > _DIFFERS + 2.0 * FORCE_ERROR * felt:
        return ""
    return (
        f"pads and currents contradict each other: while pressing, the pads felt {felt:.0f} N more and the servos' "
        f"currents showed {told:.0f} N: check torque_constant, and whether servo_state repeats its currents"
    )


def _deepest(context: Context, depth: float) -> float:
    """Return how far (m, charger_base) contact is searched: up to `depth` within the workspace."""
    return min(depth, context.kinematics.geometry.workspace_max[2])


def check_depth(context: Context, depth: float) -> None:
    """Check that the platform may go on, up to `depth` (m, charger_base).

    Raises:
        NoContact: there was no contact up to `depth`.
    """
    if context.position[2] > (depth := _deepest(context, depth)):
        raise codes.NoContact(f"no contact up to z = {1000 * depth:.0f} mm; check the target and its coordinates")


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
    context.enter(codes.State.CONTACT, CONTACT_TIMEOUT)
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
