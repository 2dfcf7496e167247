# SPDX-License-Identifier: Apache-2.0
"""What the mission's state machine sees and what it says, once per tick."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum

from deltacharger_docking.codes import Code, State
from deltacharger_docking.observation import BasePose, ElectrodePose, GoalOutcome
from deltacharger_mission.places import Place


class Stage(IntEnum):
    """What the mission is at; the numbers are those of ChargeRobot.action."""

    WAIT = 0
    DRIVE = 1
    SEARCH = 2
    DOCK = 3
    CHARGE = 4
    UNDOCK = 5
    RETURN = 6


class Task(Enum):
    """What the machine may ask others to do; each request is answered by a `TaskReply`."""

    DRIVE = "navigate_to_pose"
    DETECT = "detect_electrodes"
    DOCK = "dock"
    UNDOCK = "undock"


@dataclass(frozen=True)
class MissionGoal:
    """What a client wants: electrodes that should be at `electrodes` (None where nobody drives), and stop conditions.

    `stop_energy` in J and `stop_after` in s, 0 = none.
    """

    electrodes: Place | None
    stop_energy: float = 0.0
    stop_after: float = 0.0
    request_id: str = ""


@dataclass(frozen=True)
class TaskRequest:
    """One errand for somebody else; `number` comes back in the reply.

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
    LOST = "lost"  # who served it went away


@dataclass(frozen=True)
class TaskReply:
    """Answer to the request of the same number.

    Attributes:
        code, retriable: of docking, where it failed.
        message: why, and what to do.
        place: where the navigator last said the base was, None = it did not say.
        electrodes: as the camera saw them.
        suggested: where charger_base should stand, None = nowhere else. A yaw of 0 tells no turn: it may be unknown.
        unmeasured: docking does not know what it has charged (power: none).
    """

    number: int
    end: End
    code: Code = Code.NONE
    message: str = ""
    retriable: bool = False
    place: Place | None = None
    electrodes: ElectrodePose | None = None
    suggested: BasePose | None = None
    unmeasured: bool = False


@dataclass(frozen=True)
class DockingReport:
    """docking_state: what docking_node is at."""

    state: State = State.IDLE
    docked: bool = False
    charging: bool = False

    @property
    def free(self) -> bool:
        """Whether nothing ties the robot to a target, so that its base may move."""
        return self.state is State.IDLE and not self.docked and not self.charging

    @property
    def rests(self) -> bool:
        """Whether the electrodes rest on the target and docking does not say that it charges."""
        return self.state is State.IDLE and self.docked and not self.charging


@dataclass(frozen=True)
class MissionObservation:
    """Everything known at `time` (s, monotonic); `docking` None = docking_state was never heard."""

    time: float
    served: frozenset[Task] = frozenset()
    docking: DockingReport | None = None
    replies: tuple[TaskReply, ...] = ()


@dataclass(frozen=True)
class MissionCommand:
    """What to do now: requests to send, and numbers of requests to call off."""

    requests: tuple[TaskRequest, ...] = ()
    cancels: tuple[int, ...] = ()


@dataclass(frozen=True)
class MissionOutcome(GoalOutcome):
    """How a mission ended; `returned`: the robot stands at its base and nothing holds it."""

    returned: bool = False


@dataclass
class MissionStatus:
    """What the machine tells about itself between commands."""

    stage: Stage = Stage.WAIT
    request_id: str = ""
    elapsed: float = 0.0
    views: int = 0
    stands: int = 0
    code: Code = Code.NONE
    message: str = ""
    place: Place | None = None
