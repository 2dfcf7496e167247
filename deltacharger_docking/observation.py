# SPDX-License-Identifier: Apache-2.0
"""What the state machine sees and what it says, once per tick."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TypeVar

from deltacharger_core.machine import DOCK_DISTANCE
from deltacharger_core.script import NEXT, Wait
from deltacharger_docking.clearance import FeltPose
from deltacharger_docking.codes import Code, DockingError, State
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.trajectory_feed import Waypoint

T = TypeVar("T", bound="GoalOutcome")

NAN3: Vector = (math.nan, math.nan, math.nan)


Reading = tuple[float, Vector, Vector]
"""Of the servos: when (s), angles (rad), currents (A)."""


class Service(Enum):
    """What the machine may ask the shell to do on its behalf; each is answered by a `Reply`."""

    TORQUE_ON = "set_torque true"
    TORQUE_OFF = "set_torque false"
    TARE = "tare"
    PROBE = "probe"
    OPEN = "set_contactor false"
    ESTIMATE = "predict_misalignment"
    DETECT = "detect_electrodes"


@dataclass(frozen=True)
class Request:
    """One call of a service; `number` comes back in the reply.

    An estimate averages `frames` and has besides the classes of the packaged `model`, '' = none.
    """

    number: int
    service: Service
    frames: int = 0
    timeout: float = 0.0
    model: str = ""


@dataclass(frozen=True)
class ElectrodePose:
    """Midpoint of the target's electrodes (m, charger_base), roll about z and its standard deviation (rad), age (s).

    `yaw` and `pitch` (rad): how far the electrodes' z axis is turned about +y and about +x of charger_base, and the
    standard deviations of these; NaN = unknown.
    """

    position: Vector
    roll: float
    roll_stddev: float = 0.0
    age: float = 0.0
    yaw: float = math.nan
    pitch: float = math.nan
    yaw_stddev: float = math.nan
    pitch_stddev: float = math.nan

    @property
    def numbers(self) -> dict[str, float]:
        """What decisions tell of it, by name and unit; of a lean what is known."""
        x, y, z = self.position
        leans = {"yaw_rad": self.yaw, "pitch_rad": self.pitch}
        known = {name: lean for name, lean in leans.items() if not math.isnan(lean)}
        return {"x_m": x, "y_m": y, "z_m": z, "roll_rad": self.roll, **known}

    def sure_yaw(self, sigmas: float) -> float:
        """Return the yaw (rad) where it is surely not 0, by so many standard deviations; else 0."""
        return self.yaw if abs(self.yaw) > sigmas * self.yaw_stddev else 0.0


@dataclass(frozen=True)
class BasePose:
    """Where charger_base should stand: x, y, z (m) and the turn about +y (rad), in the present charger_base."""

    x: float
    y: float
    z: float
    yaw: float = 0.0

    @classmethod
    def before(cls, electrodes: Vector, yaw: float = 0.0) -> BasePose:
        """Return the stand that faces electrodes (m) squarely: it has them at (0, 0, DOCK_DISTANCE), without yaw.

        Args:
            electrodes: where they are, m in the present charger_base.
            yaw: rotation of their faces about +y, rad.
        """
        x, y, z = electrodes
        return cls(x - DOCK_DISTANCE * math.sin(yaw), y, z - DOCK_DISTANCE * math.cos(yaw), yaw)

    @property
    def electrodes(self) -> Vector:
        """The electrodes (m, the present charger_base) that this stand faces."""
        x, z = self.x + DOCK_DISTANCE * math.sin(self.yaw), self.z + DOCK_DISTANCE * math.cos(self.yaw)
        return x, self.y, z


@dataclass(frozen=True)
class Reply:
    """Answer to the request of the same number; the payload that its service has, else None.

    An estimate names the `sequences` of the tactile frames it was made of, and was `asked` for at that time (s).
    """

    number: int
    success: bool
    message: str = ""
    estimate: FeltPose | None = None
    sequences: tuple[int, ...] = ()
    asked: float = -math.inf
    detection: ElectrodePose | None = None
    resistance: float = math.nan
    target_voltage: float = math.nan


@dataclass(frozen=True)
class Observation:
    """Everything known at `time` (s, monotonic). Ages in s, inf = never; NaN = not measured.

    `duplicate_sources` names who publishes or serves beside another what docking works with; '' = nobody. `earlier` are
    readings of the servos made since the last observation, where there were more than this one. `simulated` only where
    servos and board are known to be a simulated charger's. `clock_problem` says what is wrong with the clock by which
    ages are judged; '' = nothing.
    """

    time: float
    angles: Vector = NAN3
    currents: Vector = NAN3
    servo_age: float = math.inf
    servos_valid: bool = False
    hardware_error: int = 0
    torque_enabled: bool = False
    thermal_reserve: float = math.inf
    tactile_age: float = math.inf
    tactile_contact: bool = False
    tared: bool = False
    power_age: float = math.inf
    contactor_closed: bool = False
    charge_current: float = math.nan
    target_voltage: float = math.nan
    battery_voltage: float = math.nan
    power_fault: int = 0
    contactor_refusal: str = ""
    duplicate_sources: str = ""
    replies: tuple[Reply, ...] = ()
    earlier: tuple[Reading, ...] = ()
    simulated: bool = False
    clock_problem: str = ""


@dataclass(frozen=True)
class Decision:
    """What was decided at `time` (s, the observation's clock), in one word of docs/dock-goals.md, in a sentence, and by
    which numbers; each name ends in its unit."""

    time: float
    state: State
    kind: str
    text: str
    values: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Command:
    """What to do now. The contactor is wanted only while `energise`.

    A trajectory replaces what the arm follows; its times count from the observation's, and its last point holds. It is
    only a piece of the way (see `trajectory_feed`): None = go on with the last one, empty = hold. `states` are those
    entered since the last command, in their order: each is to be published, though some last no tick. `waits` says
    until when nothing is decided: a shell in virtual time may take longer steps until then. It must only take them
    before the pieces of a line run out, and give the readings between them with the next observation where they count.
    """

    trajectory: tuple[Waypoint, ...] | None = None
    requests: tuple[Request, ...] = ()
    energise: bool = False
    states: tuple[State, ...] = ()
    decisions: tuple[Decision, ...] = ()
    waits: Wait = NEXT


@dataclass(frozen=True)
class DockGoal:
    """What a client wants; `electrodes` None = ask the camera."""

    electrodes: ElectrodePose | None
    critical_angle: float = 0.0
    start_charging: bool = True
    hold: bool = False
    stop_energy: float = 0.0
    stop_after: float = 0.0
    request_id: str = ""


@dataclass(frozen=True)
class GoalOutcome:
    """How a goal ended, after `elapsed` s; `notice` is what its client must know of a success."""

    success: bool = False
    code: Code = Code.INTERNAL
    message: str = ""
    retriable: bool = False
    elapsed: float = 0.0
    notice: str = ""

    @property
    def canceled(self) -> bool:
        """Whether it ended because its client wished so."""
        return self.code is Code.CANCELED

    @classmethod
    def refused(cls: type[T], error: Exception) -> T:
        """Return how a goal ended that this kept from beginning; a defect where it is none of docking's errors."""
        if not isinstance(error, DockingError):
            return cls(message=f"internal error: {error}; see the log")
        return cls(code=error.code, message=str(error), retriable=error.retriable)


@dataclass(frozen=True)
class DockingOutcome(GoalOutcome):
    """How a goal of docking ended. NaN = not measured; `suggested_base` only where another stand would help.

    `alignments` are the lateral corrections, `redockings` the contacts made anew without one.
    """

    aligned: bool = False
    alignments: int = 0
    estimate: FeltPose | None = None
    contact_current: float = math.nan
    contact_force: float = math.nan
    charge_current: float = math.nan
    energy: float = 0.0
    suggested_base: BasePose | None = None
    redockings: int = 0


@dataclass
class DockingStatus:
    """What the machine tells about itself between commands.

    `aligned`: this contact has clearance, another one would not pay, and the told risk is at most `aligned_risk_max`.
    """

    state: State = State.IDLE
    docked: bool = False
    charging: bool = False
    code: Code = Code.NONE
    message: str = ""
    request_id: str = ""
    aligned: bool = False
    alignments: int = 0
    position: Vector = NAN3
    contact_current: float = math.nan
    estimate: FeltPose | None = None
    elapsed: float = 0.0
    duplicate_sources: str = ""
    redockings: int = 0
    waiting_for: str = ""
    contact_force: float = math.nan
