# SPDX-License-Identifier: Apache-2.0
"""A world for missions in virtual time: a base on the ground, electrodes, and other nodes with scripted answers.

It checks at every tick for errors: a drive while the robot may be connected to its target, and two
requests at once.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from deltacharger_core.frames import Pose, composed, inverted, rotation
from deltacharger_docking import codes, observation
from deltacharger_docking.mission import dialogue, machine, places
from deltacharger_docking.mission.parameters import MissionParameters

TICK = 0.1  # s
FORWARD = (0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5)
HOME = places.Place(-3.0, 1.0, 0.5)
TARGET = places.Place(2.0, 1.0, 2.5)
REACH = 0.04  # m about the place where the arm docks

Answer = Callable[["World", dialogue.TaskRequest], tuple[float, dialogue.TaskReply] | None]
"""Duration of a request and its reply; None = there is never an answer, not even to a cancel."""


def on_ground(place: places.Place, height: float = 0.0) -> Pose:
    """Return the pose of a place on the map."""
    return place.x, place.y, height, 0.0, 0.0, math.sin(0.5 * place.yaw), math.cos(0.5 * place.yaw)


@dataclass(frozen=True)
class Truth:
    """True places: electrodes on the map at a height (m), and the error of the navigator's stops.

    The camera reports their lean with `lean_stddev` (rad); NaN = it reports none, though docking may find it.
    """

    electrodes: places.Place = TARGET
    height: float = 0.0
    miss: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount: Pose = FORWARD
    lean_stddev: float = math.nan


class World:
    """Steps a machine through a mission.

    Args:
        truth: true places.
        parameters: of the machine.
        drives: whether there is a navigator.
        answers: by task, in place of the default ones.
    """

    def __init__(
        self,
        truth: Truth | None = None,
        parameters: MissionParameters | None = None,
        drives: bool = True,
        answers: dict[dialogue.Task, Answer] | None = None,
    ) -> None:
        self.truth = truth or Truth()
        self.parameters = parameters or MissionParameters(home_x=HOME.x, home_y=HOME.y, home_yaw=HOME.yaw)
        self.machine = machine.MissionMachine(
            self.parameters, places.BaseMount(self.truth.mount), HOME if drives else None
        )
        self.time = 100.0
        self.base = places.Place(0.0, 0.0, 0.0)
        self.served = set(dialogue.Task) if drives else set(dialogue.Task) - {dialogue.Task.DRIVE}
        self.docking: dialogue.DockingReport | None = dialogue.DockingReport()
        self.attached = False
        self.requests: list[dialogue.TaskRequest] = []
        self.stages: list[dialogue.Stage] = []
        self.bases: list[places.Place] = []  # true place of the robot at each docking, and
        self.believed: list[places.Place | None] = []  # its place as known to the machine
        self.answers: dict[dialogue.Task, Answer] = {
            dialogue.Task.DRIVE: drive,
            dialogue.Task.DETECT: detect,
            dialogue.Task.DOCK: dock,
            dialogue.Task.UNDOCK: undock,
        } | (answers or {})
        self._due: list[tuple[float, dialogue.TaskRequest, dialogue.TaskReply]] = []

    def seen(self) -> observation.ElectrodePose:
        """True pose of the electrodes in charger_base, as the camera reports it."""
        truth = self.truth
        here = composed(on_ground(self.base), truth.mount)
        pose = composed(inverted(here), on_ground(truth.electrodes, truth.height))
        x, y, z = pose[:3]
        right, up, forward = (-row[0] for row in rotation(*pose[3:]))  # they face along x; their z axis points back
        yaw, pitch, stddev = math.atan2(right, forward), math.atan2(-up, forward), truth.lean_stddev
        return observation.ElectrodePose((x, y, z), 0.0, yaw=yaw, pitch=pitch, yaw_stddev=stddev, pitch_stddev=stddev)

    def run(
        self, goal: dialogue.MissionGoal | None = None, limit: float = 1e5, cancel_in: dialogue.Stage | None = None
    ) -> dialogue.MissionOutcome:
        """Serve a goal and return its outcome; `cancel_in`: cancel as soon as this stage begins."""
        self.machine.start(goal or dialogue.MissionGoal(TARGET), self._observe(()))
        end = self.time + limit
        while self.machine.outcome is None:
            assert self.time < end, f"no end after {limit} s in {self.machine.status}"
            self.step()
            if cancel_in is not None and self.stages[-1] is cancel_in:
                self.machine.cancel()
                cancel_in = None
        self.step()
        return self.machine.outcome

    def step(self) -> None:
        """Advance by one tick."""
        self.time += TICK
        due = [entry for entry in self._due if entry[0] <= self.time]
        self._due = [entry for entry in self._due if entry[0] > self.time]
        for _, request, reply in due:
            self._take_effect(request, reply)
        command = self.machine.step(self._observe(tuple(reply for _, _, reply in due)))
        if self.machine.busy or self.machine.outcome is not None:
            stage = self.machine.status.stage
            if not self.stages or self.stages[-1] is not stage:
                self.stages.append(stage)
        for number in command.cancels:
            self._cancel(number)
        for request in command.requests:
            self._take(request)

    def _observe(self, replies: tuple[dialogue.TaskReply, ...]) -> dialogue.MissionObservation:
        return dialogue.MissionObservation(self.time, frozenset(self.served), self.docking, replies)

    def _take(self, request: dialogue.TaskRequest) -> None:
        assert not self._due, "one request at a time"
        if request.task is dialogue.Task.DRIVE:
            assert not self.attached, "the robot is driven while the arm may hold its target"
            assert self.docking is not None
            assert self.docking.free, "the robot is driven while docking is at work"
        self.requests.append(request)
        if request.task is dialogue.Task.DOCK:
            self.bases.append(self.base)
            self.believed.append(self.machine.status.place)
        answer = self.answers[request.task](self, request)
        if answer is not None:
            self._due.append((self.time + answer[0], request, answer[1]))

    def _cancel(self, number: int) -> None:
        for index, (_, request, _) in enumerate(self._due):
            if request.number == number:
                reply = dialogue.TaskReply(number, dialogue.End.CANCELED, codes.Code.CANCELED, "cancelled", True)
                self._due[index] = (self.time + 0.3, request, reply)

    def _take_effect(self, request: dialogue.TaskRequest, reply: dialogue.TaskReply) -> None:
        """Change the world by the result of a request."""
        if request.task is dialogue.Task.DRIVE and reply.end is dialogue.End.DONE:
            assert request.place is not None
            self.base = request.place.at(*self.truth.miss)
        elif request.task is dialogue.Task.DOCK:
            holds = reply.end is dialogue.End.DONE or reply.code is codes.Code.STUCK
            self.attached = holds
            self.docking = dialogue.DockingReport(codes.State.IDLE, docked=reply.end is dialogue.End.DONE)
        elif request.task is dialogue.Task.UNDOCK and reply.end is dialogue.End.DONE:
            self.attached = False
            self.docking = dialogue.DockingReport()


def drive(world: World, request: dialogue.TaskRequest) -> tuple[float, dialogue.TaskReply]:
    """Arrive, and report the place."""
    assert request.place is not None
    return 5.0, dialogue.TaskReply(request.number, dialogue.End.DONE, place=request.place.at(*world.truth.miss))


def detect(world: World, request: dialogue.TaskRequest) -> tuple[float, dialogue.TaskReply]:
    """Detect electrodes in front of the camera, not too far aside."""
    seen = world.seen()
    x, y, z = seen.position
    if 0.02 < z < 0.8 and math.hypot(x, y) < 0.5 * (z + 0.12):
        known = seen if seen.yaw_stddev >= 0.0 else replace(seen, yaw=math.nan, pitch=math.nan)
        return 0.3, dialogue.TaskReply(request.number, dialogue.End.DONE, electrodes=known)
    return request.timeout, dialogue.TaskReply(
        request.number, dialogue.End.FAILED, message="no electrodes in the image"
    )


def dock(world: World, request: dialogue.TaskRequest) -> tuple[float, dialogue.TaskReply]:
    """Refuse electrodes out of reach; else dock, and charge for a while."""
    seen = world.seen().position
    if math.dist(seen, (0.0, 0.0, 0.08)) > REACH:
        where = observation.BasePose.before(seen)
        return 0.2, dialogue.TaskReply(
            request.number, dialogue.End.FAILED, codes.Code.UNREACHABLE, "out of reach", suggested=where
        )
    world.attached = True
    world.docking = dialogue.DockingReport(codes.State.CHARGING, docked=True, charging=True)
    return 100.0, dialogue.TaskReply(request.number, dialogue.End.DONE)


def squarely(limit: float, code: codes.Code = codes.Code.LEANING) -> Answer:
    """Return docking that refuses a yaw beyond `limit` (rad) with a code and a suggested base pose without it."""

    def answer(world: World, request: dialogue.TaskRequest) -> tuple[float, dialogue.TaskReply] | None:
        seen = world.seen()
        askew = ends(
            dialogue.End.FAILED, "askew", 0.2, code=code, suggested=observation.BasePose.before(seen.position, seen.yaw)
        )
        return (dock if abs(seen.yaw) <= limit else askew)(world, request)

    return answer


def undock(world: World, request: dialogue.TaskRequest) -> tuple[float, dialogue.TaskReply]:
    """Undock."""
    return 3.0, dialogue.TaskReply(request.number, dialogue.End.DONE)


def fails(code: codes.Code, retriable: bool = False, after: float = 1.0, charging: bool = False) -> Answer:
    """Return docking that fails with a code, after charging for a while if `charging`."""

    def answer(world: World, request: dialogue.TaskRequest) -> tuple[float, dialogue.TaskReply]:
        world.attached = request.task is dialogue.Task.DOCK or world.attached
        if request.task is dialogue.Task.DOCK:
            world.docking = dialogue.DockingReport(
                codes.State.CHARGING if charging else codes.State.CONTACT, docked=charging, charging=charging
            )
        return after, dialogue.TaskReply(
            request.number, dialogue.End.FAILED, code, f"it failed with {code.name}", retriable
        )

    return answer


def ends(end: dialogue.End, message: str = "", after: float = 1.0, **fields: Any) -> Answer:
    """Return a server whose requests end in this way after some seconds."""
    return lambda world, request: (after, dialogue.TaskReply(request.number, end, message=message, **fields))


def in_turn(*answers: Answer) -> Answer:
    """Return a server that answers with these in turn, the last one for ever."""
    left = list(answers)
    return lambda world, request: (left.pop(0) if len(left) > 1 else left[0])(world, request)


def silent(world: World, request: dialogue.TaskRequest) -> None:
    """Answer nothing."""
