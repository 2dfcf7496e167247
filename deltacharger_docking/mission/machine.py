# SPDX-License-Identifier: Apache-2.0
"""The mission state machine: the paper's strategy of operation.

Wait until all needed nodes answer, drive to the target, look for its electrodes, move the robot if they are out of
reach or askew, dock, charge, undock, return. `step` takes an observation and returns a command; it reads no clock,
opens no port and never blocks. However the mission ends, the final steps are the same: cancel open requests, undock,
return.
"""

import math

from deltacharger_core import machine, script
from deltacharger_docking import codes, goals
from deltacharger_docking.mission import dialogue
from deltacharger_docking.mission.parameters import MissionParameters
from deltacharger_docking.mission.places import BaseMount, Place, views
from deltacharger_docking.observation import ElectrodePose
from deltacharger_kinematics.geometry import Vector

WAIT_TIMEOUT = 10.0  # s until all needed nodes answer
SEARCH_TIMEOUT = 180.0  # s for one search
LOOK_TIMEOUT = 3.0  # s for one detection
DOCK_TIMEOUT = 660.0  # s until docking rests on the target: longer than its own goal_timeout may be
UNDOCK_TIMEOUT = 60.0  # s for one attempt
CANCEL_TIMEOUT = 30.0  # s for cancelled requests to end
UNDOCK_ATTEMPTS = 2  # a failure strands the robot: it must not be driven before
MOVES_MAX = 3  # to a better place for docking
_OFF, _TURNED = 0.03, 0.05  # m, rad from the right place for docking, beyond which the robot moves before it docks
GAIN_MIN, GAIN_TURN_MIN = 0.005, 0.02  # m, rad; a suggested move below both is not driven
FACING_STDDEV_MAX = math.radians(2.0)  # of a detected yaw; above it the given facing is used
_MENDED_BY_A_MOVE = (codes.Code.UNREACHABLE, codes.Code.LEANING)
_NEAR = 0.5  # m from the goal within which the navigator's last place is used
_ANSWER = 2.0  # s beyond its search time in which the detector may answer
_UNDOCK_PAUSE, _LOOK_PAUSE = 1.0, 0.5  # s between two attempts; between two detections from one place
_STATE_DELAY = 2.0  # s by which docking_state may arrive after a result


class NotServed(codes.Rejected, retriable=True):
    """A node that a mission needs is not available. Example: Nav2 has not been activated yet."""


class NavigationFailed(codes.Unreachable, retriable=True):
    """The navigator failed. Example: the way is blocked. `electrodes` is None: no other place is suggested."""


class DockFailed(codes.DockingError):
    """Docking or undocking failed; `code` and `retriable` are those of its result."""

    def __init__(self, reply: dialogue.TaskReply, consequence: str) -> None:
        self.code, self.retriable = reply.code or codes.Code.INTERNAL, reply.retriable
        super().__init__(reply.message + consequence)


class MissionMachine:
    """Serves one goal at a time.

    Args:
        parameters: of missions.
        mount: of the arm on the robot.
        home: place to return to; None = without navigation: the charger does not move and the target comes to it.

    Attributes:
        status: progress.
        outcome: result of the last goal; the shell takes it and sets None.
    """

    def __init__(self, parameters: MissionParameters, mount: BaseMount, home: Place | None) -> None:
        self.parameters, self._mount, self._home = parameters, mount, home
        self._runner = script.Runner()
        self._calls: script.Calls[dialogue.TaskReply] = script.Calls()
        self._requests: list[dialogue.TaskRequest] = []
        self._cancels: list[int] = []
        self._interruptible = self._returns = False
        self.outcome: dialogue.MissionOutcome | None = None
        self._reset("", dialogue.MissionObservation(0.0))

    def _reset(self, request_id: str, observation: dialogue.MissionObservation) -> None:
        """Forget the last mission; the robot's place is unknown until it drives."""
        self._observation, self._started = observation, observation.time
        self.status = dialogue.MissionStatus(request_id=request_id)
        self._touched = False  # a Dock goal was sent and no undocking has succeeded since: the robot must not move
        self._left = False  # the robot was driven, so it must return
        self._cancel = self._charged = False
        self._notice = ""  # further information for the client after success
        self._deadline, self._limit = math.inf, math.inf  # of the stage: s, and how long it may last
        self._calls.forget()

    @property
    def busy(self) -> bool:
        """Whether a goal is being served."""
        return self._runner.is_running

    @property
    def _time(self) -> float:
        return self._observation.time

    def check(self, goal: dialogue.MissionGoal) -> None:
        """Refuse a goal that can never be served as given, also while another one is.

        Raises:
            Rejected: it cannot.
        """
        goals.check_id(goal.request_id)
        goals.check_stops(goal.stop_energy, goal.stop_after)
        if self._home is not None and goal.electrodes is None:
            raise codes.Rejected("the target has no frame_id: give the navigator's, such as map")

    def start(
        self, goal: dialogue.MissionGoal, observation: dialogue.MissionObservation, mount: BaseMount | None = None
    ) -> None:
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
            running = self.status.request_id
            raise codes.Busy(f"another mission is under way (request_id '{running}'): cancel it, or wait")
        self._mount = mount or self._mount
        self._reset(goal.request_id, observation)
        self.outcome = None
        self._runner.start(self._mission(goal))

    def cancel(self) -> None:
        """End the goal with CANCELED, undocked and returned; during the return, the robot stops where it is."""
        self._cancel = True

    def step(self, observation: dialogue.MissionObservation) -> dialogue.MissionCommand:
        """Advance by one tick and return what to do."""
        self._observation = observation
        self._calls.receive(observation.replies)
        if self.busy:
            self.status.elapsed = observation.time - self._started
            self._runner.step(self._problem())
        return self._command()

    def emergency(self) -> dialogue.MissionCommand:
        """Return the command that cancels everything, and forget the goal: for a shell that must end."""
        self._runner.stop()
        self._drop()
        return self._command()

    def ended_by(self, error: codes.DockingError, time: float) -> dialogue.MissionOutcome:
        """Return the outcome of the goal that an emergency interrupted and `error` ends at `time`."""
        return dialogue.MissionOutcome(False, error.code, str(error), self._may_retry(error), time - self._started)

    def _command(self) -> dialogue.MissionCommand:
        command = dialogue.MissionCommand(tuple(self._requests), tuple(self._cancels))
        self._requests, self._cancels = [], []
        return command

    def _may_retry(self, error: codes.DockingError) -> bool:
        return error.retriable and not self._charged  # a charged target needs no second mission

    def _problem(self) -> codes.DockingError | None:
        """Return the reason to interrupt the script now, if any."""
        if self._cancel and (self._interruptible or self._returns):
            self._cancel = False
            return codes.Canceled("cancelled by the client")
        if self._time > self._deadline:
            return codes.PhaseTimeout(f"{self.status.stage.name} took longer than {self._limit:g} s")
        return None

    # The mission.

    def _mission(self, goal: dialogue.MissionGoal) -> script.Script[None]:
        """Run the mission; however it ends, take the final steps and keep the first error."""
        first: codes.DockingError | None = None
        message, returned = "", False
        self._interruptible = True
        try:
            message = yield from self._charge_target(goal)
        except codes.DockingError as error:
            first, message = error, str(error)
        finally:
            self._interruptible = False
        self._charged = first is None
        self._report(first)
        try:
            yield from self._call_off()
            if self._touched:
                yield from self._undock()
            if self._cancel:
                self._cancel = False
                first = first or codes.Canceled("cancelled by the client")
            self._returns = True
            returned = yield from self._return()
        except codes.DockingError as error:
            self._returns = False  # waiting for the end of cancelled requests must not be interrupted
            message = f"{message}; then {error}"
            first = first or error
            yield from self._call_off()
        self._returns = False
        self._report(first)
        retriable, status = first is not None and self._may_retry(first), self.status
        self.outcome = dialogue.MissionOutcome(
            first is None, status.code, message, retriable, status.elapsed, notice=self._notice, returned=returned
        )

    def _report(self, error: codes.DockingError | None) -> None:
        self.status.code, self.status.message = (codes.Code.NONE, "") if error is None else (error.code, str(error))

    def _charge_target(self, goal: dialogue.MissionGoal) -> script.Script[str]:
        """Do the mission and return the success message."""
        yield script.NEXT  # so that WAIT is also reported
        yield from self._wait_for_nodes()
        electrodes = goal.electrodes if self._home is not None else None
        distance = self.parameters.view_distance
        if electrodes is not None:
            self._enter(dialogue.Stage.DRIVE, self.parameters.drive_timeout)
            yield from self._drive(self._mount.before(electrodes, distance))
        while True:
            seen = yield from self._search(electrodes, distance)
            electrodes, distance = self._placed(seen, electrodes), machine.DOCK_DISTANCE
            better = self._better(electrodes, _OFF, _TURNED)
            if better is None:
                reply = yield from self._dock(goal)
                if reply.end is dialogue.End.DONE:
                    self._notice = reply.message  # such as that nothing measures the charge
                    return reply.message or "charged"
                if reply.code not in _MENDED_BY_A_MOVE or reply.suggested is None:
                    raise _dock_failure(reply)
                base = reply.suggested
                electrodes = self._on_ground(base.electrodes, (base.yaw, 0.0) if base.yaw else None, electrodes)
                # Another pose would not help: only the height is wrong, the turn is too small, or all moves are used.
                better = self._better(electrodes, GAIN_MIN, GAIN_TURN_MIN)
                if better is None:
                    raise _dock_failure(reply)
                yield from self._undock()
            self._enter(dialogue.Stage.DRIVE, self.parameters.drive_timeout)
            self.status.moves += 1
            yield from self._drive(better, precise=True)

    def _search(self, electrodes: Place | None, distance: float) -> script.Script[ElectrodePose]:
        """Look for the electrodes from place to place, and return the detection."""
        # Without navigation look again until time is up: the target may still be on its way.
        end = self._time + SEARCH_TIMEOUT
        self._enter(dialogue.Stage.SEARCH, math.inf if electrodes is None else SEARCH_TIMEOUT)
        places = [None] if electrodes is None else list(views(electrodes, distance, self._mount))
        for index, place in enumerate(places):
            if index and place is not None:  # the first view is from the present place
                yield from self._drive(place, precise=True)
            while True:
                self.status.views += 1
                reply = yield from self._look()
                if reply.electrodes is not None:
                    return reply.electrodes
                if electrodes is not None or self._time >= end:
                    break
                yield from self._wait(_LOOK_PAUSE)
        raise codes.ElectrodesNotFound(
            f"no electrodes in {self.status.views} detections; the last one: {reply.message}. Check the target's place"
        )

    def _placed(self, seen: ElectrodePose, electrodes: Place | None) -> Place | None:
        """Return detected electrodes on the ground, facing as detected if that is sure, else as given."""
        sure = math.isfinite(seen.yaw) and seen.yaw_stddev <= FACING_STDDEV_MAX
        lean = (seen.yaw, seen.pitch if math.isfinite(seen.pitch) else 0.0) if sure else None
        return self._on_ground(seen.position, lean, electrodes)

    def _on_ground(self, point: Vector, lean: tuple[float, float] | None, given: Place | None) -> Place | None:
        """Return electrodes at `point` (m, charger_base); they face as their lean (rad) shows, without one as given."""
        here = self.status.place
        if given is None or here is None:
            return None
        return self._mount.seen_from(here, point, given.yaw if lean is None else self._mount.faced(here, *lean))

    def _better(self, electrodes: Place | None, distance: float, turn: float) -> Place | None:
        """Return a better place to dock from, if a move is allowed and the error exceeds these limits (m, rad)."""
        here = self.status.place
        if electrodes is None or here is None or self.status.moves >= MOVES_MAX:
            return None
        right = self._mount.before(electrodes, machine.DOCK_DISTANCE)
        return right if here.distance(right) > distance or here.turn(right) > turn else None

    def _return(self) -> script.Script[bool]:
        """Drive home if the robot was driven; return whether it is at home."""
        if self._home is None:
            return True
        if not self._left:
            return False
        self._enter(dialogue.Stage.RETURN, self.parameters.drive_timeout)
        yield from self._drive(self._home)
        return True

    # Its requests to other nodes.

    def _enter(self, stage: dialogue.Stage, limit: float) -> None:
        """Begin a stage that may last `limit` seconds."""
        self.status.stage = stage
        self._deadline, self._limit = self._time + limit, limit

    def _wait(self, seconds: float) -> script.Script[None]:
        end = self._time + seconds
        while self._time < end:
            yield script.NEXT

    def _drop(self) -> None:
        """Cancel all open requests."""
        self._requests = []
        self._cancels.extend(sorted(self._calls.open))

    def _call_off(self) -> script.Script[None]:
        """Cancel all open requests and wait for their end, at most `CANCEL_TIMEOUT`."""
        self._deadline = math.inf
        self._drop()
        end = self._time + CANCEL_TIMEOUT
        while self._calls.open and self._time <= end:
            yield script.NEXT
        self._calls.forget()

    def _send(self, task: dialogue.Task, **details: Place | dialogue.MissionGoal | bool | float | None) -> int:
        """Send a request with details named as in `TaskRequest`, and return its number."""
        request = dialogue.TaskRequest(self._calls.number(), task, **details)  # type: ignore[arg-type]
        self._requests.append(request)
        return request.number

    def _ask(self, task: dialogue.Task, **details: Place | bool) -> script.Script[dialogue.TaskReply]:
        """Send a request and wait for its reply; the stage's limit ends the wait."""
        number = self._send(task, **details)
        while (reply := self._calls.take_reply(number)) is None:
            yield script.NEXT
        return reply

    def _wait_for_nodes(self) -> script.Script[None]:
        """Wait until all needed nodes answer; docking_node must then be free.

        Raises:
            NotServed: a node is missing after `WAIT_TIMEOUT`.
            Busy: the charger is docked or busy.
        """
        needed = [task for task in dialogue.Task if task is not dialogue.Task.DRIVE or self._home is not None]
        end = self._time + WAIT_TIMEOUT
        while True:
            missing = [task for task in needed if task not in self._observation.served]
            docking = self._observation.docking
            if not missing and docking is not None:
                break
            if self._time > end:
                name = missing[0].value if missing else "docking_state"
                raise NotServed(f"no node serves {name}: start (or activate) it, as this user")
            yield script.NEXT
        if not docking.free:
            busy = f"the charger is busy ({docking.state.name}) or docked: undock it, then send the goal again"
            raise codes.Busy(busy)

    def _look(self) -> script.Script[dialogue.TaskReply]:
        """Request one detection, for `LOOK_TIMEOUT`.

        Raises:
            ElectrodesNotFound: the detector does not answer, so other views would not help.
        """
        number = self._send(dialogue.Task.DETECT, timeout=LOOK_TIMEOUT)
        end = self._time + LOOK_TIMEOUT + _ANSWER
        while (reply := self._calls.take_reply(number)) is None and self._time <= end:
            yield script.NEXT
        if reply is None or reply.end is dialogue.End.LOST:
            raise codes.ElectrodesNotFound(
                "detect_electrodes does not answer: check the log of electrode_detector_node"
            )
        return reply

    def _dock(self, goal: dialogue.MissionGoal) -> script.Script[dialogue.TaskReply]:
        """Dock and charge until docking ends its goal; the stage becomes CHARGE when docking reports current.

        If it rests on the target without reporting current (power: none), the stage remains, with the limit of CHARGE.
        """
        self._enter(dialogue.Stage.DOCK, DOCK_TIMEOUT)
        number = self._send(dialogue.Task.DOCK, goal=goal)
        self._touched = True
        rests = False
        while (reply := self._calls.take_reply(number)) is None:
            docking = self._observation.docking
            if not rests and docking is not None and (docking.charging or docking.rests):
                self._enter(
                    dialogue.Stage.CHARGE if docking.charging else dialogue.Stage.DOCK, self.parameters.charge_timeout
                )
                rests = True
            yield script.NEXT
        return reply

    def _undock(self) -> script.Script[None]:
        """Undock, in several attempts.

        Raises:
            DockFailed, PhaseTimeout: undocking failed.
        """
        for left in reversed(range(UNDOCK_ATTEMPTS)):
            self._enter(dialogue.Stage.UNDOCK, UNDOCK_TIMEOUT)
            reply = yield from self._ask(dialogue.Task.UNDOCK)
            if reply.end is dialogue.End.DONE:
                self._touched = False
                return
            if not left:
                raise _dock_failure(reply, "; the robot stays where it is, because it may still hold the target")
            yield from self._wait(_UNDOCK_PAUSE)

    def _drive(self, place: Place, precise: bool = False) -> script.Script[None]:
        """Let the navigator drive to `place` and store where it arrived; never while robot and target may be connected.

        Raises:
            Busy: docking_node is not free.
            DockingError: the navigator did not arrive.
        """
        end = self._time + _STATE_DELAY
        while self._touched or self._observation.docking is None or not self._observation.docking.free:
            if self._time > end:
                raise codes.Busy(
                    "docking_state reports that the charger is docked or busy, so the robot was not driven"
                )
            yield script.NEXT
        self._left = True
        self.status.place = None
        reply = yield from self._ask(dialogue.Task.DRIVE, place=place, precise=precise)
        if reply.end is not dialogue.End.DONE:
            raise _drive_failure(reply, place)
        reported = reply.place
        known = reported is not None and reported.frame == place.frame and reported.distance(place) <= _NEAR
        self.status.place = reported if known else place


def _dock_failure(reply: dialogue.TaskReply, consequence: str = "") -> codes.DockingError:
    """Return the error of a docking or undocking that failed."""
    if reply.end is dialogue.End.LOST:
        return codes.PhaseTimeout("docking_node disappeared; start it again and check its log" + consequence)
    return DockFailed(reply, consequence)


def _drive_failure(reply: dialogue.TaskReply, place: Place) -> codes.DockingError:
    where, reason = f"({place.x:.2f}, {place.y:.2f}) of {place.frame}", f": {reply.message}" if reply.message else ""
    if reply.end is dialogue.End.REFUSED:
        return codes.Rejected(
            f"the navigator refused to drive to {where}: check that it is active and knows this frame"
        )
    if reply.end is dialogue.End.LOST:
        return codes.PhaseTimeout("the navigator disappeared while driving; check its log and localize the robot")
    return NavigationFailed(f"the navigator did not reach {where}{reason}; clear the way or correct the place")
