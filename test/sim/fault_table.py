# SPDX-License-Identifier: Apache-2.0
"""Required behaviour under every fault: of docking by phase, and of the drivers by kind.

Three drivers check it. In virtual time: test/docking/test_machine_faults.py shows each fault of the inputs to docking's
machine in every phase, test/driver/test_servo_faults.py each kind to the servos' driver while the arm moves.
On the bytes of real nodes: test_fault_matrix.py, under a real goal. By request: test_fault_channel.py.

The limits are those of docs/docking.md. A board without packets opens within 0.1 s. The contactor's holder releases it
within 0.35 s (lease and heartbeat), plus the time to notice the fault: 0.1 s for frames and latched errors, 0.2 s for a
servo that does not answer.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from deltacharger_docking.codes import Code, State
from deltacharger_docking.observation import NAN3

TOUCHING = (State.LOCATE, State.APPROACH, State.CONTACT, State.MEASURE, State.ALIGN)
PHASES = (*TOUCHING, State.ENERGISE, State.CHARGING, State.RETRACT)
_NONE, _SERVO, _PADS, _POWER = Code.NONE, Code.SERVO_FAULT, Code.TACTILE_STALE, Code.POWER_STALE


def _ends(touching: Code = _NONE, energise: Code = _NONE, charging: Code = _NONE, retract: Code = _NONE) -> Any:
    each = {State.ENERGISE: energise, State.CHARGING: charging, State.RETRACT: retract}
    return {**dict.fromkeys(TOUCHING, touching), **each}


@dataclass(frozen=True)
class Input:
    """A fault of docking's inputs.

    Attributes:
        codes: by phase, the code with which the goal ends, or supervision after its success; NONE = not disturbed.
        later: the same if the node continues after a second; empty = it does not.
        shown: values that docking observes; empty = the node of this name is silent.
        opens: s within which a closed contactor opens, unless the code is NONE; 0 = not limited.
    """

    codes: Mapping[State, Code]
    later: Mapping[State, Code] = field(default_factory=dict)
    shown: Mapping[str, Any] = field(default_factory=dict)
    opens: float = 0.0


INPUTS = {
    "servo_node": Input(*[_ends(*[Code.SERVO_STALE] * 4)] * 2, opens=0.35),
    "missing servo": Input(
        {State.APPROACH: _SERVO, State.CONTACT: _SERVO, State.CHARGING: _SERVO},
        shown={"angles": NAN3, "servos_valid": False},
        opens=0.35,
    ),
    "mute servos": Input(
        {State.APPROACH: Code.SERVO_STALE, State.CONTACT: Code.SERVO_STALE, State.CHARGING: Code.SERVO_STALE},
        shown={"angles": NAN3, "servos_valid": False, "servos_mute": True},
        opens=0.35,
    ),
    # While retracting the contactor may be closed: the arm stays. A late answer to the last probe is not too late.
    "tactile_node": Input(
        _ends(_PADS, _POWER, _POWER, Code.CONTACTOR_WELDED),
        _ends(_PADS, _NONE, _POWER, Code.CONTACTOR_WELDED),
        opens=0.11,
    ),
    "misalignment_node": Input(_ends(_PADS, _NONE, _PADS), _ends()),
    # Docking asks it only in LOCATE; one later phase represents the others.
    "electrode_detector_node": Input(
        {State.LOCATE: Code.ELECTRODES_NOT_FOUND, State.CHARGING: _NONE}, {State.LOCATE: _NONE, State.CHARGING: _NONE}
    ),
    "docking_node": Input(_ends(), _ends(charging=_POWER), opens=0.35),
    "latched error": Input(_ends(*[_SERVO] * 4), shown={"hardware_error": 32}, opens=0.15),
    "lost torque": Input(
        dict.fromkeys(set(PHASES) - {State.LOCATE, State.ALIGN}, _SERVO),
        shown={"torque_enabled": False},
        opens=0.15,
    ),
    "lost push": Input({State.CHARGING: Code.NO_CONTACT}, shown={"currents": (0.0, 0.0, 0.0)}, opens=0.25),
    "late frames": Input(_ends(_PADS, _PADS, _PADS), shown={"tactile_age": 5.0}, opens=0.15),
    "late power": Input(_ends(_POWER, _POWER, _POWER, Code.CONTACTOR_WELDED), shown={"power_age": 5.0}, opens=0.15),
    "trip": Input(_ends(*[Code.OVERCURRENT] * 3), shown={"power_fault": 9}, opens=0.15),
}


BUS, LINK, PADS, POWER = "servo bus", "board link", "tactile arrays", "power stage"
NEVER = 0.0
LEASE = 0.35  # s with the heartbeat, until the contactor is open after its holder has asked


@dataclass(frozen=True)
class Row:
    """Effects of one fault of the hardware while it charges.

    Attributes:
        kind, servo, amount: the fault, as for `deltacharger fault`.
        part: name of the diagnostic that reports it.
        warning: words of its warning; empty if the fault is tolerated and only counted.
        counted: name of its counter.
        opens: s within which a closed contactor opens; NEVER = it stays closed.
        torque_off: whether the servos' torque is switched off.
        at_once: servos that lose their torque by the fault itself; no driver can open the contactor before that.
        deaf: servos that cannot receive commands during the fault; their own watchdog stops them.
        unknown: servos whose values are NaN during it.
        recovery: services that a person calls after it, in addition to docking again.
        shows: what docking sees of it, as in INPUTS; '' = nothing.
    """

    kind: str
    part: str = BUS
    warning: tuple[str, ...] = ()
    counted: str = ""
    opens: float = NEVER
    torque_off: bool = False
    at_once: tuple[int, ...] = ()
    deaf: tuple[int, ...] = ()
    unknown: tuple[int, ...] = ()
    recovery: tuple[str, ...] = ()
    servo: int = 0
    amount: float | None = None
    shows: str = ""

    @property
    def name(self) -> str:
        """Name in the list of tests."""
        return self.kind if self.amount is None else f"{self.kind}-{self.amount:g}"


def _stopped(kind: str, *warning: str, within: float = LEASE + 0.2, **others: Any) -> Row:
    """Return the row of a servo fault that stops all three."""
    return Row(kind, warning=warning, opens=within, torque_off=True, **{"shows": "missing servo", **others})


def _latched(kind: str, error: str, **others: Any) -> Row:
    """Return the row of a hardware error that only a reboot clears."""
    others = {"recovery": ("reboot_servos",), "shows": "latched error", **others}
    return _stopped(kind, f"servo 2 has latched: {error}", within=0.1, **others)


def _tolerated(kind: str, part: str, counted: str, amount: float) -> Row:
    return Row(kind, part, counted=counted, amount=amount)


_MUTE: dict[str, Any] = {"unknown": (1, 2, 3), "shows": "mute servos"}
SERVO_ROWS = (
    _stopped("servo_missing", "servo 2 does not answer", at_once=(2,), unknown=(2,)),
    _stopped("servo_reboot", "servo 2", "has restarted", at_once=(2,), unknown=(2,)),
    _latched("servo_voltage", "input voltage"),
    _latched("servo_overheating", "overheating", at_once=(2,)),
    _latched("servo_encoder", "encoder"),
    _latched("servo_shock", "electrical shock", at_once=(2,)),
    _latched("servo_overload", "overload", at_once=(2,)),
    _latched("servo_undervoltage", "input voltage", amount=9.0),
    # The servo stays where it is, and so its push ends.
    Row("servo_watchdog", counted="watchdog_trips", shows="lost push"),
    _stopped("servo_wrong_baud", "servo 2 does not answer", deaf=(2,), unknown=(2,), amount=57600.0),
    _stopped("servo_duplicate_id", "servo 2 does not answer", unknown=(1, 2), amount=1.0),
    _stopped("servo_deaf", "servo 1 does not answer", "servo 3 does not answer", deaf=(1, 2, 3), **_MUTE),
    _stopped("servo_delay", "does not answer", amount=0.1, **_MUTE),
    _tolerated("servo_delay", BUS, "", 0.005),
    _stopped("servo_unplugged", "/servo", within=LEASE, deaf=(1, 2, 3), **_MUTE),
    _tolerated("servo_drop", BUS, "timeouts", 0.05),
    _stopped("servo_drop", "servo 3 does not answer", servo=3, unknown=(3,), amount=1.0),
    *(_tolerated(f"servo_{name}", BUS, "corrupt", 0.05) for name in ("corrupt", "truncate")),
    *(_tolerated(f"servo_{name}", BUS, "", 0.05) for name in ("duplicate", "garbage")),
)

BOARD_ROWS = (
    Row("board_reboot", PADS, ("not tared",), opens=0.1, shows="tactile_node"),
    # Docking clears the latched fault by its opening.
    Row("board_trip", POWER, opens=0.1, amount=2.0),
    Row("board_trip", POWER, opens=0.1, amount=9.0, shows="trip"),
    Row("board_dead_taxel", PADS, ("dead taxel",), amount=44.0),
    Row("board_silent", LINK, ("no answer",), opens=0.45, shows="tactile_node"),
    Row("board_deaf", POWER, ("latched fault", "heartbeat lost"), opens=0.1),
    _tolerated("board_delay", LINK, "", 0.03),
    Row("board_delay", PADS, ("no fresh frames",), opens=0.45, amount=0.4, shows="late power"),
    Row("board_unplugged", LINK, ("/board",), opens=0.15, shows="tactile_node"),
    _tolerated("board_drop", LINK, "lost_tactile", 0.05),
    _tolerated("board_corrupt", LINK, "damaged", 0.05),
    _tolerated("board_truncate", LINK, "lost_tactile", 0.05),
    _tolerated("board_duplicate", LINK, "duplicates", 0.05),
    _tolerated("board_garbage", LINK, "damaged", 0.05),
    Row("target_port", POWER, opens=0.6, amount=5.0),
)
ROWS = SERVO_ROWS + BOARD_ROWS
