# SPDX-License-Identifier: Apache-2.0
"""One target from contact to leaving it: docking, charging, staying docked, and further goals."""

from __future__ import annotations

import math

from deltacharger_core.script import NEXT, Script
from deltacharger_docking import wired
from deltacharger_docking.algorithm import align, dock
from deltacharger_docking.charging import Order, charge
from deltacharger_docking.clearance import judge
from deltacharger_docking.codes import CriticalAngle, DockingError, NoContact, ServoFailure, State
from deltacharger_docking.context import Context
from deltacharger_docking.energy import de_energise, energise, wait_for_single_sources
from deltacharger_docking.evidence import CONTACT_LOST_CURRENT
from deltacharger_docking.goals import GoalDesk
from deltacharger_docking.observation import DockGoal
from deltacharger_docking.touch import Target

_DOUBTS_MAX = 3


class TargetVisit:
    """One target, from its first goal until the electrodes leave it.

    Attributes:
        supervising: whether a further goal may be accepted: the electrodes rest on the target.
    """

    def __init__(self, context: Context, desk: GoalDesk, goal: DockGoal) -> None:
        self._context = context
        self._desk = desk
        self._goal = goal  # the first one
        limit = goal.critical_angle or context.parameters.critical_angle
        self._order = Order(goal, limit, context.started)
        self._target = Target(context, limit)
        self._is_new = False  # a further goal has not been handled yet
        self._doubts = 0  # measurements that did not last
        self.supervising = False

    def take(self, goal: DockGoal) -> DockingError | None:
        """Accept a further goal; return why it ends the visit, if it does.

        The lowest critical angle of all goals on this target applies, and supervision continues.
        """
        context, order, desk, parameters = self._context, self._order, self._desk, self._context.parameters
        order.goal, order.since = goal, context.time
        if goal.critical_angle and goal.critical_angle < order.critical_angle:
            order.critical_angle = goal.critical_angle
            live = context.status.charging or parameters.always_live
            known = context.status.estimate if live else None
            if known and known.usable and not judge(known, parameters, goal.critical_angle).leaves_clearance:
                return CriticalAngle("the goal's critical_angle is below what was measured on this target")
        if parameters.always_live:
            if not goal.hold:
                desk.succeed(wired.DOCKED, wired.DOCKED)
        elif context.status.charging and goal.start_charging:
            if not goal.hold:
                desk.succeed("already docked and charging")
        else:
            self._is_new = True
        return None

    def run(self) -> Script[None]:
        """Dock, then serve every goal on this target until contact is lost or the torque is off."""
        order, desk = self._order, self._desk
        self.supervising = False
        yield from self._dock()
        if self._context.parameters.always_live:
            yield from self._stay_live()
            return
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
                yield from self._renew_contact()

    def _dock(self) -> Script[None]:
        context = self._context
        context.status.aligned, context.status.estimate = False, None
        context.status.alignments = context.status.redockings = self._doubts = 0
        self._target = Target(context, self._order.critical_angle)
        yield from dock(context, self._target, self._goal.electrodes, self._order.goal.start_charging)

    def _renew_contact(self) -> Script[None]:
        """Measure again where the electrodes rest; dock again only if contact is no longer good."""
        context = self._context
        value, least = context.contact.value, CONTACT_LOST_CURRENT
        if not (context.observation.tactile_contact and value >= least):
            yield from self._dock()
            return
        context.decide("stay", "docked: clearance is measured again at this contact", contact_current_A=value)
        yield from self._measure_again()

    def _measure_again(self) -> Script[None]:
        target = self._target
        self._context.status.alignments = self._context.status.redockings = 0
        target.critical_angle = self._order.critical_angle
        yield from align(self._context, target, stay=True)

    def _charge(self) -> Script[None]:
        """Close the contactor, report success or hold the goal, supervise charging, and open it."""
        context, desk = self._context, self._desk
        begun, context.charge_end = context.time, ""
        yield from self._measure_until_sure(begun)
        while not (yield from energise(context)):
            yield from self._measure_until_sure(begun)
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

    def _measure_until_sure(self, begun: float) -> Script[None]:
        """Measure again until nothing casts doubt on the last measurement; sources are awaited from `begun` (s) on.

        Raises:
            NoContact: no measurement lasted until the contactor could close.
            DuplicateSource: a second source does not disappear.
        """
        context = self._context
        while context.doubtful or context.doubt:
            if context.doubtful:
                yield from wait_for_single_sources(context, begun)
            else:
                self._doubts += 1
                context.decide("doubt", context.doubt, times=self._doubts)
            if self._doubts > _DOUBTS_MAX:
                raise NoContact(f"no measurement lasted until the contactor could close: {context.doubt}")
            yield from self._measure_again()

    def _stay_live(self) -> Script[None]:
        """Stay docked while charge current is not measured; leave the target on a stop condition."""
        context, order, desk = self._context, self._order, self._desk
        yield from self._measure_until_sure(context.time)
        context.enter(State.IDLE, math.inf)
        if not order.goal.hold:
            desk.succeed(wired.DOCKED, wired.DOCKED)
        self.supervising, order.since = True, context.time
        reason = yield from wired.watch(context, order, self._target)
        self.supervising = False
        yield from wired.part(context)
        desk.succeed(reason, f"{reason}; {wired.PARTED}")

    def _stay(self) -> Script[bool]:
        """Stay docked without current; return whether a goal follows, not a torque that went off or `hold_max`."""
        context, order, desk = self._context, self._order, self._desk
        context.enter(State.IDLE, math.inf)
        while not self._is_new:
            if not context.observation.torque_enabled:
                if desk.is_open:
                    raise ServoFailure("the servos lost their torque while docked; see servo_node's diagnostics")
                return False
            if context.contact.value < CONTACT_LOST_CURRENT:
                raise NoContact("contact was lost after docking; the target moved")
            reason = order.is_met(context)
            if desk.is_open and reason:
                context.decide("stop", reason)
                desk.succeed(reason)
            if order.is_over(context):
                self.supervising = False
                yield from wired.part(context)
                return False
            yield NEXT
        return True
