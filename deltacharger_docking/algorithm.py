# SPDX-License-Identifier: Apache-2.0
"""Dock from its goal on: Algorithm 1, charging, and watching over the docked target until somebody wants otherwise."""

from __future__ import annotations

import math

from deltacharger_docking.arm import prepare
from deltacharger_docking.charging import Order, charge
from deltacharger_docking.clearance import judge
from deltacharger_docking.codes import (
    CriticalAngle,
    DetectionStale,
    DockingError,
    ElectrodesNotFound,
    NoContact,
    ServoFailure,
    State,
)
from deltacharger_docking.context import Context
from deltacharger_docking.energy import de_energise, energise, wait_for_single_sources
from deltacharger_docking.goals import GoalDesk, check_place
from deltacharger_docking.observation import DockGoal, ElectrodePose, Service
from deltacharger_docking.press import approach, contact, first_push
from deltacharger_docking.script import NEXT, Script
from deltacharger_docking.touch import Alignment

_ANSWER = 1.0  # s beyond locate_timeout, so that the phase ends with what the detector says


class TargetVisit:
    """One target, from the first goal on it until the electrodes leave it.

    Attributes:
        supervising: whether a further goal may be taken: the electrodes rest on the target.
    """

    def __init__(self, context: Context, desk: GoalDesk, goal: DockGoal) -> None:
        self._context = context
        self._desk = desk
        self._goal = goal  # what brought the arm here
        self._alignment: Alignment | None = None
        self._is_new = False  # a further goal waits to be looked at
        limit = goal.critical_angle or context.parameters.critical_angle
        self._order = Order(goal, limit, desk.started)
        self.supervising = False

    def take(self, goal: DockGoal) -> DockingError | None:
        """Take a further goal; return what speaks against going on as it wants.

        The lowest critical angle of all goals on this target counts, and who watched goes on watching.
        """
        context, order, desk = self._context, self._order, self._desk
        order.goal, order.since = goal, context.time
        if self._alignment is not None:
            desk.aligned = self._alignment.aligned
        if goal.critical_angle and goal.critical_angle < order.critical_angle:
            order.critical_angle = goal.critical_angle
            known = context.status.estimate if context.status.charging else None
            lost = known and known.usable and not judge(known, context.parameters, goal.critical_angle).leaves_clearance
            if lost:
                return CriticalAngle("the goal's critical_angle is below what was measured on this target")
        if context.status.charging and goal.start_charging:
            if not goal.hold:
                desk.succeed("already docked and charging")
        else:
            self._is_new = True
        return None

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
                desk.succeed("aligned contact; charging was not asked for")
            self.supervising = True
            if not (yield from self._stay()):
                return
            if order.goal.start_charging:
                self.supervising = False
                yield from self._stand_again()

    def _dock(self) -> Script[None]:
        """Algorithm 1."""
        context, parameters, goal = self._context, self._context.parameters, self._goal
        context.status.alignments = 0
        context.status.estimate = None
        electrodes = goal.electrodes if goal.electrodes is not None else (yield from locate(context))
        self._check_roll(electrodes)
        yield from prepare(context)
        target, depth = electrodes.position, electrodes.position[2] + parameters.search_depth
        yield from approach(context, target)
        if parameters.approach == "paper":
            yield from first_push(context, target)
        yield from contact(context, depth)
        self._alignment = Alignment(context, self._order.critical_angle, depth)
        yield from self._align(self._alignment)

    def _align(self, alignment: Alignment, stay: bool = False) -> Script[None]:
        alignment.critical_angle = self._order.critical_angle
        try:
            yield from alignment.run(stay)
        finally:
            self._desk.aligned = alignment.aligned
        self._context.status.docked = True

    def _stand_again(self) -> Script[None]:
        """Measure anew where the electrodes rest, and dock anew only where they have no good contact any more."""
        context = self._context
        value, least = context.contact.value, context.parameters.contact_lost_current
        if self._alignment is None or not (context.observation.tactile_contact and value >= least):
            yield from self._dock()
            return
        context.decide("stay", "docked: clearance is measured anew where it stands", contact_current_A=value)
        context.status.alignments = 0
        yield from self._align(self._alignment, stay=True)

    def _charge(self) -> Script[None]:
        """Close, report success or hold the goal, watch over charging, and open."""
        context, desk = self._context, self._desk
        while context.doubtful and self._alignment is not None:
            yield from wait_for_single_sources(context)
            context.status.alignments = 0
            yield from self._align(self._alignment, stay=True)  # felt again, without the second source
        yield from energise(context)
        context.status.charging = True
        context.enter(State.CHARGING, math.inf)
        if not self._order.goal.hold:
            desk.succeed("charging")
        self.supervising = True
        self._order.since = context.time
        reason = yield from charge(context, self._order)
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

    def _check_roll(self, electrodes: ElectrodePose) -> None:
        limit, roll = self._order.critical_angle, electrodes.roll
        if abs(roll) + self._context.parameters.roll_sigmas * electrodes.roll_stddev < limit:
            return
        self._context.decide(
            "refused",
            "the given roll is too large",
            roll_rad=roll,
            roll_stddev_rad=electrodes.roll_stddev,
            limit_rad=limit,
        )
        raise CriticalAngle(
            f"the electrodes are rolled by {math.degrees(roll):.1f}° already in the given pose; "
            "level the target or the charger"
        )


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
    x, y, z = found.position
    context.decide("located", "the camera sees the electrodes", x_m=x, y_m=y, z_m=z, roll_rad=found.roll)
    return found
