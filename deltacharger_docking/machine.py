# SPDX-License-Identifier: Apache-2.0
"""The docking state machine: Algorithm 1 of the paper and its reverse.

`step` takes an observation and returns a command. It reads no clock, opens no port and never blocks. docking_node calls
it at the rate of servo_state and executes the commands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

from deltacharger_core.script import Runner, Script
from deltacharger_docking.codes import (
    Astray,
    Busy,
    Canceled,
    Code,
    ContactorWelded,
    DockingError,
    PhaseTimeout,
    State,
    Stuck,
)
from deltacharger_docking.context import Context
from deltacharger_docking.energy import de_energise
from deltacharger_docking.goals import GoalDesk, check_change, check_goal, check_id
from deltacharger_docking.motion import Planner
from deltacharger_docking.observation import Command, DockGoal, DockingOutcome, DockingStatus, Observation
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.profile import TargetProfile
from deltacharger_docking.retract import go_limp, retract
from deltacharger_docking.visit import TargetVisit
from deltacharger_docking.watch import Watches, is_closed
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.trajectory_feed import TrajectoryFeed


class DockingMachine:
    """Serves one goal at a time; `status` and `outcome` report its progress and result.

    Args:
        parameters: of docking.
        geometry: the delta's dimensions.
        planner: of lines; None = the default one.
        feed: sends lines to the servos; None = one that sends them piece by piece.
        profiles: of targets, by name, the default first; without any, no current flows.
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
        self._desk = GoalDesk(self._context)
        self._watches = Watches(self._context)
        self._runner = Runner()
        self._interruptible = self._halted = False  # halted: no look ends what makes the arm safe
        self._docking: TargetVisit | None = None
        self._refusal: DockingError | None = None  # that ends the goal after another goal arrived
        self._failure: DockingError | None = None  # the first error of the goal

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
    def outcome(self) -> DockingOutcome | None:
        """Result of the last goal; the shell takes it and sets None."""
        return self._desk.outcome

    @outcome.setter
    def outcome(self, value: None) -> None:
        self._desk.outcome = value

    @property
    def busy(self) -> bool:
        """Whether no further Dock goal can be accepted; one can during supervision after success."""
        return self._desk.is_open or (self._runner.is_running and not self._is_supervising)

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
            raise Busy(self._activity())

    def check(self, goal: DockGoal) -> None:
        """Refuse a goal that can never be served as given, also while another one is.

        Raises:
            Rejected: it cannot be served.
            Unreachable: the electrodes lie outside the workspace.
        """
        check_goal(goal, self._context.planner, self.parameters, self._context.profiles)

    def start_dock(self, goal: DockGoal, observation: Observation) -> None:
        """Begin to dock; if already docked, do what the goal still needs. Raises as `check` and `check_free`."""
        self.check(goal)
        self.check_free()
        check_change(goal, self._context)
        if not self._context.status.charging:
            self._context.choose_profile(goal.target_profile)
        self._desk.begin(goal.request_id, observation)
        self._record_goal(goal)
        if self._is_supervising and self._docking is not None:
            self._refusal = self._docking.take(goal)
            return
        self._docking = docking = TargetVisit(self._context, self._desk, goal)
        self._runner.start(self._serve(docking.run))

    def start_undock(self, request_id: str, observation: Observation) -> None:
        """Begin to stop charging and take the arm back.

        Raises:
            Busy: another goal is being served, or the arm is on its way back already.
            Rejected: the request_id is too long.
        """
        check_id(request_id)
        if self._desk.is_open or (self._runner.is_running and not self._interruptible):
            raise Busy(self._activity())
        self._begin(_undock, observation, request_id)

    def tune(self, parameters: DockingParameters) -> str:
        """Use other values of the tunable parameters from the next goal on; return why not if that is refused."""
        if self._is_supervising and not self._desk.is_open:
            return "the electrodes rest on the target under supervision; undock first"
        if self._desk.is_open or self._runner.is_running:
            return f"a goal is running: {self._activity()}"
        self._context.use_parameters(parameters)
        return ""

    def start(self, script: Callable[[Context], Script[str]], observation: Observation) -> None:
        """Begin another module's script, however long it takes; the text that it returns is the success message.

        It is interrupted for the same reasons as a docking, and the arm then retracts in the same way.

        Raises:
            Busy: a goal is being served.
        """
        self.check_free()
        self._begin(script, observation)
        self._desk.deadline = math.inf

    def _activity(self) -> str:
        if self._desk.is_open:
            return "another goal is being served; cancel it or wait for its result"
        return "the arm is retracting; wait until docking_state reports IDLE"

    def cancel(self) -> None:
        """End the goal with CANCELED as soon as possible; the arm still retracts. Without a goal nothing happens."""
        self._desk.cancel_requested = self._desk.is_open

    def step(self, observation: Observation) -> Command:
        """Advance by one tick and return what to do."""
        context = self._context
        context.observe(observation)
        context.status.elapsed = context.time - context.started
        context.waits = self._runner.step(self._problem() if self._runner.is_running else None)
        if not self._runner.is_running:
            self._docking, self._interruptible = None, False
        return context.command()

    def emergency(self, error: DockingError | None = None) -> Command:
        """Return the command that makes everything safe at once, for a shell that must end.

        The goal is forgotten. If it is to end with `error`, further steps count its energy and time, until `end`.
        """
        self._forget_script()
        self._desk.is_open &= error is not None
        if error is not None and self._desk.is_open:
            if self._context.status.charging:
                self._context.end_charge(error.code.name)
            if not self._context.status.code:
                self._report(error)
        self._context.energise, self._context.closing = False, None
        self._context.status.charging = False
        self._context.enter(State.IDLE, math.inf)
        if self._context.observation.torque_enabled:
            self._context.hold()
        else:
            self._context.feed.stop()
        return self._context.command()

    def end(self) -> None:
        """End the goal that an emergency has interrupted, if there is one."""
        if self._failure is not None:
            self._desk.fail(self._failure)

    def _begin(self, script: Callable[[Context], Script[str]], observation: Observation, request_id: str = "") -> None:
        """Accept a goal and begin its script in place of supervision; the contactor stays as it is."""

        def run() -> Script[None]:
            text = yield from script(self._context)
            self._context.enter(State.IDLE, math.inf)
            self._desk.succeed(text)

        self._desk.begin(request_id, observation)
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
        limit = goal.critical_angle or self.parameters.critical_angle
        self._context.decide("accepted", text, **place, critical_angle_rad=limit, **options)

    def _problem(self) -> DockingError | None:
        """Return the reason to interrupt the script now, if any."""
        context, desk = self._context, self._desk
        if self._interruptible:
            refusal, self._refusal = self._refusal, None
            if desk.cancel_requested:
                return Canceled("cancelled by the client")
            if refusal is not None:
                return refusal
        if not self._halted and (problem := self._watches.problem(self._interruptible)) is not None:
            self._halted = isinstance(problem, Astray | ContactorWelded) or not self._interruptible
            return problem
        if self._interruptible and not self._is_supervising and context.time > desk.deadline:
            return PhaseTimeout(f"docking took longer than goal_timeout, {self.parameters.goal_timeout:.0f} s")
        return context.expired()  # even retracting has a limit

    def _serve(self, script: Callable[[], Script[None]]) -> Script[None]:
        """Run a goal's script. However it ends, open the contactor and retract the arm; keep the first error."""
        context, self._failure = self._context, None
        self._interruptible, self._halted, self._watches = True, False, Watches(context)
        try:
            yield from script()
            return
        except DockingError as error:
            last = error
            if context.status.charging:
                context.end_charge(error.code.name)
        finally:
            self._interruptible = False
        self._report(last)
        try:
            yield from self._retract(last)
        except ContactorWelded as error:  # whatever ended the goal, a person must come
            self._failure = last = error
        context.enter(State.IDLE, math.inf)
        self._desk.fail(last)

    def _report(self, error: DockingError) -> None:
        """Keep and report why the goal has failed."""
        self._failure, status = error, self._context.status
        status.code, status.message = error.code, str(error)
        problem = self._context.observation.clock_problem
        if problem and not isinstance(error, Canceled):  # without a valid clock, data seem stale
            status.message = f"{status.message}; {problem}"
        self._context.decide("interrupted", f"{error.code.name}: {error}", code=error.code)

    def _retract(self, why: DockingError) -> Script[None]:
        """Open the contactor, move the arm home and switch the torque off."""
        context, status = self._context, self._context.status
        context.interrupt()
        try:
            if isinstance(why, Astray):
                context.hold()
                context.enter(State.RETRACT, math.inf)
                yield from de_energise(context)
                yield from go_limp(context)
            else:
                yield from retract(context)
        except ContactorWelded as error:
            seen_closed = is_closed(context) and context.observation.power_age <= self.parameters.power_age_max
            if status.code is not Code.CONTACTOR_WELDED:
                status.message = f"{status.message}; then {error}"
            context.hold()  # moving live electrodes off the target would draw an arc
            self._halted = True
            if context.is_free:
                yield from go_limp(context)
            if seen_closed:
                status.code = error.code
                raise
        except DockingError as error:
            status.message = f"{status.message}; then {error}"
            held = status.docked or context.observation.tactile_contact
            status.docked = held and isinstance(error, Stuck)  # the magnets still hold it
            context.deadline, self._halted = math.inf, True
            yield from go_limp(context)
        finally:
            status.charging = False


def _undock(context: Context) -> Script[str]:
    yield from retract(context, wanted=True)
    context.status.docked = False
    return "undocked"
