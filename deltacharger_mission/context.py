# SPDX-License-Identifier: Apache-2.0
"""State that a mission's scripts share: the latest observation, this tick's requests, and calls to other nodes."""

from __future__ import annotations

import math

from deltacharger_core.script import NEXT, Calls, Script
from deltacharger_docking.codes import Busy, Code, DockingError, ElectrodesNotFound, PhaseTimeout, Rejected, Unreachable
from deltacharger_mission.dialogue import (
    End,
    MissionCommand,
    MissionGoal,
    MissionObservation,
    MissionStatus,
    Stage,
    Task,
    TaskReply,
    TaskRequest,
)
from deltacharger_mission.parameters import MissionParameters
from deltacharger_mission.places import Place

WAIT_TIMEOUT = 10.0  # s until all needed nodes answer
LOOK_TIMEOUT = 3.0  # s for one detection
UNDOCK_TIMEOUT = 60.0  # s for one attempt
CANCEL_TIMEOUT = 30.0  # s for cancelled requests to end
_NEAR = 0.5  # m from the goal within which the navigator's last place is used
_ANSWER = 2.0  # s beyond its search time in which the detector may answer
_UNDOCK_PAUSE = 1.0  # s between two attempts
_STATE_DELAY = 2.0  # s by which docking_state may arrive after a result
_LIMITS = {Stage.UNDOCK: f"{UNDOCK_TIMEOUT:g} s", Stage.RETURN: "drive_timeout"}
_REMEDIES = {
    Task.DRIVE: "no navigator answers navigate_to_pose: activate Nav2, as this user, or set navigation to none",
    Task.DETECT: "no node serves detect_electrodes: start electrode_detector_node and its camera",
    Task.DOCK: "no node answers dock: start docking_node as this user",
    Task.UNDOCK: "no node answers undock: start docking_node as this user",
}


class NotServed(Rejected, retriable=True):
    """A node that a mission needs is not available. Example: Nav2 has not been activated yet."""


class NavigationFailed(Unreachable, retriable=True):
    """The navigator failed. Example: the way is blocked. `electrodes` is None: no other place is suggested."""


class DockFailed(DockingError):
    """Docking or undocking failed; `code` and `retriable` are those of its result."""

    def __init__(self, reply: TaskReply, consequence: str) -> None:
        self.code, self.retriable = reply.code or Code.INTERNAL, reply.retriable
        super().__init__(reply.message + consequence)


class MissionContext:
    """State shared by the scripts. In each tick the machine calls `observe` before them and `command` after them.

    Attributes:
        touched: a Dock goal was sent and no undocking has succeeded since: the robot must not move.
        left: the robot was driven, so it must return.
        charge_time: time (s) that docking has reported current in this mission.
    """

    def __init__(self, parameters: MissionParameters) -> None:
        self.parameters = parameters
        self._calls: Calls[TaskReply] = Calls()
        self._requests: list[TaskRequest] = []
        self._cancels: list[int] = []
        self.begin("", MissionObservation(0.0))

    @property
    def time(self) -> float:
        """Now (s, the clock of the observations)."""
        return self.observation.time

    def begin(self, request_id: str, observation: MissionObservation) -> None:
        """Reset the state for a new mission; the robot's place is unknown until it drives."""
        self.observation = observation
        self.status = MissionStatus(request_id=request_id)
        self.touched = self.left = False
        self.charge_time = 0.0
        self.deadline, self.limit = math.inf, ""  # limit: the stage's parameter, or its seconds
        self._calls.forget()

    def observe(self, observation: MissionObservation) -> None:
        """Set the observation of this tick."""
        self.observation = observation
        self._calls.receive(observation.replies)

    def command(self) -> MissionCommand:
        """Return what was requested in this tick, and clear it."""
        command = MissionCommand(tuple(self._requests), tuple(self._cancels))
        self._requests, self._cancels = [], []
        return command

    def enter(self, stage: Stage, limit: float) -> None:
        """Begin a stage that may last `limit` seconds."""
        self.status.stage = stage
        self.deadline = self.time + limit
        self.limit = _LIMITS.get(stage, f"{stage.name.lower()}_timeout")

    def drop(self) -> None:
        """Cancel all open requests."""
        self._requests = []
        self._cancels.extend(sorted(self._calls.open))

    def call_off(self) -> Script[None]:
        """Cancel all open requests and wait for their end, at most `CANCEL_TIMEOUT`."""
        self.deadline = math.inf
        self.drop()
        end = self.time + CANCEL_TIMEOUT
        while self._calls.open and self.time <= end:
            yield NEXT
        self._calls.forget()

    def wait(self, seconds: float) -> Script[None]:
        """Let `seconds` pass."""
        end = self.time + seconds
        while self.time < end:
            yield NEXT

    def send(self, task: Task, **details: Place | MissionGoal | bool | float | None) -> int:
        """Send a request with details named as in `TaskRequest`, and return its number."""
        request = TaskRequest(self._calls.number(), task, **details)  # type: ignore[arg-type]
        self._requests.append(request)
        return request.number

    def answer(self, number: int) -> Script[TaskReply]:
        """Wait for a reply; the stage's limit ends the wait."""
        while (reply := self._calls.take(number)) is None:
            yield NEXT
        return reply

    def wait_for_nodes(self, tasks: list[Task]) -> Script[None]:
        """Wait until all needed nodes answer; docking_node must then be free.

        Raises:
            NotServed: a node is missing after `WAIT_TIMEOUT`.
            Busy: the charger is docked or busy.
        """
        end = self.time + WAIT_TIMEOUT
        while True:
            missing = [task for task in tasks if task not in self.observation.served]
            docking = self.observation.docking
            if not missing and docking is not None:
                break
            if self.time > end:
                raise NotServed(_REMEDIES[missing[0]] if missing else "docking_state is missing: start docking_node")
            yield NEXT
        if not docking.free:
            raise Busy(f"the charger is busy ({docking.state.name}) or docked: undock it, then send the goal again")

    def look(self) -> Script[TaskReply]:
        """Request one detection, for `LOOK_TIMEOUT`.

        Raises:
            ElectrodesNotFound: the detector does not answer, so other views would not help.
        """
        number = self.send(Task.DETECT, timeout=LOOK_TIMEOUT)
        end = self.time + LOOK_TIMEOUT + _ANSWER
        while (reply := self._calls.take(number)) is None:
            if self.time > end:
                raise ElectrodesNotFound("detect_electrodes does not answer: check the log of electrode_detector_node")
            yield NEXT
        if reply.end is End.LOST:
            raise ElectrodesNotFound("detect_electrodes disappeared: check the log of electrode_detector_node")
        return reply

    def dock(self, goal: MissionGoal) -> Script[TaskReply]:
        """Dock and charge until docking ends its goal; the stage becomes CHARGE when docking reports current.

        If it rests on the target without reporting current (power: none), the stage remains, with the limit of CHARGE.
        """
        self.enter(Stage.DOCK, self.parameters.dock_timeout)
        number = self.send(Task.DOCK, goal=goal)
        self.touched = True
        began = math.inf
        while (reply := self._calls.take(number)) is None:
            docking = self.observation.docking
            if self.limit == "dock_timeout" and docking is not None and (docking.charging or docking.rests):
                self.enter(Stage.CHARGE if docking.charging else Stage.DOCK, self.parameters.charge_timeout)
                self.limit = "charge_timeout"
                began = self.time
            yield NEXT
        if self.status.stage is Stage.CHARGE:
            self.charge_time += self.time - began
        return reply

    def undock(self) -> Script[None]:
        """Undock, with repeated attempts, since a failure strands the robot: it must not be driven before.

        Raises:
            DockFailed, PhaseTimeout: undocking failed.
        """
        for left in reversed(range(self.parameters.undock_attempts)):
            self.enter(Stage.UNDOCK, UNDOCK_TIMEOUT)
            reply = yield from self.answer(self.send(Task.UNDOCK))
            if reply.end is End.DONE:
                self.touched = False
                return
            if not left:
                raise dock_failure(reply, "; the robot stays where it is, because it may still hold the target")
            yield from self.wait(_UNDOCK_PAUSE)

    def drive(self, place: Place, precise: bool = False) -> Script[None]:
        """Let the navigator drive to `place` and store where it arrived; never while robot and target may be connected.

        Raises:
            Busy: docking_node is not free.
            DockingError: the navigator did not arrive.
        """
        end = self.time + _STATE_DELAY
        while self.touched or self.observation.docking is None or not self.observation.docking.free:
            if self.time > end:
                raise Busy("docking_state reports that the charger is docked or busy, so the robot was not driven")
            yield NEXT
        self.left = True
        self.status.place = None
        reply = yield from self.answer(self.send(Task.DRIVE, place=place, precise=precise))
        if reply.end is not End.DONE:
            raise _drive_failure(reply, place)
        reported = reply.place
        known = reported is not None and reported.frame == place.frame and reported.distance(place) <= _NEAR
        self.status.place = reported if known else place


def dock_failure(reply: TaskReply, consequence: str = "") -> DockingError:
    """Return the error of a docking or undocking that failed."""
    if reply.end is End.LOST:
        return PhaseTimeout("docking_node disappeared; start it again and check its log" + consequence)
    return DockFailed(reply, consequence)


def _drive_failure(reply: TaskReply, place: Place) -> DockingError:
    where = f"({place.x:.2f}, {place.y:.2f}) of {place.frame}"
    if reply.end is End.REFUSED:
        return Rejected(f"the navigator refused to drive to {where}: check that it is active and knows this frame")
    if reply.end is End.LOST:
        return PhaseTimeout("the navigator disappeared while driving; check its log and localize the robot")
    reason = f": {reply.message}" if reply.message else ""
    if reply.end is End.CANCELED:
        return NavigationFailed(f"another client cancelled the drive to {where}{reason}")
    return NavigationFailed(f"the navigator did not reach {where}{reason}; clear the way or correct the place")
