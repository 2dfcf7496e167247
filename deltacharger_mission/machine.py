# SPDX-License-Identifier: Apache-2.0
"""The mission state machine: the paper's strategy of operation.

Wait until all needed nodes answer, drive to the target, look for its electrodes, move the robot if they are out of
reach or askew, dock, charge, undock, return. `step` takes an observation and returns a command; it reads no clock,
opens no port and never blocks. However the mission ends, the final steps are the same: cancel open requests, undock,
return.
"""

from __future__ import annotations

import math
from dataclasses import replace

from deltacharger_core.machine import DOCK_DISTANCE
from deltacharger_core.script import NEXT, Runner, Script
from deltacharger_docking.codes import Busy, Canceled, Code, DockingError, ElectrodesNotFound, PhaseTimeout, Rejected
from deltacharger_docking.goals import check_id, check_stops
from deltacharger_docking.observation import BasePose, ElectrodePose
from deltacharger_mission.context import MissionContext, dock_failure
from deltacharger_mission.dialogue import (
    End,
    MissionCommand,
    MissionGoal,
    MissionObservation,
    MissionOutcome,
    MissionStatus,
    Stage,
    Task,
    TaskReply,
)
from deltacharger_mission.parameters import MissionParameters
from deltacharger_mission.places import BaseMount, Place, views

GAIN_MIN, GAIN_TURN_MIN = 0.005, 0.02  # m, rad; a suggested move below both is not driven
FACING_STDDEV_MAX = math.radians(2.0)  # of a detected yaw; above it the given facing is used
_LOOK_PAUSE = 0.5  # s between two detections from one place
_REDOCKINGS = 2  # in a mission, after current had flowed: a pad slipped, a stage tripped; a third time is no accident
_MENDED_BY_A_MOVE = (Code.UNREACHABLE, Code.LEANING)


class MissionMachine:
    """Serves one goal at a time; `status` and `outcome` report its progress and result.

    Args:
        parameters: of missions.
        mount: of the arm on the robot.
        home: place to return to; None = without navigation: the charger does not move and the target comes to it.
    """

    def __init__(self, parameters: MissionParameters, mount: BaseMount, home: Place | None) -> None:
        self._mount = mount
        self._home = home
        self._context = MissionContext(parameters)
        self._runner = Runner()
        self._cancel = self._interruptible = self._returns = self._charged = False
        self._started = 0.0
        self._notice = ""  # further information for the client after success
        self.outcome: MissionOutcome | None = None

    @property
    def parameters(self) -> MissionParameters:
        """Its parameters."""
        return self._context.parameters

    @property
    def status(self) -> MissionStatus:
        """Present state, for feedback and diagnostics."""
        return self._context.status

    @property
    def busy(self) -> bool:
        """Whether a goal is being served."""
        return self._runner.is_running

    def check(self, goal: MissionGoal) -> None:
        """Refuse a goal that can never be served as given, also while another one is.

        Raises:
            Rejected: it cannot.
        """
        check_id(goal.request_id)
        check_stops(goal.stop_energy, goal.stop_after)
        if self._home is not None and goal.electrodes is None:
            raise Rejected("the target has no frame_id: give the navigator's, such as map")

    def start(self, goal: MissionGoal, observation: MissionObservation, mount: BaseMount | None = None) -> None:
        """Begin a mission.

        Args:
            goal: the request.
            observation: the present one.
            mount: of the arm on the robot, if updated.

        Raises:
            Rejected: the goal cannot be served; nothing moved. Busy: another one is.
        """
        self.check(goal)
        if self.busy:
            raise Busy("another mission is under way; cancel it or wait for its result")
        self._mount = mount or self._mount
        self._context.begin(goal.request_id, observation)
        self._started = observation.time
        self._cancel = self._charged = False
        self._notice = ""
        self.outcome = None
        self._runner.start(self._mission(goal))

    def tune(self, parameters: MissionParameters, home: Place | None) -> str:
        """Use other parameters from the next goal on; return why not if that is refused."""
        if self.busy:
            return "a goal is running: cancel it or wait for its result, then set the parameters"
        self._context.parameters, self._home = parameters, home
        return ""

    def cancel(self) -> None:
        """End the goal with CANCELED, undocked and returned; during the return, the robot stops where it is."""
        self._cancel = True

    def step(self, observation: MissionObservation) -> MissionCommand:
        """Advance by one tick and return what to do."""
        self._context.observe(observation)
        if self.busy:
            self.status.elapsed = observation.time - self._started
            self._runner.step(self._problem())
        return self._context.command()

    def emergency(self) -> MissionCommand:
        """Return the command that cancels everything, and forget the goal: for a shell that must end."""
        self._runner.stop()
        self._context.drop()
        return self._context.command()

    def ended_by(self, error: DockingError, time: float) -> MissionOutcome:
        """Return the outcome of the goal that an emergency interrupted and `error` ends at `time`."""
        return MissionOutcome(False, error.code, str(error), self._may_retry(error), time - self._started)

    def _may_retry(self, error: DockingError) -> bool:
        return error.retriable and not self._charged  # a charged target needs no second mission

    def _problem(self) -> DockingError | None:
        """Return the reason to interrupt the script now, if any."""
        time, stage = self._context.time, self.status.stage
        if self._cancel and (self._interruptible or self._returns):
            self._cancel = False
            return Canceled("cancelled by the client")
        if self._interruptible and time > self._started + self.parameters.mission_timeout:
            return PhaseTimeout("the mission took longer than mission_timeout")
        if time > self._context.deadline:
            return PhaseTimeout(f"{stage.name} took longer than {self._context.limit}")
        return None

    def _mission(self, goal: MissionGoal) -> Script[None]:
        """Run the mission; however it ends, take the final steps and keep the first error."""
        first: DockingError | None = None
        message, returned = "", False
        self._interruptible = True
        try:
            message = yield from self._charge_target(goal)
        except DockingError as error:
            first, message = error, str(error)
        finally:
            self._interruptible = False
        self._charged = first is None
        self._report(first)
        try:
            yield from self._context.call_off()
            if self._context.touched:
                yield from self._context.undock()
            if self._cancel:
                self._cancel = False
                first = first or Canceled("cancelled by the client")
            self._returns = True
            returned = yield from self._return()
        except DockingError as error:
            self._returns = False  # waiting for the end of cancelled requests must not be interrupted
            message = f"{message}; then {error}"
            first = first or error
            yield from self._context.call_off()
        self._returns = False
        self._report(first)
        retriable, status = first is not None and self._may_retry(first), self.status
        self.outcome = MissionOutcome(
            first is None, status.code, message, retriable, status.elapsed, notice=self._notice, returned=returned
        )

    def _report(self, error: DockingError | None) -> None:
        self.status.code, self.status.message = (Code.NONE, "") if error is None else (error.code, str(error))

    def _charge_target(self, goal: MissionGoal) -> Script[str]:
        """Do the mission and return the success message."""
        context, parameters = self._context, self.parameters
        yield NEXT  # so that WAIT is also reported
        yield from context.wait_for_nodes([task for task in Task if task is not Task.DRIVE or self._home is not None])
        wish, redockings = goal, 0
        electrodes = goal.electrodes if self._home is not None else None
        distance = parameters.view_distance
        if electrodes is not None:
            context.enter(Stage.DRIVE, parameters.drive_timeout)
            yield from context.drive(self._mount.before(electrodes, distance))
        while True:
            seen = yield from self._search(electrodes, distance)
            electrodes, distance = self._placed(seen, electrodes), DOCK_DISTANCE
            better = self._better(electrodes, parameters.stand_tolerance, parameters.stand_turn_tolerance)
            if better is None:
                reply = yield from context.dock(wish)
                if reply.end is End.DONE and reply.unmeasured:
                    self._notice = reply.message or "docked; the charge is not measured"
                    return self._notice
                if reply.end is End.DONE:
                    return f"charged: {reply.message}" if reply.message else "charged"
                rest = self._rest(goal, reply)
                if rest is not None and redockings < _REDOCKINGS:
                    wish, redockings = rest, redockings + 1
                    self._report(dock_failure(reply))  # until the mission ends
                    yield from context.undock()
                    continue
                if reply.code not in _MENDED_BY_A_MOVE or reply.suggested is None:
                    raise dock_failure(reply)
                electrodes = self._suggested(reply.suggested, electrodes)
                # Another pose would not help: only the height is wrong, the turn is too small, or all moves are used.
                better = self._better(electrodes, GAIN_MIN, GAIN_TURN_MIN)
                if better is None:
                    raise dock_failure(reply)
                yield from context.undock()
            context.enter(Stage.DRIVE, parameters.drive_timeout)
            self.status.moves += 1
            yield from context.drive(better, precise=True)

    def _rest(self, goal: MissionGoal, reply: TaskReply) -> MissionGoal | None:
        """Return what is left to charge after a failure that may pass, if current had flowed; else None."""
        passes = reply.end is End.FAILED and reply.retriable and reply.code is not Code.CANCELED
        if self.status.stage is not Stage.CHARGE or not passes:
            return None
        energy, after = goal.stop_energy - reply.energy, goal.stop_after - self._context.charge_time
        if (goal.stop_energy and not energy > 0.0) or (goal.stop_after and not after > 0.0):  # also NaN
            return None
        return replace(goal, stop_energy=goal.stop_energy and energy, stop_after=goal.stop_after and after)

    def _search(self, electrodes: Place | None, distance: float) -> Script[ElectrodePose]:
        """Look for the electrodes from place to place, and return the detection."""
        context, parameters = self._context, self.parameters
        # Without navigation look again until time is up: the target may still be on its way.
        end = context.time + parameters.search_timeout
        context.enter(Stage.SEARCH, math.inf if electrodes is None else parameters.search_timeout)
        places = [None] if electrodes is None else list(views(electrodes, distance, self._mount, parameters))
        for index, place in enumerate(places):
            if index and place is not None:  # the first view is from the present place
                yield from context.drive(place, precise=True)
            while True:
                self.status.views += 1
                reply = yield from context.look()
                if reply.electrodes is not None:
                    return reply.electrodes
                if electrodes is not None or context.time >= end:
                    break
                yield from context.wait(_LOOK_PAUSE)
        raise ElectrodesNotFound(
            f"no electrodes were found in {self.status.views} detections; the last one reported: {reply.message}. "
            "Check that the target is at the given place and faces the given way"
        )

    def _placed(self, seen: ElectrodePose, electrodes: Place | None) -> Place | None:
        """Return detected electrodes on the ground, facing as detected if that is sure, else as given."""
        here = self.status.place
        if electrodes is None or here is None:
            return None
        facing = electrodes.yaw
        if math.isfinite(seen.yaw) and seen.yaw_stddev <= FACING_STDDEV_MAX:
            facing = self._mount.faced(here, seen.yaw, seen.pitch if math.isfinite(seen.pitch) else 0.0)
        return self._mount.seen_from(here, seen.position, facing)

    def _suggested(self, base: BasePose, electrodes: Place | None) -> Place | None:
        """Return the electrodes on the ground that charger_base would face squarely from a suggested pose."""
        here = self.status.place
        if electrodes is None or here is None:
            return None
        facing = self._mount.faced(here, base.yaw) if base.yaw else electrodes.yaw
        return self._mount.seen_from(here, base.electrodes, facing)

    def _better(self, electrodes: Place | None, distance: float, turn: float) -> Place | None:
        """Return a better place to dock from, if a move is allowed and the error exceeds these limits (m, rad)."""
        here = self.status.place
        if electrodes is None or here is None or self.status.moves >= self.parameters.stands_max:
            return None
        right = self._mount.before(electrodes, DOCK_DISTANCE)
        return right if here.distance(right) > distance or here.turn(right) > turn else None

    def _return(self) -> Script[bool]:
        """Drive home if the robot was driven; return whether it is at home."""
        if self._home is None:
            return True
        if not self._context.left:
            return False
        self._context.enter(Stage.RETURN, self.parameters.drive_timeout)
        yield from self._context.drive(self._home)
        return True
