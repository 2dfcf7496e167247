# SPDX-License-Identifier: Apache-2.0
"""Inputs and outputs of the state machine in each tick."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TypeVar

from deltacharger_core import arrays, machine, script
from deltacharger_docking import clearance, codes
from deltacharger_kinematics import geometry, trajectory_feed

T = TypeVar("T", bound="GoalOutcome")

NAN3: geometry.Vector = (math.nan, math.nan, math.nan)
_STALL_MAX = 1.0  # s for which a stall of the computer may silence all servos

Reading = tuple[float, geometry.Vector, geometry.Vector]
"""Reading of the servos: time (s), angles (rad), currents (A)."""


class Service(Enum):
    """Services that the machine may ask the shell to call; each call is answered by a `Reply`."""

    TORQUE_ON = "set_torque true"
    TORQUE_OFF = "set_torque false"
    TARE = "tare"
    PROBE = "probe"
    OPEN = "set_contactor false"
    ESTIMATE = "predict_misalignment"
    DETECT = "detect_electrodes"


@dataclass(frozen=True)
class Request:
    """One call of a service; the reply repeats its `number`. An estimate averages `frames`."""

    number: int
    service: Service
    frames: int = 0
    timeout: float = 0.0


@dataclass(frozen=True)
class ElectrodePose:
    """Midpoint of the target's electrodes (m, charger_base), roll about z and its standard deviation (rad), age (s).

    `yaw` and `pitch` (rad): rotations of the electrodes' z axis about +y and about +x of charger_base, with their
    standard deviations; NaN = unknown. `image_range`: m from the camera if it had no depth, else 0.
    """

    position: geometry.Vector
    roll: float
    roll_stddev: float = 0.0
    age: float = 0.0
    yaw: float = math.nan
    pitch: float = math.nan
    yaw_stddev: float = math.nan
    pitch_stddev: float = math.nan
    image_range: float = 0.0

    @property
    def numbers(self) -> dict[str, float]:
        """Its values for decisions, by name and unit; the lean only if known."""
        x, y, z = self.position
        leans = {"yaw_rad": self.yaw, "pitch_rad": self.pitch}
        known = {name: lean for name, lean in leans.items() if not math.isnan(lean)}
        return {"x_m": x, "y_m": y, "z_m": z, "roll_rad": self.roll, **known}

    def sure_yaw(self, sigmas: float) -> float:
        """Return the yaw (rad) if it differs from 0 by at least this many standard deviations; else 0."""
        return self.yaw if abs(self.yaw) > sigmas * self.yaw_stddev else 0.0


@dataclass(frozen=True)
class BasePose:
    """Pose for charger_base: x, y, z (m) and the rotation about +y (rad), in the present charger_base."""

    x: float
    y: float
    z: float
    yaw: float = 0.0

    @classmethod
    def before(cls, electrodes: geometry.Vector, yaw: float = 0.0) -> BasePose:
        """Return the pose that faces electrodes (m) squarely: they are then at (0, 0, DOCK_DISTANCE), without yaw.

        Args:
            electrodes: their position, m in the present charger_base.
            yaw: rotation of their faces about +y, rad.
        """
        x, y, z = electrodes
        return cls(x - machine.DOCK_DISTANCE * math.sin(yaw), y, z - machine.DOCK_DISTANCE * math.cos(yaw), yaw)

    @property
    def electrodes(self) -> geometry.Vector:
        """The electrodes (m, the present charger_base) that this pose faces."""
        x, z = self.x + machine.DOCK_DISTANCE * math.sin(self.yaw), self.z + machine.DOCK_DISTANCE * math.cos(self.yaw)
        return x, self.y, z


@dataclass(frozen=True)
class Reply:
    """Answer to the request with this number; only the fields of its service are set.

    An estimate names the `sequences` of its tactile frames; it was requested at `asked` (s).
    """

    number: int
    success: bool
    message: str = ""
    estimate: clearance.MisalignmentEstimate | None = None
    sequences: tuple[int, ...] = ()
    asked: float = -math.inf
    detection: ElectrodePose | None = None
    resistance: float = math.nan
    target_voltage: float = math.nan


@dataclass(frozen=True)
class Observation:
    """Everything known at `time` (s, monotonic). Ages in s, inf = never; NaN = not measured.

    `servos_mute`: no servo answers. `duplicate_sources` names nodes that publish or serve the same input of docking;
    '' = none. `earlier` holds readings of the servos since the last observation, before this one. `charge_current` and
    `least_current` (A) are the mean and the least of a period of charger_power; `stage_voltage` NaN = the board sets
    it. `clock_problem` describes a problem of the clock that ages are measured by; '' = none. `stopped` is why
    servo_node stopped a joint that strayed. `taxels` is the newest tared frame (2, 10, 10), N.
    """

    time: float
    angles: geometry.Vector = NAN3
    currents: geometry.Vector = NAN3
    servo_age: float = math.inf
    servos_valid: bool = False
    servos_mute: bool = False
    hardware_error: int = 0
    torque_enabled: bool = False
    thermal_reserve: float = math.inf
    tactile_age: float = math.inf
    tactile_contact: bool = False
    tared: bool = False
    power_age: float = math.inf
    contactor_closed: bool = False
    charge_current: float = math.nan
    least_current: float = math.nan
    target_voltage: float = math.nan
    battery_voltage: float = math.nan
    power_fault: int = 0
    stage_steps_up: bool = True
    stage_voltage: float = math.nan
    contactor_refusal: str = ""
    duplicate_sources: str = ""
    replies: tuple[Reply, ...] = ()
    earlier: tuple[Reading, ...] = ()
    clock_problem: str = ""
    stopped: str = ""
    taxels: arrays.Array | None = None

    @property
    def oldest(self) -> float:
        """Age (s) of servo_state or of the tactile frames, whichever are older."""
        return max(self.servo_age, self.tactile_age)

    def servo_silence(self) -> codes.DockingError:
        """Return the error of servo data that are too old: they come late, or a servo does not answer.

        All servos at once fall silent also where the computer or a USB adapter stalls, but not for long.
        """
        if self.servos_valid or self.servo_age == math.inf:
            return codes.ServoStale(
                f"servo_state is {self.servo_age:.1f} s old; check servo_node and this computer's load"
            )
        who = "no servo has" if self.servos_mute else "a servo has not"
        silence = f"{who} answered for {self.servo_age:.1f} s; check the servo bus and its power"
        if self.servos_mute and self.servo_age < _STALL_MAX:
            return codes.ServoStale(f"{silence}, and this computer's load")
        return codes.ServoFailure(silence)


@dataclass(frozen=True)
class Decision:
    """A decision at `time` (s, the observation's clock): its kind in docs/dock-goals.md, a sentence, and its numbers,
    whose names end in the unit."""

    time: float
    state: codes.State
    kind: str
    text: str
    values: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Command:
    """What to do now. The contactor is to be closed only while `energise`, within `limits`.

    A trajectory replaces the one that the arm follows. Its times count from the observation's, and its last point
    holds. It is only a piece of the way (see `trajectory_feed`): None = continue with the last one, empty = hold.
    `waits` gives the time until which nothing is decided, so a shell in virtual time may take longer steps. Such steps
    must end before the pieces of a line run out, and the next observation must hold the readings between them if the
    wait needs readings.
    """

    trajectory: tuple[trajectory_feed.Waypoint, ...] | None = None
    requests: tuple[Request, ...] = ()
    energise: bool = False
    limits: machine.ChargeLimits | None = None
    decisions: tuple[Decision, ...] = ()
    waits: script.Wait = script.NEXT


@dataclass(frozen=True)
class DockGoal:
    """A client's request; `electrodes` None = ask the camera."""

    electrodes: ElectrodePose | None
    critical_angle: float = 0.0
    start_charging: bool = True
    hold: bool = False
    stop_energy: float = 0.0
    stop_after: float = 0.0
    request_id: str = ""
    target_profile: str = ""


@dataclass(frozen=True)
class GoalOutcome:
    """Result of a goal, after `elapsed` s; `notice` is further information for the client after success."""

    success: bool = False
    code: codes.Code = codes.Code.INTERNAL
    message: str = ""
    retriable: bool = False
    elapsed: float = 0.0
    notice: str = ""

    @property
    def canceled(self) -> bool:
        """Whether its client cancelled it."""
        return self.code is codes.Code.CANCELED

    @classmethod
    def refused(cls: type[T], error: Exception) -> T:
        """Return the result of a goal that `error` prevented; other classes than DockingError are defects."""
        if not isinstance(error, codes.DockingError):
            return cls(message=f"internal error: {error}; see the log")
        return cls(code=error.code, message=str(error), retriable=error.retriable)


@dataclass(frozen=True)
class DockingOutcome(GoalOutcome):
    """Result of a Dock goal. NaN = not measured; `suggested_base` only if another pose of the robot would help.

    `alignments` counts corrections, `redockings` repeated contacts without correction. `charge_end` says what ended
    charging, `charge_voltage` (V) is the target's then.
    """

    aligned: bool = False
    alignments: int = 0
    estimate: clearance.MisalignmentEstimate | None = None
    contact_current: float = math.nan
    contact_force: float = math.nan
    charge_current: float = math.nan
    energy: float = 0.0
    suggested_base: BasePose | None = None
    redockings: int = 0
    contact_force_min: float = math.nan
    contact_force_max: float = math.nan
    charge_end: str = ""
    charge_voltage: float = math.nan


@dataclass
class DockingStatus:
    """The machine's state between commands.

    `aligned`: this contact has clearance, no gain is expected from another, and the risk is at most 2 %.
    """

    state: codes.State = codes.State.IDLE
    docked: bool = False
    charging: bool = False
    code: codes.Code = codes.Code.NONE
    message: str = ""
    request_id: str = ""
    aligned: bool = False
    alignments: int = 0
    position: geometry.Vector = NAN3
    contact_current: float = math.nan
    estimate: clearance.MisalignmentEstimate | None = None
    elapsed: float = 0.0
    duplicate_sources: str = ""
    redockings: int = 0
    waiting_for: str = ""
    contact_force: float = math.nan
