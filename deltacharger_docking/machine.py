# SPDX-License-Identifier: Apache-2.0
"""The docking state machine: Algorithm 1 of the paper and its reverse; and one target from contact to leaving it.

`step` takes an observation and returns a command. It reads no clock, opens no port and never blocks. docking_node calls
it at the rate of servo_state and executes the commands.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from deltacharger_core.script import NEXT, Runner, Script
from deltacharger_docking import algorithm, charging, clearance, codes, contact, energy, goals, release, touch, watch
from deltacharger_docking.arm import Planner
from deltacharger_docking.context import Context, Live
from deltacharger_docking.observation import Command, DockGoal, DockingOutcome, DockingStatus, Observation
from deltacharger_docking.parameters import DockingParameters, TargetProfile
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.trajectory_feed import TrajectoryFeed

_DOUBTS_MAX = 3  # measurements that did not last, in one docking
_UNKNOWN = "this charger does not measure, limit or interrupt it"
_DOCKED = (
    f"docked; power: none: the electrodes are wired to the battery, so current may flow now; {_UNKNOWN}; undock ends it"
)
_PARTED = f"the electrodes were taken off although current may still have flowed (power: none): {_UNKNOWN}"


class DockingMachine:
    """Serves one goal at a time.

    Args:
        parameters: of docking.
        geometry: the delta's dimensions.
        planner: of lines; None = the default one.
        feed: sends lines to the servos; None = one that sends them piece by piece.
        profiles: of targets, by name, the default first; without any, no current flows.

    Attributes:
        is_open: whether a goal is being served.
        outcome: of the last goal; the shell takes it and sets None.
    """

    def __init__(
        self,
        parameters: DockingParameters,
        geometry: DeltaGeometry | None = None,
        planner: Planner | None = None,
        feed: TrajectoryFeed | None = None,
        profiles: Mapping[str, TargetProfile] = MappingProxyType({}),
    ) -> None:
        self._context = Context(parameters, geometry or DeltaGeometry(), planner, feed, profiles)
        self.is_open = self._cancel_requested = False
        self._deadline = math.inf  # of the goal, s
        self.outcome: DockingOutcome | None = None
        self._watches = watch.Watches(self._context)
        self._runner = Runner()
        self._interruptible = self._halted = False  # halted: no look ends what makes the arm safe
        self._docking: TargetVisit | None = None
        self._refusal: codes.DockingError | None = None  # that ends the goal after another goal arrived
        self._failure: codes.DockingError | None = None  # the first error of the goal

    @property
    def parameters(self) -> DockingParameters:
        """Its parameters."""
        return self._context.parameters

    @property
    def status(self) -> DockingStatus:
        """Present state, for feedback and docking_state."""
        return self._context.status

    @property
    def planner(self) -> Planner:
        """Planner of the arm's lines."""
        return self._context.planner

    @property
    def busy(self) -> bool:
        """Whether no further Dock goal can be accepted; one can during supervision after success."""
        return self.is_open or (self._runner.is_running and not self._is_supervising)

    @property
    def _is_supervising(self) -> bool:
        """Whether the electrodes rest on the target under supervision, with a holding goal or without a goal."""
        return self._interruptible and self._docking is not None and self._docking.supervising

    def check_free(self) -> None:
        """Refuse a goal while the machine is busy.

        Raises:
            Busy: a goal is being served, or the arm is on its way back.
        """
        if self.busy:
            raise codes.Busy(self._activity())

    def check(self, goal: DockGoal) -> None:
        """Refuse a goal that can never be served as given, also while another one is.

        Raises:
            Rejected: it cannot be served.
            Unreachable: the electrodes lie outside the workspace.
        """
        goals.check_goal(goal, self._context.planner, self.parameters, self._context.profiles)

    def start_dock(self, goal: DockGoal, observation: Observation) -> None:
        """Begin to dock; if already docked, do what the goal still needs. Raises as `check` and `check_free`."""
        self.check(goal)
        self.check_free()
        goals.check_change(goal, self._context)
        if not self._context.status.charging:
            self._context.choose_profile(goal.target_profile)
        self._open(goal.request_id, observation)
        self._record_goal(goal)
        if self._is_supervising and self._docking is not None:
            self._refusal = self._docking.take_goal(goal)
            return
        self._docking = docking = TargetVisit(self._context, self, goal)
        self._runner.start(self._serve(docking.run))

    def start_undock(self, request_id: str, observation: Observation) -> None:
        """Begin to stop charging and take the arm back.

        Raises:
            Busy: another goal is being served, or the arm is on its way back already.
            Rejected: the request_id is too long.
        """
        goals.check_id(request_id)
        if self.is_open or (self._runner.is_running and not self._interruptible):
            raise codes.Busy(self._activity())
        self._begin(_undock, observation, request_id)

    def tune(self, parameters: DockingParameters) -> str:
        """Use other values of the tunable parameters from the next goal on; return why not if that is refused."""
        if self._is_supervising and not self.is_open:
            return "the electrodes rest on the target under supervision; undock first"
        if self.is_open or self._runner.is_running:
            return f"a goal is running: {self._activity()}"
        self._context.parameters = self._context.planner.parameters = parameters
        return ""

    def start(self, script: Callable[[Context], Script[str]], observation: Observation) -> None:
        """Begin another module's script, however long it takes; the text that it returns is the success message.

        It is interrupted for the same reasons as a docking, and the arm then retracts in the same way.

        Raises:
            Busy: a goal is being served.
        """
        self.check_free()
        self._begin(script, observation)
        self._deadline = math.inf

    def _activity(self) -> str:
        if self.is_open:
            return "another goal is being served; cancel it or wait for its result"
        return "the arm is retracting; wait until docking_state reports IDLE"

    def cancel(self) -> None:
        """End the goal with CANCELED as soon as possible; the arm still retracts. Without a goal nothing happens."""
        self._cancel_requested = self.is_open

    def step(self, observation: Observation) -> Command:
        """Advance by one tick and return what to do."""
        context = self._context
        context.observe(observation)
        context.status.elapsed = context.time - context.started
        context.waits = self._runner.step(self._problem() if self._runner.is_running else None)
        if not self._runner.is_running:
            self._docking, self._interruptible = None, False
        return context.command()

    def emergency(self, error: codes.DockingError | None = None) -> Command:
        """Return the command that makes everything safe at once, for a shell that must end.

        The goal is forgotten. If it is to end with `error`, further steps count its energy and time, until `end`.
        """
        self._forget_script()
        self.is_open &= error is not None
        if error is not None and self.is_open:
            if self._context.status.charging:
                self._context.end_charge(error.code.name)
            if not self._context.status.code:
                self._report(error)
        self._context.energise, self._context.closing = False, None
        self._context.status.charging = False
        self._context.enter(codes.State.IDLE, math.inf)
        if self._context.observation.torque_enabled:
            self._context.hold()
        else:
            self._context.feed.stop()
        return self._context.command()

    def end(self) -> None:
        """End the goal that an emergency has interrupted, if there is one."""
        if self._failure is not None:
            self._fail(self._failure)

    def _open(self, request_id: str, observation: Observation) -> None:
        """Accept a goal."""
        context = self._context
        context.observe(observation)
        self.is_open, self._cancel_requested, self.outcome = True, False, None
        context.started, context.status.elapsed = context.time, 0.0
        self._deadline = context.time + context.parameters.goal_timeout
        context.energy, context.energy_most = math.nan if context.parameters.always_live else 0.0, 0.0
        context.charge_end = ""
        context.deadline = math.inf
        context.status.request_id = request_id
        context.status.code, context.status.message = codes.Code.NONE, ""

    def succeed(self, message: str, notice: str = "") -> None:
        """End the goal with success, if there is one; `notice` is further information for its client."""
        self._close(self._outcome(codes.Code.NONE, message), notice=notice, success=True, aligned=self.status.aligned)

    def _fail(self, error: codes.DockingError) -> None:
        """End the goal with the code of `error` and the message of the status, if there is one."""
        outcome = self._outcome(error.code, self.status.message)
        self._close(outcome, retriable=error.retriable, suggested_base=goals.suggested_base(error))

    def _outcome(self, code: codes.Code, message: str) -> DockingOutcome:
        context, status = self._context, self._context.status
        least, most = context.springs.true_force(context.contact.force)
        return DockingOutcome(
            code=code,
            message=message,
            alignments=status.alignments,
            redockings=status.redockings,
            estimate=status.estimate,
            contact_current=context.contact.value,
            contact_force=context.contact.force,
            contact_force_min=least,
            contact_force_max=most,
            charge_current=math.nan if context.parameters.always_live else context.observation.charge_current,
            energy=context.energy,
            charge_end=context.charge_end,
            charge_voltage=context.charge_voltage if context.charge_end else context.observation.target_voltage,
            elapsed=context.time - context.started,
        )

    def _close(self, outcome: DockingOutcome, **more: Any) -> None:
        if not self.is_open:
            return
        self.is_open, self._cancel_requested, self._deadline = False, False, math.inf
        self.outcome = outcome = replace(outcome, **more)
        text = outcome.message if outcome.success else f"{outcome.code.name}: {outcome.message}"
        self._context.decide("ended", text, code=outcome.code, elapsed_s=outcome.elapsed, energy_J=outcome.energy)

    def _begin(self, script: Callable[[Context], Script[str]], observation: Observation, request_id: str = "") -> None:
        """Accept a goal and begin its script in place of supervision; the contactor stays as it is."""

        def run() -> Script[None]:
            text = yield from script(self._context)
            self._context.enter(codes.State.IDLE, math.inf)
            self.succeed(text)

        self._open(request_id, observation)
        self._context.status.aligned = False
        self._forget_script()
        self._runner.start(self._serve(run))

    def _forget_script(self) -> None:
        self._runner.stop()
        self._docking = self._refusal = None
        self._interruptible = False

    def _record_goal(self, goal: DockGoal) -> None:
        place = {} if goal.electrodes is None else goal.electrodes.numbers
        text = "electrodes as given" if place else "the camera will locate the electrodes"
        text += f"; profile {self._context.profile_name}" if self._context.profile else ""
        options = {"stop_energy_J": goal.stop_energy, "stop_after_s": goal.stop_after, "hold": float(goal.hold)}
        limit = clearance.limit_of(self.parameters, goal.critical_angle or None)
        self._context.decide("accepted", text, **place, critical_angle_rad=limit, **options)

    def _problem(self) -> codes.DockingError | None:
        """Return the reason to interrupt the script now, if any."""
        context = self._context
        if self._interruptible:
            refusal, self._refusal = self._refusal, None
            if self._cancel_requested:
                return codes.Canceled("cancelled by the client")
            if refusal is not None:
                return refusal
        if not self._halted and (problem := self._watches.problem(self._interruptible)) is not None:
            self._halted = isinstance(problem, codes.Astray | codes.ContactorWelded) or not self._interruptible
            return problem
        if self._interruptible and not self._is_supervising and context.time > self._deadline:
            return codes.PhaseTimeout(f"docking took longer than goal_timeout, {self.parameters.goal_timeout:.0f} s")
        return context.expired()  # even retracting has a limit

    def _serve(self, script: Callable[[], Script[None]]) -> Script[None]:
        """Run a goal's script. However it ends, open the contactor and retract the arm; keep the first error."""
        context, self._failure = self._context, None
        self._interruptible, self._halted, self._watches = True, False, watch.Watches(context)
        try:
            yield from script()
            return
        except codes.DockingError as error:
            last = error
            if context.status.charging:
                context.end_charge(error.code.name)
        finally:
            self._interruptible = False
        self._report(last)
        try:
            yield from self._retract(last)
        except codes.ContactorWelded as error:  # whatever ended the goal, a person must come
            self._failure = last = error
        context.enter(codes.State.IDLE, math.inf)
        self._fail(last)

    def _report(self, error: codes.DockingError) -> None:
        """Keep and report why the goal has failed."""
        self._failure, status = error, self._context.status
        status.code, status.message = error.code, str(error)
        problem = self._context.observation.clock_problem
        if problem and not isinstance(error, codes.Canceled):  # without a valid clock, data seem stale
            status.message = f"{status.message}; {problem}"
        self._context.decide("interrupted", f"{error.code.name}: {error}", code=error.code)

    def _retract(self, why: codes.DockingError) -> Script[None]:
        """Open the contactor, move the arm home and switch the torque off."""
        context, status = self._context, self._context.status
        if context.feed.is_under_way(context.time):
            context.hold()
        try:
            if isinstance(why, codes.Astray):
                context.hold()
                context.enter(codes.State.RETRACT, math.inf)
                yield from energy.de_energise(context)
                yield from release.go_limp(context)
            else:
                yield from release.retract(context)
        except codes.ContactorWelded as error:
            seen_closed = watch.is_closed(context) and context.observation.power_age <= self.parameters.age_max
            if status.code is not codes.Code.CONTACTOR_WELDED:
                status.message = f"{status.message}; then {error}"
            context.hold()  # moving live electrodes off the target would draw an arc
            self._halted = True
            if context.is_free:
                yield from release.go_limp(context)
            if seen_closed:
                status.code = error.code
                raise
        except codes.DockingError as error:
            status.message = f"{status.message}; then {error}"
            held = status.docked or context.observation.tactile_contact
            status.docked = held and isinstance(error, codes.Stuck)  # the magnets still hold it
            context.deadline, self._halted = math.inf, True
            yield from release.go_limp(context)
        finally:
            status.charging = False


class TargetVisit:
    """One target, from its first goal until the electrodes leave it.

    Attributes:
        supervising: whether a further goal may be accepted: the electrodes rest on the target.
    """

    def __init__(self, context: Context, machine: DockingMachine, goal: DockGoal) -> None:
        self._context = context
        self._machine = machine
        self._goal = goal  # the first one
        limit = clearance.limit_of(context.parameters, goal.critical_angle or None)
        self._order = charging.Order(goal, limit, context.started)
        self._target = touch.Target(context, limit)
        self._is_new = False  # a further goal has not been handled yet
        self._doubts = 0  # measurements that did not last
        self.supervising = False

    def take_goal(self, goal: DockGoal) -> codes.DockingError | None:
        """Accept a further goal; return why it ends the visit, if it does.

        The lowest critical angle of all goals on this target applies, and supervision continues.
        """
        context, order, parameters = self._context, self._order, self._context.parameters
        order.goal, order.since = goal, context.time
        if goal.critical_angle and goal.critical_angle < order.critical_angle:
            order.critical_angle = goal.critical_angle
            live = context.status.charging or parameters.always_live
            known = context.status.estimate if live else None
            if known and known.usable and not clearance.judge(known, parameters, goal.critical_angle).leaves_clearance:
                return codes.CriticalAngle("the goal's critical_angle is below what was measured on this target")
        if parameters.always_live:
            if not goal.hold:
                self._machine.succeed(_DOCKED, _DOCKED)
        elif context.status.charging and goal.start_charging:
            if not goal.hold:
                self._machine.succeed("already docked and charging")
        else:
            self._is_new = True
        return None

    def run(self) -> Script[None]:
        """Dock, then serve every goal on this target until contact is lost or the torque is off."""
        order = self._order
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
                self._machine.succeed("docked; charging was not asked for")
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
        self._target = touch.Target(context, self._order.critical_angle)
        yield from algorithm.dock(context, self._target, self._goal.electrodes, self._order.goal.start_charging)

    def _renew_contact(self) -> Script[None]:
        """Measure again where the electrodes rest; dock again only if contact is no longer good."""
        context = self._context
        value, least = context.contact.value, contact.CONTACT_LOST_CURRENT
        if not (context.observation.tactile_contact and value >= least):
            yield from self._dock()
            return
        context.decide("stay", "docked: clearance is measured again at this contact", contact_current_A=value)
        yield from self._measure_again()

    def _measure_again(self) -> Script[None]:
        target = self._target
        self._context.status.alignments = self._context.status.redockings = 0
        target.critical_angle = self._order.critical_angle
        yield from algorithm.align(self._context, target, stay=True)

    def _charge(self) -> Script[None]:
        """Close the contactor, report success or hold the goal, supervise charging, and open it."""
        context = self._context
        begun, context.charge_end = context.time, ""
        yield from self._measure_until_sure(begun)
        while not (yield from energy.energise(context)):
            yield from self._measure_until_sure(begun)
        context.status.charging = True
        context.enter(codes.State.CHARGING, math.inf)
        if not self._order.goal.hold:
            self._machine.succeed("charging")
        self.supervising = True
        self._order.since = context.time
        reason = yield from charging.charge(context, self._order, self._target)
        yield from energy.de_energise(context)
        if not self._is_new:
            self._machine.succeed(reason)

    def _measure_until_sure(self, begun: float) -> Script[None]:
        """Measure again until nothing casts doubt on the last measurement; sources are awaited from `begun` (s) on.

        Raises:
            NoContact: no measurement lasted until the contactor could close.
            DuplicateSource: a second source does not disappear.
        """
        context = self._context
        while context.doubtful or context.doubt:
            if context.doubtful:
                yield from energy.wait_for_single_sources(context, begun)
            else:
                self._doubts += 1
                context.decide("doubt", context.doubt, times=self._doubts)
            if self._doubts > _DOUBTS_MAX:
                raise codes.NoContact(f"no measurement lasted until the contactor could close: {context.doubt}")
            yield from self._measure_again()

    def _stay_live(self) -> Script[None]:
        """Stay docked while charge current is not measured; leave the target on a stop condition.

        Electrodes wired to the battery (power: none), as in the paper, are live whenever they touch: nothing closes,
        limits, measures or opens the circuit. So docked electrodes are monitored as while charging. If a check fails,
        docking takes them off. It never reports that it charges.
        """
        context, order = self._context, self._order
        yield from self._measure_until_sure(context.time)
        context.enter(codes.State.IDLE, math.inf)
        if not order.goal.hold:
            self._machine.succeed(_DOCKED, _DOCKED)
        self.supervising, order.since = True, context.time
        reason = yield from _watch(context, order, self._target)
        self.supervising = False
        yield from _part(context)
        self._machine.succeed(reason, f"{reason}; {_PARTED}")

    def _stay(self) -> Script[bool]:
        """Stay docked without current; return whether a goal follows, not a torque that went off or `hold_max`."""
        context, order = self._context, self._order
        context.enter(codes.State.IDLE, math.inf)
        while not self._is_new:
            if not context.observation.torque_enabled:
                if self._machine.is_open:
                    raise codes.ServoFailure("the servos lost their torque while docked; see servo_node's diagnostics")
                return False
            if context.contact.value < contact.CONTACT_LOST_CURRENT:
                raise codes.NoContact("contact was lost after docking; the target moved")
            _, reason = order.met(context)
            if self._machine.is_open and reason:
                context.decide("stop", reason)
                self._machine.succeed(reason)
            if order.is_over(context):
                self.supervising = False
                yield from _part(context)
                return False
            yield NEXT
        return True


def _watch(context: Context, order: charging.Order, target: touch.Target) -> Script[str]:
    """Monitor docked electrodes as is done while charging, until a stop condition is met; return that condition.

    Raises:
        DockingError: the problem; the caller retracts.
    """
    checks, context.closing = charging.clearance_checks(context, order, target), Live(context.time)
    while True:
        if reason := order.met(context)[1]:
            context.decide("stop", reason, time_s=context.time - order.since)
            return reason
        yield next(checks)


def _part(context: Context) -> Script[None]:
    """Retract: the only way to end the current."""
    yield from release.retract(context, wanted=True)
    context.status.docked = False
    context.enter(codes.State.IDLE, math.inf)


def _undock(context: Context) -> Script[str]:
    yield from release.retract(context, wanted=True)
    context.status.docked = False
    return "undocked"
