# SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 of the paper, line by line.

1 coordinates of the electrodes; 2 go there; 3 if that already pushes too hard, back off once: ours goes to the standoff
only; 4 press until the current is in its band; 5 measure the misalignment; 6 while it is not zero, and at most 15
times, move and press again; start charging. Failures are exceptions, after which the machine retracts: the paper's
line 7.
"""

import math

from deltacharger_core.script import Script
from deltacharger_docking import clearance, codes, energy, goals, observation, place, press, release, standoff, touch
from deltacharger_docking.context import SERVICE_TIMEOUT, Context
from deltacharger_docking.watch import FIRST_DATA_TIMEOUT

_ROLL_SIGMAS = 2.0  # standard deviations between a detected roll and critical_angle; the seeds were not kept
_IMAGE_RANGE_MAX = 0.4  # m, largest range of a camera detection without depth
_DETECTION_AGE_MAX = 1.0  # s
# From leaning contacts of the world and of the pose model at up to 5°, then seed 5.
_LEAN_MAX = math.radians(5.0)  # yaw or pitch of the electrodes' faces above which docking refuses
_LOCATE_TIMEOUT = 10.0  # s, limit for LOCATE

_ANSWER = 1.0  # s beyond _LOCATE_TIMEOUT, so that the phase ends with the detector's answer


def dock(
    context: Context, target: touch.Target, given: observation.ElectrodePose | None, charges: bool
) -> Script[None]:
    """Bring the electrodes into contact, with clearance and the arm at ease.

    Args:
        context: of the docking.
        target: the target, as known by touch.
        given: pose of its electrodes; None = ask the camera.
        charges: whether current is wanted.
    """
    parameters = context.parameters
    context.known_contact, context.port_shown = None, False
    context.electrodes = electrodes = given or (yield from locate(context))  # 1
    check_roll(context, electrodes, target.critical_angle)
    check_lean(context, electrodes)
    target.place = place.TargetPlace(parameters, context.share, electrodes)
    yield from prepare(context)
    yield from energy.prove_dead(context)
    if charges and not parameters.always_live:
        energy.check_battery(context)
    z = yield from standoff.approach(context, electrodes.position)  # 2
    target.depth = z + parameters.search_depth
    if parameters.always_live and context.observation.duplicate_sources:
        yield from energy.wait_for_single_sources(context, context.time, codes.State.APPROACH)
    estimate = yield from press.contact(context, target.depth, _look(context, target))  # 4
    yield from align(context, target, estimate=estimate)  # 5 and 6


def _look(context: Context, target: touch.Target) -> press.Look | None:
    """Return how to measure at the touch of live electrodes; None = press without."""
    return (lambda: touch.look(context, target)) if context.touches_live else None


def align(
    context: Context, target: touch.Target, stay: bool = False, estimate: clearance.MisalignmentEstimate | None = None
) -> Script[None]:
    """Measure, move and press again until the electrodes may rest and current may flow.

    Args:
        context: of the docking.
        target: on which the electrodes rest.
        stay: they have been aligned before and may rest where they are, if they have clearance there.
        estimate: estimate of the first touch, which forbade pressing further; None = the electrodes already press.
    """
    target.begin_goal()
    while True:
        estimate = estimate or (yield from touch.measure(context))  # 5
        if target.allows_rest(estimate, stay) and (yield from stands_at_ease(context, target)):
            break
        stay = False
        x, y = target.correction()  # 6, at most 15 times
        yield from press.move_aside(context, x, y)
        estimate = yield from press.contact(context, target.depth, _look(context, target))
    context.status.docked = True


def stands_at_ease(context: Context, target: touch.Target) -> Script[bool]:
    """Put the arm at ease; return whether the electrodes still have clearance, since the arm may have slipped."""
    yield from press.ease(context)
    if not target.still_allows_rest((yield from touch.measure(context))):
        return False
    target.rest()
    return True


def locate(context: Context) -> Script[observation.ElectrodePose]:
    """Ask the camera where the electrodes are."""
    parameters = context.parameters
    context.enter(codes.State.LOCATE, _LOCATE_TIMEOUT + _ANSWER)
    reply = yield from context.ask(observation.Service.DETECT, codes.ElectrodesNotFound, _LOCATE_TIMEOUT)
    found = reply.detection
    if not reply.success or found is None:
        raise codes.ElectrodesNotFound(f"no electrodes were found: {reply.message}")
    if not found.age <= _DETECTION_AGE_MAX:
        raise codes.DetectionStale(f"the detection is {found.age:.1f} s old, more than {_DETECTION_AGE_MAX:.1f} s")
    if not found.image_range <= _IMAGE_RANGE_MAX:
        far = f"the electrodes are {found.image_range:.2f} m away, more than {_IMAGE_RANGE_MAX:g} m without depth"
        raise codes.ElectrodesNotFound(f"{far}: drive nearer, or check the depth images")
    goals.check_place(found, context.planner, parameters)
    context.decide("located", "the camera sees the electrodes", **found.numbers)
    return found


def check_roll(context: Context, electrodes: observation.ElectrodePose, limit: float) -> None:
    """Refuse electrodes whose roll, given or seen, reaches or may reach the critical angle (`limit`, rad).

    Raises:
        CriticalAngle: it does.
    """
    roll, stddev = electrodes.roll, electrodes.roll_stddev
    if not clearance.reaches_limit(roll, context.parameters, limit, _ROLL_SIGMAS * stddev):
        return
    text = "the roll, given or seen, is too large"
    context.decide("refused", text, roll_rad=roll, roll_stddev_rad=stddev, limit_rad=limit)
    raise codes.CriticalAngle(
        f"the electrodes are rolled by {math.degrees(roll):.1f}° ± {math.degrees(stddev):.1f}°, as given or seen; the "
        f"critical angle is {math.degrees(limit):.1f}°: level the target or the charger"
    )


def check_lean(context: Context, electrodes: observation.ElectrodePose) -> None:
    """Refuse electrodes whose faces surely lean too far; the pads check an unknown or unsure lean.

    Raises:
        Leaning: they do. It suggests another pose of the robot for a yaw only: no pose corrects a pitch.
    """
    yaw, pitch = electrodes.yaw, electrodes.pitch
    if _is_surely_beyond(context, "pitch", pitch, electrodes.pitch_stddev, _LEAN_MAX):
        raise codes.Leaning(
            f"the electrodes' faces are pitched by {math.degrees(pitch):+.1f}° about x of charger_base, more than "
            f"{math.degrees(_LEAN_MAX):.1f}°; level the target or the charger"
        )
    if _is_surely_beyond(context, "yaw", yaw, electrodes.yaw_stddev, _LEAN_MAX):
        raise codes.Leaning(
            f"the electrodes' faces are yawed by {math.degrees(yaw):+.1f}° about y of charger_base, as given or seen, "
            f"more than {math.degrees(_LEAN_MAX):.1f}°; move the robot to suggested_base_pose, which is to "
            f"{goals.in_words(yaw)}",
            electrodes.position,
            yaw,
        )


def _is_surely_beyond(context: Context, axis: str, lean: float, stddev: float, limit: float) -> bool:
    """Return and record whether a lean (rad) exceeds its limit; False if it or its error is unknown (NaN)."""
    if not abs(lean) - clearance.LEAN_SIGMAS * stddev > limit:
        return False
    values = {f"{axis}_rad": lean, f"{axis}_stddev_rad": stddev, "limit_rad": limit}
    context.decide("refused", f"the {axis}, given or seen, is too large", **values)
    return True


def prepare(context: Context) -> Script[None]:
    """Wait for nodes that have just started, open the contactor, switch the torque on, lift off, tare in free air."""
    context.enter(codes.State.APPROACH, standoff.APPROACH_TIMEOUT)
    oldest = context.parameters.age_max
    with context.waiting_for("servo_state and tactile_frame"):
        yield from context.until(lambda: not context.observation.oldest > oldest, FIRST_DATA_TIMEOUT)
    if context.observation.servo_age > oldest:
        raise context.observation.servo_silence()
    if context.observation.tactile_age > oldest:
        raise codes.TactileStale("no tactile frames; check the board's cable and tactile_node")
    yield from context.answered()
    yield from energy.de_energise(context)  # never pull off a contactor that welded in an earlier goal
    if not context.observation.torque_enabled:
        yield from context.torque_on()
    context.commanded = context.position
    # A restarted node does not know that it is docked; the pads show it.
    if context.status.docked or (context.observation.tared and context.observation.tactile_contact):
        yield from release.lift_off(context)
    reply = yield from context.ask(observation.Service.TARE, codes.TactileStale, SERVICE_TIMEOUT)
    if not reply.success:
        raise codes.TactileStale(f"the pads were not tared: {reply.message}; they must be free before docking")
    context.decide("tared", "the pads are tared in free air")
