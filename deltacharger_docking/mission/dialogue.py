# SPDX-License-Identifier: Apache-2.0
"""Inputs and outputs of the mission's state machine in each tick."""

from dataclasses import dataclass
from enum import Enum, IntEnum

from deltacharger_docking import codes, observation
from deltacharger_docking.mission.places import Place


class Stage(IntEnum):
    """Stages of a mission; the numbers are those of ChargeRobot.action."""

    WAIT = 0
    DRIVE = 1
    SEARCH = 2
    DOCK = 3
    CHARGE = 4
    UNDOCK = 5
    RETURN = 6


class Task(Enum):
    """Requests to other nodes; each is answered by a `TaskReply`."""

    DRIVE = "navigate_to_pose"
    DETECT = "detect_electrodes"
    DOCK = "dock"
    UNDOCK = "undock"


@dataclass(frozen=True)
class MissionGoal:
    """A client's request: electrodes expected at `electrodes` (None without navigation), and stop conditions.

    `stop_energy` in J and `stop_after` in s, 0 = none. `target_profile` names the target's, '' = the first one.
    """

    electrodes: Place | None
    stop_energy: float = 0.0
    stop_after: float = 0.0
    request_id: str = ""
    target_profile: str = ""


@dataclass(frozen=True)
class TaskRequest:
    """One request to another node; the reply repeats its `number`.

    `place` and `precise` (a small move near the target) belong to DRIVE, `timeout` (s) to DETECT, `goal` to DOCK.
    """

    number: int
    task: Task
    place: Place | None = None
    precise: bool = False
    timeout: float = 0.0
    goal: MissionGoal | None = None


class End(Enum):
    """How a request ended."""

    DONE = "done"
    FAILED = "failed"
    REFUSED = "refused"
    CANCELED = "canceled"
    LOST = "lost"  # its server disappeared


@dataclass(frozen=True)
class TaskReply:
    """Answer to the request with this number.

    Attributes:
        code, retriable: of docking, if it failed.
        message: the reason and the remedy.
        place: last place of the base that the navigator reported, None = not reported.
        electrodes: as detected by the camera.
        suggested: better pose of charger_base, None = no other. Its yaw is 0 if the yaw of the faces is unknown.
    """

    number: int
    end: End
    code: codes.Code = codes.Code.NONE
    message: str = ""
    retriable: bool = False
    place: Place | None = None
    electrodes: observation.ElectrodePose | None = None
    suggested: observation.BasePose | None = None


@dataclass(frozen=True)
class DockingReport:
    """State of docking_node, from docking_state."""

    state: codes.State = codes.State.IDLE
    docked: bool = False
    charging: bool = False

    @property
    def free(self) -> bool:
        """Whether nothing connects the robot to a target, so that its base may move."""
        return self.state is codes.State.IDLE and not self.docked and not self.charging

    @property
    def rests(self) -> bool:
        """Whether the electrodes rest on the target and docking does not report charging."""
        return self.state is codes.State.IDLE and self.docked and not self.charging


@dataclass(frozen=True)
class MissionObservation:
    """Everything known at `time` (s, monotonic); `docking` None = docking_state was never received."""

    time: float
    served: frozenset[Task] = frozenset()
    docking: DockingReport | None = None
    replies: tuple[TaskReply, ...] = ()


@dataclass(frozen=True)
class MissionCommand:
    """What to do now: requests to send, and numbers of requests to cancel."""

    requests: tuple[TaskRequest, ...] = ()
    cancels: tuple[int, ...] = ()


@dataclass(frozen=True)
class MissionOutcome(observation.GoalOutcome):
    """Result of a mission; `returned`: the robot is at home and free of the target."""

    returned: bool = False


@dataclass
class MissionStatus:
    """The machine's state between commands."""

    stage: Stage = Stage.WAIT
    request_id: str = ""
    elapsed: float = 0.0
    views: int = 0
    moves: int = 0
    code: codes.Code = codes.Code.NONE
    message: str = ""
    place: Place | None = None
