# SPDX-License-Identifier: Apache-2.0
"""States and error codes of docking, one exception per code, and the remedy for each.

The numbers are those of the constants in Dock.action, Undock.action and DockingState.msg.
"""

from enum import IntEnum

from deltacharger_kinematics.geometry import Vector


class State(IntEnum):
    """What the charger is doing."""

    IDLE = 0
    LOCATE = 1
    APPROACH = 2
    BACK_OFF = 3
    CONTACT = 4
    MEASURE = 5
    ALIGN = 6
    ENERGISE = 7
    CHARGING = 8
    RETRACT = 9


class Code(IntEnum):
    """Why a goal ended."""

    NONE = 0
    REJECTED = 101
    CANCELED = 102
    TIMEOUT = 103
    DUPLICATE_SOURCE = 104
    ELECTRODES_NOT_FOUND = 201
    DETECTION_STALE = 202
    UNREACHABLE = 301
    NO_CONTACT = 302
    OVERCURRENT = 303
    SERVO_FAULT = 304
    STUCK = 305
    TARGET_ROLLS = 306
    SERVO_STALE = 307
    NO_TACTILE_CONTACT = 401
    TACTILE_STALE = 402
    CRITICAL_ANGLE = 403
    ESTIMATE_UNSURE = 404
    MISALIGNED = 405
    LEANING = 406
    NO_CHARGE_CURRENT = 501
    SHORT_CIRCUIT = 502
    POWER_STALE = 503
    REVERSE_POLARITY = 504
    VOLTAGE_OUT_OF_RANGE = 505
    REVERSE_CURRENT = 506
    CONTACTOR_WELDED = 507
    INTERNAL = 999


class DockingError(Exception):
    """Base class of all reasons why a goal can fail.

    `code` identifies it. `retriable`: the same goal may succeed later.
    """

    code: Code = Code.INTERNAL
    retriable: bool = False

    def __init_subclass__(cls, code: Code | None = None, retriable: bool | None = None) -> None:
        """Set what the class statement gives; the rest is inherited."""
        for name, value in {"code": code, "retriable": retriable}.items():
            if value is not None:
                setattr(cls, name, value)


class Rejected(DockingError, code=Code.REJECTED):
    """The goal cannot be served as given. Example: a critical angle above the configured one."""


class Busy(Rejected, retriable=True):
    """Another goal is being served. Example: a second fleet manager sends a goal."""


class PoseUnknown(Rejected, retriable=True):
    """The pose of the goal's frame is unknown at present. Example: localization has stopped."""


class Canceled(DockingError, code=Code.CANCELED, retriable=True):
    """The client cancelled the goal."""


class NoTime(Rejected, retriable=True):
    """The clock of message stamps has no time yet. Example: use_sim_time is set before anything publishes /clock."""


class PhaseTimeout(DockingError, TimeoutError, code=Code.TIMEOUT, retriable=True):
    """A phase or the docking took longer than its limit."""


class DuplicateSource(DockingError, code=Code.DUPLICATE_SOURCE, retriable=True):
    """A second node publishes or serves an input of docking. Example: another charger runs in this namespace."""


class ElectrodesNotFound(DockingError, code=Code.ELECTRODES_NOT_FOUND, retriable=True):
    """The camera sees no electrodes, or no detector runs."""


class DetectionStale(DockingError, code=Code.DETECTION_STALE, retriable=True):
    """The detection is older than allowed: robot or target may have moved."""


class Misplaced(DockingError):
    """Another position of the robot would help. The result names it.

    Attributes:
        electrodes: their position (m, charger_base); None if no better position of the robot is known.
        yaw: rotation of their faces about +y (rad, charger_base); 0 if unknown.
    """

    def __init__(self, message: str, electrodes: Vector | None = None, yaw: float = 0.0) -> None:
        self.electrodes = electrodes
        self.yaw = yaw
        super().__init__(message)


class Unreachable(Misplaced, code=Code.UNREACHABLE):
    """The target is outside the workspace; if `electrodes` is None, the arm's own motion would leave it."""


class NoContact(DockingError, code=Code.NO_CONTACT, retriable=True):
    """There was no contact up to the arm's limit, or contact was lost later."""


class Overcurrent(DockingError, code=Code.OVERCURRENT, retriable=True):
    """The servos pushed harder than allowed even after backing off."""


class ChargeOvercurrent(Overcurrent, retriable=False):
    """More charge current flowed than allowed. Example: the power stage's current limiter failed."""


class ServoFailure(DockingError, code=Code.SERVO_FAULT):
    """A servo does not answer, is without torque or hot, or reports a hardware error."""


class Astray(ServoFailure):
    """The arm is not where it was sent, so it is not driven on: it goes limp where it is."""


class Stuck(DockingError, code=Code.STUCK, retriable=True):
    """The magnets did not release within the allowed pull, or the arm did not come home."""


class TargetRolls(Stuck, code=Code.TARGET_ROLLS):
    """The target gives way to the push or comes along with the magnets. Example: its brakes are not set."""


class ServoStale(DockingError, code=Code.SERVO_STALE, retriable=True):
    """servo_state stopped, or all servos fell silent, perhaps only briefly. Example: the computer stalled."""


class NoTactileContact(DockingError, code=Code.NO_TACTILE_CONTACT, retriable=True):
    """The servos push but no taxel measures a force: the pads missed the target's ridges."""


class TactileStale(DockingError, code=Code.TACTILE_STALE, retriable=True):
    """Tactile frames or estimates are missing, or the pads were not tared."""


class CriticalAngle(DockingError, code=Code.CRITICAL_ANGLE):
    """The target is rolled so far that the electrodes would short."""


class EstimateUnsure(DockingError, code=Code.ESTIMATE_UNSURE, retriable=True):
    """The tactile estimate stayed unsure, or contradicts the arm's moves."""


class Misaligned(DockingError, code=Code.MISALIGNED, retriable=True):
    """The electrodes could not be moved far enough from the wrong bars."""


class Leaning(Misplaced, code=Code.LEANING):
    """The electrodes' faces lean too far. Example: the robot is parked askew. `electrodes` is None for a pitch."""


class NoChargeCurrent(DockingError, code=Code.NO_CHARGE_CURRENT, retriable=True):
    """No current flows, although the contactor is closed or could be."""


class ShortCircuit(DockingError, code=Code.SHORT_CIRCUIT):
    """The probe or the power stage found a short between the electrodes, or a live port lost its voltage in contact."""


class PowerStale(DockingError, code=Code.POWER_STALE, retriable=True):
    """The power stage is silent or opened by itself, the lease was not renewed, or docking was suspended while live."""


class ReversePolarity(DockingError, code=Code.REVERSE_POLARITY):
    """The target's electrodes have the wrong polarity."""


class VoltageOutOfRange(DockingError, code=Code.VOLTAGE_OUT_OF_RANGE):
    """The voltage of the target, of the power stage or of the charger's own battery is outside its limits."""


class ReverseCurrent(DockingError, code=Code.REVERSE_CURRENT):
    """More than 5 A flowed out of the target."""


class Regenerated(ReverseCurrent, retriable=True):
    """Current flowed out of the target. Example: it braked its wheels."""


class ContactorWelded(DockingError, code=Code.CONTACTOR_WELDED):
    """After the order to open, current still flows, or a silent power stage hides whether it does."""


# ChargerPower.fault to docking's error and its text. 1 to 7 are the codes 50x less 500. 8: the power stage received no
# heartbeat. 9: an over-current, which the stage distinguishes from a short.
POWER_FAULTS: dict[int, tuple[type[DockingError], str]] = {
    1: (NoChargeCurrent, "no charge current"),
    2: (ShortCircuit, "short circuit"),
    3: (PowerStale, "stale measurements"),
    4: (ReversePolarity, "reverse polarity"),
    5: (VoltageOutOfRange, "voltage out of range"),
    6: (ReverseCurrent, "reverse current"),
    7: (ContactorWelded, "contactor welded"),
    8: (PowerStale, "heartbeat lost"),
    9: (ChargeOvercurrent, "over-current"),
}

REMEDIES: dict[Code, str] = {
    Code.NONE: "",
    Code.REJECTED: "correct the goal, or wait for the running one",
    Code.CANCELED: "",
    Code.TIMEOUT: "see in the log what the phase waited for",
    Code.DUPLICATE_SOURCE: "stop the second node, or give it its own namespace or `ROS_DOMAIN_ID`",
    Code.ELECTRODES_NOT_FOUND: "move the robot so that the camera sees the electrodes, or give coordinates",
    Code.DETECTION_STALE: "check the camera's rate; if it is on another computer, compare the clocks",
    Code.UNREACHABLE: "move the robot to `suggested_base_pose`",
    Code.NO_CONTACT: "check that the target is there and its coordinates are right",
    Code.OVERCURRENT: "the target moved toward the charger; charge current: have the power stage's limiter checked",
    Code.SERVO_FAULT: "see the message; `reboot_servos` clears latched errors",
    Code.STUCK: "the magnets hold: free the target by hand",
    Code.TARGET_ROLLS: "set the brakes of target and charger, and move the target back to its place",
    Code.SERVO_STALE: "check servo_node, and whether this computer is too busy",
    Code.NO_TACTILE_CONTACT: "check coordinates, what lies between pads and ridges, the cable, and each servo's id",
    Code.TACTILE_STALE: "check the board's cable, tactile_node and misalignment_node",
    Code.CRITICAL_ANGLE: "level the target or the charger",
    Code.ESTIMATE_UNSURE: "check pads and target for dirt and damage",
    Code.MISALIGNED: "send the goal again; if the error returns, calibrate the pads",
    Code.LEANING: "yaw: turn the robot to `suggested_base_pose`; pitch: level the target or the charger",
    Code.NO_CHARGE_CURRENT: "as the message states: switch the target or its input on, clean the electrodes, or "
    "correct its profile",
    Code.SHORT_CIRCUIT: "check what lies between the electrodes; clean or realign them",
    Code.POWER_STALE: "check the board's cable and tactile_node",
    Code.REVERSE_POLARITY: "rewire the target",
    Code.VOLTAGE_OUT_OF_RANGE: "as the message states: check robot and profile, set the power stage's voltage, or "
    "charge the charger's own battery",
    Code.REVERSE_CURRENT: "have the target stand still while it is charged; if the error returns, have its charging "
    "input checked",
    Code.CONTACTOR_WELDED: "switch the battery off, replace the contactor",
    Code.INTERNAL: "report it, with the log",
}
"""The remedy for each code, with which its row in docs/errors.md begins; empty if nothing needs to be done."""
