# SPDX-License-Identifier: Apache-2.0
"""States and error codes of docking, and one exception per code.

The numbers are those of the constants in Dock.action, Undock.action and DockingState.msg.
"""

from __future__ import annotations

from enum import IntEnum
from typing import ClassVar

from deltacharger_kinematics.geometry import Vector

SILENT_SERVOS = "check the servo bus and servo_node, and whether this computer is too busy"


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
    ELECTRODES_NOT_FOUND = 201
    DETECTION_STALE = 202
    UNREACHABLE = 301
    NO_CONTACT = 302
    OVERCURRENT = 303
    SERVO_FAULT = 304
    STUCK = 305
    NO_TACTILE_CONTACT = 401
    TACTILE_STALE = 402
    CRITICAL_ANGLE = 403
    ESTIMATE_UNSURE = 404
    MISALIGNED = 405
    NO_CHARGE_CURRENT = 501
    SHORT_CIRCUIT = 502
    POWER_STALE = 503
    REVERSE_POLARITY = 504
    VOLTAGE_OUT_OF_RANGE = 505
    REVERSE_CURRENT = 506
    CONTACTOR_WELDED = 507
    INTERNAL = 999


class DockingError(Exception):
    """Root of every way a goal can fail.

    `code` names it, `retriable` says whether the same goal may succeed later, `mended_by_docking` whether docking again
    at once may mend it.
    """

    code: ClassVar[Code] = Code.INTERNAL
    retriable: ClassVar[bool] = False
    mended_by_docking: ClassVar[bool] = False


class Rejected(DockingError):
    """The goal cannot be served as given. Example: a critical angle above the configured one."""

    code = Code.REJECTED


class Busy(Rejected):
    """Another goal is being served. Example: a second fleet manager sends a goal."""

    retriable = True


class Canceled(DockingError):
    """The client took its wish back."""

    code = Code.CANCELED
    retriable = True


class PhaseTimeout(DockingError, TimeoutError):
    """A phase or the whole docking took longer than its limit."""

    code = Code.TIMEOUT
    retriable = True


class ElectrodesNotFound(DockingError):
    """The camera sees no electrodes, or nobody looks."""

    code = Code.ELECTRODES_NOT_FOUND
    retriable = True


class DetectionStale(DockingError):
    """The detection is older than allowed: robot or target may have moved."""

    code = Code.DETECTION_STALE
    retriable = True


class Unreachable(DockingError):
    """The target lies outside the arm's workspace. The result says where the robot should stand.

    Attributes:
        electrodes: where they are (m, charger_base), None where the arm's own motion was out of reach.
    """

    code = Code.UNREACHABLE

    def __init__(self, message: str, electrodes: Vector | None = None) -> None:
        self.electrodes = electrodes
        super().__init__(message)


class NoContact(DockingError):
    """The arm went as far as it may and met nothing."""

    code = Code.NO_CONTACT
    retriable = True
    mended_by_docking = True


class Overcurrent(DockingError):
    """The servos pushed harder than allowed even after backing off."""

    code = Code.OVERCURRENT
    retriable = True
    mended_by_docking = True


class ChargeOvercurrent(Overcurrent):
    """More charge current flowed than the power stage allows. Example: its current limiter failed."""

    retriable = False
    mended_by_docking = False


class ServoFailure(DockingError):
    """A servo is missing, silent or reports a hardware error."""

    code = Code.SERVO_FAULT


class Stuck(DockingError):
    """The magnets did not let go within the allowed pull."""

    code = Code.STUCK
    retriable = True


class NoTactileContact(DockingError):
    """The servos push but no taxel feels anything: the pads missed the target's ridges."""

    code = Code.NO_TACTILE_CONTACT
    retriable = True
    mended_by_docking = True


class TactileStale(DockingError):
    """Tactile frames stopped."""

    code = Code.TACTILE_STALE
    retriable = True


class CriticalAngle(DockingError):
    """The target is tilted so far that the electrodes would short."""

    code = Code.CRITICAL_ANGLE


class EstimateUnsure(DockingError):
    """The tactile estimate stayed unsure after docking again."""

    code = Code.ESTIMATE_UNSURE
    retriable = True
    mended_by_docking = True


class Misaligned(DockingError):
    """The electrodes could not be brought far enough from the wrong neighbour."""

    code = Code.MISALIGNED
    retriable = True
    mended_by_docking = True


class NoChargeCurrent(DockingError):
    """The contactor is closed, or would be, and no current flows."""

    code = Code.NO_CHARGE_CURRENT
    retriable = True


class ShortCircuit(DockingError):
    """The probe or the power stage found a short between the electrodes."""

    code = Code.SHORT_CIRCUIT


class PowerStale(DockingError):
    """The power stage stopped answering."""

    code = Code.POWER_STALE
    retriable = True


class ReversePolarity(DockingError):
    """The target's electrodes have the wrong polarity."""

    code = Code.REVERSE_POLARITY


class VoltageOutOfRange(DockingError):
    """The target's voltage is outside what the charger may feed."""

    code = Code.VOLTAGE_OUT_OF_RANGE


class ReverseCurrent(DockingError):
    """Current flows out of the target."""

    code = Code.REVERSE_CURRENT


class ContactorWelded(DockingError):
    """The contactor was told to open and current still flows."""

    code = Code.CONTACTOR_WELDED


# ChargerPower.fault to the error that docking reports, and in words: 1 to 7 are the codes 50x less 500. 8 means that
# the power stage heard nobody; 9 is no short, which the stage tells apart, and bears the name of what it is.
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
