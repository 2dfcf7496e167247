"""The docking state machine: Algorithm 1 of the paper and its reverse.

`step` takes an observation and returns a command; it reads no clock, opens no port and never blocks. The node around it
calls it at the servo state's rate and carries the commands out.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import replace

from deltacharger_docking.align_script import Alignment
from deltacharger_docking.arm_script import FIRST_DATA, let_go, prepare, retract
from deltacharger_docking.codes import (
    Busy,
    Canceled,
    Code,
    ContactorWelded,
    CriticalAngle,
    DetectionStale,
    DockingError,
    ElectrodesNotFound,
    NoContact,
    Overcurrent,
    PhaseTimeout,
    ServoFailure,
    State,
    TactileStale,
)
from deltacharger_docking.contact_script import approach, contact, first_push
from deltacharger_docking.context import Context, Script
from deltacharger_docking.energy_script import CONTACT_LOST, charge, de_energise, energise
from deltacharger_docking.goal_check import check_goal, check_place, suggested_base
from deltacharger_docking.motion import Planner
from deltacharger_docking.observation import Command, Detection, DockGoal, Observation, Outcome, Service, Status
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.trajectory_feed import TrajectoryFeed
from deltacharger_kinematics.geometry import DeltaGeometry, Vector

_NEEDS_TORQUE = (State.BACK_OFF, State.CONTACT, State.MEASURE, State.ALIGN)
_NEEDS_TOUCH = (State.APPROACH, *_NEEDS_TORQUE)


class DockingMachine:
    """Serves one goal at a time; `status` and `outcome` tell the shell how it stands.

    Args:
        parameters: what it decides by.
        geometry: the delta's dimensions.
        planner: of lines; None = the usual one.
        feed: that tells lines to the servos; None = piece by piece.
    """

    def __init__(
        self,
        parameters: DockingParameters,
        geometry: DeltaGeometry | None = None,
        planner: Planner | None = None,
        feed: TrajectoryFeed | None = None,
    ) -> None:
        self.parameters = parameters
        self._context = Context(parameters, geometry or DeltaGeometry(), planner, feed)
        self._script: Generator[None, None, None] | None = None
        self._cancel = False
        self._interruptible = False
        self._supervising = False
        self._started = 0.0
        self._goal_deadline = math.inf
        self._alignment: Alignment | None = None
        self.outcome: Outcome | None = None

    @property
    def status(self) -> Status:
        """Present state, for feedback and docking_state."""
        return self._context.status

    @property
    def busy(self) -> bool:
        """Whether a goal is being served; supervision after success leaves the machine free for the next goal."""
        return self._script is not None and not self._supervising

    @property
    def idle_until(self) -> float:
        """Until when (s) the script only lets time pass, as far as it knows; what interrupts it is looked at in steps.

        A shell in virtual time may take longer steps until then: it must only take them before the pieces of a line
        run out, and feed the readings between them to `read` where `reads`.
        """
        return self._context.idle_until

    @property
    def reads(self) -> bool:
        """Whether the script judges by the readings made until `idle_until`."""
        return self._context.reads

    def read(self, time: float, angles: Vector, currents: Vector) -> None:
        """Take a reading of the servos (s, rad, A) between two steps."""
        self._context.contact.update(time, angles, currents)

    def start_dock(self, goal: DockGoal, observation: Observation) -> None:
        """Begin to dock.

        Raises:
            Rejected: the goal cannot be served; nothing moved.
            Unreachable: the electrodes lie outside the workspace.
        """
        if self.busy:
            raise Busy("another goal is being served; cancel it or wait for its result")
        check_goal(goal, self._context.planner, self.parameters)
        self._begin(goal.request_id, observation)
        if self._supervising and self.status.docked and (self.status.charging or not goal.start_charging):
            self._finish(self._success("already docked"))
            return
        self._leave_supervision()
        self._script = self._guarded(self._dock(goal))

    def start_undock(self, request_id: str, observation: Observation) -> None:
        """Begin to stop charging and take the arm back.

        Raises:
            Busy: another goal is being served.
        """
        if self.busy:
            raise Busy("another goal is being served; cancel it or wait for its result")
        self._begin(request_id, observation)
        self._leave_supervision()
        self._script = self._guarded(self._undock())

    def cancel(self) -> None:
        """Let the goal end with CANCELED as soon as it can; the arm still retracts."""
        self._cancel = True

    def step(self, observation: Observation) -> Command:
        """Advance by one tick and return what to do."""
        context = self._context
        context.observe(observation)
        context.status.elapsed = observation.time - self._started
        if self._script is not None:
            self._advance()
        return context.command()

    def emergency(self) -> Command:
        """Return the command that leaves everything safe at once, and forget the goal: for a shell that must end."""
        self._script = None
        self._supervising = False
        self._context.energise = False
        self._context.status.charging = False
        self._context.status.state = State.IDLE
        if self._context.observation.torque_enabled:
            self._context.hold()
        else:
            self._context.feed.stop()
        return self._context.command()

    def _advance(self) -> None:
        assert self._script is not None
        try:
            problem = self._problem()
            if problem is None:
                next(self._script)
            else:
                self._script.throw(problem)
        except StopIteration:
            self._script = None
            self._supervising = False

    def _problem(self) -> DockingError | None:
        """Return what must interrupt the script now."""
        if not self._interruptible:
            return self._context.expired()  # even the way back ends
        context, observation, parameters = self._context, self._context.observation, self.parameters
        if self._cancel:
            self._cancel = False
            return Canceled("cancelled by the client")
        if self._is_missing(observation.servo_age, parameters.servo_age_max):
            return ServoFailure(f"servo_state is {observation.servo_age:.1f} s old; check the servo bus and servo_node")
        if observation.hardware_error:
            return ServoFailure(
                f"a servo reports hardware error {observation.hardware_error:#04x}; remove the cause, then call "
                "reboot_servos"
            )
        if context.contact.value > parameters.hard_current:
            return Overcurrent(f"contact current is {context.contact.value:.2f} A, above {parameters.hard_current} A")
        touches = context.status.state in _NEEDS_TOUCH
        if touches and self._is_missing(observation.tactile_age, parameters.tactile_age_max):
            return TactileStale("tactile frames stopped; check the board's cable and tactile_node")
        moving = context.status.state is State.APPROACH and context.feed.is_under_way(observation.time)
        if (moving or context.status.state in _NEEDS_TORQUE) and not observation.torque_enabled:
            return ServoFailure("the servos lost their torque; look at the diagnostics of servo_node")
        if not self._supervising and observation.time > self._goal_deadline:
            return PhaseTimeout(f"docking took longer than goal_timeout, {parameters.goal_timeout:.0f} s")
        return context.expired()

    def _is_missing(self, age: float, oldest: float) -> bool:
        """Return whether data of this age (s) end the goal; nodes that have just started are waited for."""
        starting = age == math.inf and self._context.time - self._started < FIRST_DATA
        return age > oldest and not starting

    def _begin(self, request_id: str, observation: Observation) -> None:
        context = self._context
        context.observe(observation)
        self._started = observation.time
        self._goal_deadline = observation.time + self.parameters.goal_timeout
        self._cancel = False
        self.outcome = None
        context.deadline = math.inf
        context.status.request_id = request_id
        context.status.code = Code.NONE
        context.status.message = ""

    def _leave_supervision(self) -> None:
        """End watching over a charging target; the contactor stays as it is for the script that follows."""
        if self._script is not None:
            self._script.close()
            self._script = None
        self._supervising = False

    def _guarded(self, script: Script[None]) -> Generator[None, None, None]:
        """Run a goal's script; whatever ends it, open the contactor and take the arm back, keeping the first error."""
        context = self._context
        self._interruptible = True
        try:
            yield from script
            return
        except DockingError as error:
            first = error
        finally:
            self._interruptible = False
        context.interrupt()
        context.status.code, context.status.message = first.code, str(first)
        # From here on the machine is busy: a goal that came now would cut the way back short.
        supervising, self._supervising = self._supervising, False
        try:
            yield from retract(context)
            context.status.docked = False
        except ContactorWelded as error:
            # Torque stays on: pulling or letting go of live electrodes would draw an arc.
            if not isinstance(first, ContactorWelded):
                context.status.message = f"{first}; then {error}"
            context.hold()
        except DockingError as error:
            context.status.message = f"{first}; then {error}"
            context.status.docked = False
            context.deadline = math.inf
            yield from let_go(context)
        context.status.charging = False
        context.enter(State.IDLE, math.inf)
        if not supervising:
            self._finish(self._failure(first))

    def _dock(self, goal: DockGoal) -> Script[None]:
        """Algorithm 1."""
        context, parameters = self._context, self.parameters
        context.status.alignments = 0
        context.status.estimate = None
        context.energy = 0.0
        limit = goal.critical_angle or parameters.critical_angle
        electrodes = goal.electrodes if goal.electrodes is not None else (yield from self._locate())
        if abs(electrodes.roll) + 2.0 * electrodes.roll_stddev >= limit:
            raise CriticalAngle(
                f"the electrodes are rolled by {math.degrees(electrodes.roll):.1f}° already in the given pose; "
                "level the target or the charger"
            )
        yield from prepare(context, self._started)
        target, depth = electrodes.position, electrodes.position[2] + parameters.search_depth
        yield from approach(context, target)
        if parameters.approach == "paper":
            yield from first_push(context, target)
        yield from contact(context, depth)
        self._alignment = Alignment(context, limit, depth)
        yield from self._alignment.run()
        context.status.docked = True
        if not goal.start_charging:
            self._finish(self._success("aligned contact; charging was not asked for"))
            yield from self._supervise_contact()
            return
        yield from energise(context)
        yield from self._charge(goal, limit)

    def _charge(self, goal: DockGoal, limit: float) -> Script[None]:
        """Report success, or hold the goal, and watch over charging."""
        context = self._context
        context.status.charging = True
        self._goal_deadline = math.inf
        if not goal.hold:
            context.status.state = State.CHARGING
            self._finish(self._success("charging"))
            self._supervising = True
        yield from charge(context, goal, limit)
        yield from de_energise(context)
        if goal.hold:
            self._finish(self._success("the stop condition was met"))
        yield from self._supervise_contact()

    def _supervise_contact(self) -> Script[None]:
        """Stay docked without current until the next goal; go back when the target leaves."""
        context = self._context
        self._supervising = True
        context.enter(State.IDLE, math.inf)
        while context.observation.torque_enabled:
            if context.contact.value < CONTACT_LOST:
                raise NoContact("contact was lost after docking; the target moved")
            yield

    def _undock(self) -> Script[None]:
        context = self._context
        yield from retract(context, wanted=True)
        context.status.docked = False
        context.enter(State.IDLE, math.inf)
        self._finish(Outcome(True, Code.NONE, "undocked"))

    def _locate(self) -> Script[Detection]:
        """Ask the camera where the electrodes are."""
        context, parameters = self._context, self.parameters
        context.enter(State.LOCATE, parameters.locate_timeout + 1.0)
        reply = yield from context.ask(Service.DETECT, ElectrodesNotFound, parameters.locate_timeout)
        if not reply.success or reply.detection is None:
            raise ElectrodesNotFound(f"no electrodes were found: {reply.message}")
        if reply.detection.age > parameters.detection_age_max:
            raise DetectionStale(
                f"the detection is {reply.detection.age:.1f} s old, more than {parameters.detection_age_max:.1f} s"
            )
        check_place(reply.detection, context.planner, parameters)
        return reply.detection

    def _success(self, message: str) -> Outcome:
        return self._outcome(True, Code.NONE, message, False)

    def _failure(self, error: DockingError) -> Outcome:
        outcome = self._outcome(False, error.code, self._context.status.message, error.retriable)
        return replace(outcome, suggested_base=suggested_base(error))

    def _outcome(self, success: bool, code: Code, message: str, retriable: bool) -> Outcome:
        context = self._context
        return Outcome(
            success=success,
            code=code,
            message=message,
            retriable=retriable,
            aligned=self._alignment.aligned if self._alignment is not None else False,
            alignments=context.status.alignments,
            estimate=context.status.estimate,
            contact_current=context.contact.value,
            contact_force=context.contact.force,
            charge_current=context.observation.charge_current,
            energy=context.energy,
        )

    def _finish(self, outcome: Outcome) -> None:
        elapsed = self._context.time - self._started
        self.outcome = replace(outcome, elapsed=elapsed)
