# SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 of the paper, line by line, and what surrounds it on one target: charging, and staying docked.

1 coordinates of the electrodes; 2 go there; 3 where that pushes too hard already, back off once; 4 press until the
current lies in its band; 5 measure the misalignment; 6 while it is not zero, and at most 15 times, move and press
again; start charging. Whatever goes wrong is an exception, and the machine takes the arm back: the paper's line 7.
What steps 5 and 6 have of ours is left out by `published`, the algorithm as printed.
"""

from __future__ import annotations

import math

from deltacharger_core.script import NEXT, Script
from deltacharger_docking import published
from deltacharger_docking.charging import Order, charge
from deltacharger_docking.clearance import FeltPose, judge
from deltacharger_docking.codes import (
    CriticalAngle,
    DetectionStale,
    DockingError,
    ElectrodesNotFound,
    Leaning,
    NoContact,
    ServoFailure,
    State,
    TactileStale,
)
from deltacharger_docking.context import Context
from deltacharger_docking.energy import de_energise, energise, wait_for_single_sources
from deltacharger_docking.goals import GoalDesk, check_place, in_words
from deltacharger_docking.observation import DockGoal, ElectrodePose, Service
from deltacharger_docking.press import approach, contact, ease, first_push, press_again
from deltacharger_docking.release import lift_off
from deltacharger_docking.touch import Target, measure

_ANSWER = 1.0  # s beyond locate_timeout, so that the phase ends with what the detector says


def dock(context: Context, target: Target, given: ElectrodePose | None) -> Script[None]:
    """Lay the electrodes on a target, with clearance and the arm at ease.

    Args:
        context: of the docking.
        target: what is known of it by touch.
        given: where its electrodes are; None = the camera is asked.
    """
    parameters = context.parameters
    context.known_contact = None
    context.electrodes = electrodes = given or (yield from locate(context))  # 1
    if parameters.approach == "published":
        yield from prepare(context)
        yield from published.dock(context, target, electrodes.position)
        return
    check_roll(context, electrodes, target.critical_angle)
    check_lean(context, electrodes)
    target.foresee(electrodes)
    yield from prepare(context)
    yield from approach(context, electrodes.position)  # 2
    if parameters.approach == "paper":
        yield from first_push(context, electrodes.position)  # 3
    target.depth = electrodes.position[2] + parameters.search_depth
    yield from contact(context, target.depth)  # 4
    yield from align(context, target)  # 5 and 6


def align(context: Context, target: Target, stay: bool = False) -> Script[None]:
    """Measure, move and press again until the electrodes may rest where they are and current may flow.

    Args:
        context: of the docking.
        target: on which the electrodes rest.
        stay: they have been aligned before and may rest where they are, if they have clearance there.
    """
    target.begin()
    while True:
        felt = yield from measure(context)  # 5
        if target.allows_rest(felt, stay) and (yield from stands_at_ease(context, target)):
            break
        stay = False
        x, y = target.correction()  # 6, at most 15 times
        yield from press_again(context, target.depth, x, y)
    context.status.docked = True


def stands_at_ease(context: Context, target: Target) -> Script[bool]:
    """Put the arm at ease and return whether the electrodes still have clearance: it may have slipped."""
    if (yield from ease(context)) and not target.still_allows_rest((yield from measure(context))):
        return False
    target.rest()
    return True


def locate(context: Context) -> Script[ElectrodePose]:
    """Ask the camera where the electrodes are."""
    parameters = context.parameters
    context.enter(State.LOCATE, parameters.locate_timeout + _ANSWER)
    reply = yield from context.ask(Service.DETECT, ElectrodesNotFound, parameters.locate_timeout)
    found = reply.detection
    if not reply.success or found is None:
        raise ElectrodesNotFound(f"no electrodes were found: {reply.message}")
    if not found.age <= parameters.detection_age_max:
        raise DetectionStale(f"the detection is {found.age:.1f} s old, more than {parameters.detection_age_max:.1f} s")
    check_place(found, context.planner, parameters)
    context.decide("located", "the camera sees the electrodes", **found.numbers)
    return found


def check_roll(context: Context, electrodes: ElectrodePose, limit: float) -> None:
    """Refuse electrodes that are rolled to the critical angle (`limit`, rad) already, or may be.

    Raises:
        CriticalAngle: they are.
    """
    roll, stddev = electrodes.roll, electrodes.roll_stddev
    if abs(roll) + context.parameters.roll_sigmas * stddev < limit:
        return
    text = "the given roll is too large"
    context.decide("refused", text, roll_rad=roll, roll_stddev_rad=stddev, limit_rad=limit)
    raise CriticalAngle(
        f"the electrodes are rolled by {math.degrees(roll):.1f}° already in the given pose; "
        "level the target or the charger"
    )


def check_lean(context: Context, electrodes: ElectrodePose) -> None:
    """Refuse electrodes whose faces surely lean too far; what is not known or not sure is left to the pads.

    Raises:
        Leaning: they do. It names another stand for a yaw alone: no stand mends a pitch.
    """
    parameters, yaw, pitch = context.parameters, electrodes.yaw, electrodes.pitch
    if _is_surely_beyond(context, "pitch", pitch, electrodes.pitch_stddev, parameters.pitch_max):
        raise Leaning(
            f"the electrodes' faces are pitched by {math.degrees(pitch):+.1f}° about x of charger_base in the given "
            f"pose, more than {math.degrees(parameters.pitch_max):.1f}°; level the target or the charger: look at "
            "floor, tyres, suspension and load"
        )
    if _is_surely_beyond(context, "yaw", yaw, electrodes.yaw_stddev, parameters.yaw_max):
        raise Leaning(
            f"the electrodes' faces are yawed by {math.degrees(yaw):+.1f}° about y of charger_base in the given pose, "
            f"more than {math.degrees(parameters.yaw_max):.1f}°; move the robot to suggested_base_pose, which is to "
            f"{in_words(yaw)}",
            electrodes.position,
            yaw,
        )


def _is_surely_beyond(context: Context, axis: str, lean: float, stddev: float, limit: float) -> bool:
    """Return, and tell, whether a lean (rad) lies beyond its limit; never where it or its error is unknown (NaN)."""
    if not abs(lean) - context.parameters.lean_sigmas * stddev > limit:
        return False
    values = {f"{axis}_rad": lean, f"{axis}_stddev_rad": stddev, "limit_rad": limit}
    context.decide("refused", f"the given {axis} is too large", **values)
    return True


def prepare(context: Context) -> Script[None]:
    """Switch the torque on and tare the pads, both in free air; nodes that have just started are waited for."""
    parameters = context.parameters
    context.enter(State.APPROACH, parameters.approach_timeout)
    end = context.time + parameters.first_data_timeout
    with context.waiting_for("servo_state and tactile_frame"):
        while context.time <= end and (_servos_silent(context) or _pads_silent(context)):
            yield NEXT
    if _servos_silent(context):
        raise ServoFailure("servo_state is missing or stale; is servo_node running and its bus connected?")
    if _pads_silent(context):
        raise TactileStale("no tactile frames; check the board's cable and tactile_node")
    yield from de_energise(context)  # nothing is pulled off a contactor that welded in an earlier goal
    if not context.observation.torque_enabled:
        yield from context.torque_on()
        while not context.observation.torque_enabled:
            yield NEXT
    context.commanded = context.position
    # After a restart nobody remembers having docked; the pads do.
    if context.status.docked or (context.observation.tared and context.observation.tactile_contact):
        yield from lift_off(context)
    reply = yield from context.ask(Service.TARE, TactileStale, parameters.service_timeout)
    if not reply.success:
        raise TactileStale(f"the pads were not tared: {reply.message}; they must be free before docking")
    context.decide("tared", "the pads are tared in free air")
    yield from weigh(context)


def weigh(context: Context) -> Script[None]:
    """Let the arm's weight tell how far the servos yield, or bear out what was felt in an earlier docking."""
    springs = context.springs
    end = context.time + context.parameters.weighing_timeout
    yield from context.read()
    while not springs.is_felt and context.time < end:
        yield from context.read()
    if springs.is_felt:
        values = {"felt_Nm_per_rad": springs.stiffness, "told_Nm_per_rad": context.parameters.servo_stiffness}
        context.decide("stiffness", "as stiff as the servos are felt to be", **values)


def _servos_silent(context: Context) -> bool:
    return context.observation.servo_age > context.parameters.servo_age_max


def _pads_silent(context: Context) -> bool:
    return context.observation.tactile_age > context.parameters.tactile_age_max


class TargetVisit:
    """One target, from the first goal on it until the electrodes leave it.

    Attributes:
        supervising: whether a further goal may be taken: the electrodes rest on the target.
    """

    def __init__(self, context: Context, desk: GoalDesk, goal: DockGoal) -> None:
        self._context = context
        self._desk = desk
        self._goal = goal  # what brought the arm here
        limit = goal.critical_angle or context.parameters.critical_angle
        self._order = Order(goal, limit, desk.started)
        self._target = Target(context, limit)
        self._is_new = False  # a further goal waits to be looked at
        self.supervising = False

    def take(self, goal: DockGoal) -> DockingError | None:
        """Take a further goal; return what speaks against going on as it wants.

        The lowest critical angle of all goals on this target counts, and who watched goes on watching.
        """
        context, order, desk = self._context, self._order, self._desk
        order.goal, order.since = goal, context.time
        if goal.critical_angle and goal.critical_angle < order.critical_angle:
            order.critical_angle = goal.critical_angle
            known = context.status.estimate if context.status.charging else None
            if known and self._is_too_tilted(known, goal.critical_angle):
                return CriticalAngle("the goal's critical_angle is below what was measured on this target")
        if context.status.charging and goal.start_charging:
            if not goal.hold:
                desk.succeed("already docked and charging")
        else:
            self._is_new = True
        return None

    def _is_too_tilted(self, known: FeltPose, limit: float) -> bool:
        """Return whether what was felt last forbids current below this critical angle, rad."""
        parameters = self._context.parameters
        if parameters.keeps_clearance:
            return known.usable and not judge(known, parameters, limit).leaves_clearance
        return known.classes is None or not known.classes.angle < limit

    def run(self) -> Script[None]:
        """Dock, then serve every goal on this target until contact is lost or the servos are limp."""
        order, desk = self._order, self._desk
        self.supervising = False
        yield from self._dock()
        while True:
            self._is_new = False
            if order.goal.start_charging:
                yield from self._charge()
            elif not order.goal.hold:
                desk.succeed("docked; charging was not asked for")
            self.supervising = True
            if not (yield from self._stay()):
                return
            if order.goal.start_charging:
                self.supervising = False
                yield from self._stand_again()

    def _dock(self) -> Script[None]:
        context = self._context
        context.status.aligned, context.status.estimate = False, None
        context.status.alignments = context.status.redockings = 0
        self._target = Target(context, self._order.critical_angle)
        yield from dock(context, self._target, self._goal.electrodes)

    def _stand_again(self) -> Script[None]:
        """Measure anew where the electrodes rest, and dock anew only where they have no good contact any more."""
        context = self._context
        value, least = context.contact.value, context.parameters.contact_lost_current
        if not (context.observation.tactile_contact and value >= least):
            yield from self._dock()
            return
        context.decide("stay", "docked: clearance is measured anew where it stands", contact_current_A=value)
        yield from self._feel_again()

    def _feel_again(self) -> Script[None]:
        target = self._target
        self._context.status.alignments = self._context.status.redockings = 0
        target.critical_angle = self._order.critical_angle
        if self._context.parameters.approach == "published":
            yield from published.align(self._context, target)
        else:
            yield from align(self._context, target, stay=True)

    def _charge(self) -> Script[None]:
        """Close, report success or hold the goal, watch over charging, and open."""
        context, desk = self._context, self._desk
        while context.doubtful:
            yield from wait_for_single_sources(context)
            yield from self._feel_again()  # without the second source
        yield from energise(context)
        context.status.charging = True
        context.enter(State.CHARGING, math.inf)
        if not self._order.goal.hold:
            desk.succeed("charging")
        self.supervising = True
        self._order.since = context.time
        reason = yield from charge(context, self._order, self._target)
        yield from de_energise(context)
        if not self._is_new:
            desk.succeed(reason)

    def _stay(self) -> Script[bool]:
        """Stay docked without current; return True for a further goal, False where the arm has been let go."""
        context, order, desk = self._context, self._order, self._desk
        context.enter(State.IDLE, math.inf)
        while not self._is_new:
            if not context.observation.torque_enabled:
                if desk.is_open:
                    raise ServoFailure("the servos lost their torque while docked")
                return False
            if context.contact.value < context.parameters.contact_lost_current:
                raise NoContact("contact was lost after docking; the target moved")
            reason = order.is_met(context)
            if desk.is_open and reason:
                context.decide("stop", reason)
                desk.succeed(reason)
            yield NEXT
        return True
