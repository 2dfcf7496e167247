# SPDX-License-Identifier: Apache-2.0
"""What is asked of the charger under every fault: one row each, the same while moving, pressing and charging.

The limits are those of docs/docking.md: a board that hears nothing opens within 0.1 s; who holds the contactor lets it
go within 0.35 s (lease and heartbeat), to which what it takes to notice is added: 0.1 s for frames and latched errors,
0.2 s for a servo that does not answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from .fault_bench import Phase

BUS, LINK, PADS, POWER = "servo bus", "board link", "tactile arrays", "power stage"
NEVER = 0.0


@dataclass(frozen=True)
class Row:
    """What one fault does.

    Attributes:
        kind, servo, amount: the fault, as `deltacharger fault` takes it.
        part: whose diagnostic tells of it.
        says: words of its message, which warns; empty where the fault is borne and counted only.
        counted: the value that counts it.
        opens: s within which a closed contactor opens; NEVER = it stays closed.
        lets_go: the servos' torque goes off.
        at_once: servos that lose their torque by the fault itself: no driver can open the contactor before that.
        deaf: servos that cannot be told to let go while the fault lasts; they stop by their own watchdog.
        unknown: what is not known under it: servo ids (their floats are NaN), "frames" and "power" (these topics are
            silent) or "taxel 44".
        asked: a service that refuses under it, with words of its answer; nothing else tells of the fault.
        recovery: services that a person calls when it is over, in this order, besides set_torque and probe.
        idle: what differs while the contactor is open.
    """

    kind: str
    part: str = BUS
    says: tuple[str, ...] = ()
    counted: str = ""
    opens: float = NEVER
    lets_go: bool = False
    at_once: tuple[int, ...] = ()
    deaf: tuple[int, ...] = ()
    unknown: tuple[int | str, ...] = ()
    asked: tuple[str, ...] = ()
    recovery: tuple[str, ...] = ()
    servo: int = 0
    amount: float | None = None
    idle: Row | None = None

    @property
    def name(self) -> str:
        """As it is called in the list of tests."""
        return self.kind if self.amount is None else f"{self.kind}-{self.amount:g}"

    def at(self, phase: Phase) -> Row:
        """Return what it does in a phase."""
        return self if phase is Phase.CHARGING or self.idle is None else self.idle


def _stopped(kind: str, *says: str, within: float = 0.35 + 0.2, **others: object) -> Row:
    """A fault of a servo that stops all three."""
    return replace(Row(kind, says=says, opens=within, lets_go=True), **others)  # type: ignore[arg-type]


def _latched(kind: str, error: str, **others: object) -> Row:
    """A hardware error, which a reboot clears and nothing else does."""
    return _stopped(kind, f"servo 2 has latched: {error}", within=0.1, recovery=("reboot_servos",), **others)


def _borne(kind: str, part: str, counted: str, amount: float) -> Row:
    return Row(kind, part, counted=counted, amount=amount)


SERVO_ROWS = (
    _stopped("servo_missing", "servo 2 does not answer", at_once=(2,), unknown=(2,)),
    _stopped("servo_reboot", "servo 2", "has restarted", at_once=(2,), unknown=(2,)),
    _latched("servo_voltage", "input voltage"),
    _latched("servo_overheating", "overheating", at_once=(2,)),
    _latched("servo_encoder", "encoder"),
    _latched("servo_shock", "electrical shock", at_once=(2,)),
    _latched("servo_overload", "overload", at_once=(2,)),
    _latched("servo_undervoltage", "input voltage", amount=9.0),
    Row("servo_watchdog", counted="watchdog_trips"),
    _stopped("servo_wrong_baud", "servo 2 does not answer", deaf=(2,), unknown=(2,), amount=57600.0),
    _stopped("servo_duplicate_id", "servo 2 does not answer", unknown=(1, 2), amount=1.0),
    _stopped("servo_deaf", "servo 1 does not answer", "servo 3 does not answer", deaf=(1, 2, 3), unknown=(1, 2, 3)),
    _stopped("servo_delay", "does not answer", unknown=(1, 2, 3), amount=0.1),
    _borne("servo_delay", BUS, "", 0.005),
    _stopped("servo_unplugged", "/servo", within=0.35, deaf=(1, 2, 3), unknown=(1, 2, 3)),
    _borne("servo_drop", BUS, "timeouts", 0.05),
    _stopped("servo_drop", "servo 3 does not answer", servo=3, unknown=(3,), amount=1.0),
    _borne("servo_corrupt", BUS, "corrupt", 0.05),
    _borne("servo_truncate", BUS, "corrupt", 0.05),
    _borne("servo_duplicate", BUS, "", 0.05),
    _borne("servo_garbage", BUS, "", 0.05),
)

_UNHEARD = Row("board_deaf", asked=("probe", "no answer"))

BOARD_ROWS = (
    Row("board_reboot", PADS, ("not tared",), opens=0.1, recovery=("tare",)),
    *(
        Row("board_trip", POWER, ("latched fault", name), opens=0.1, amount=code, recovery=("open",))
        for code, name in ((2.0, "short circuit"), (9.0, "over current"))
    ),
    Row("board_dead_taxel", PADS, ("dead taxel",), unknown=("taxel 44",), amount=44.0),
    Row("board_silent", LINK, ("no answer",), opens=0.45, unknown=("frames", "power")),
    Row("board_deaf", POWER, ("latched fault", "heartbeat lost"), opens=0.1, recovery=("open",), idle=_UNHEARD),
    _borne("board_delay", LINK, "", 0.03),
    Row("board_delay", PADS, ("no fresh frames",), opens=0.45, amount=0.4),
    Row(
        "board_unplugged",
        LINK,
        ("/board",),
        opens=0.15,
        unknown=("frames", "power"),
        recovery=("open",),
        idle=Row("board_unplugged", LINK, ("/board",), unknown=("frames", "power")),
    ),
    _borne("board_drop", LINK, "lost_tactile", 0.05),
    _borne("board_corrupt", LINK, "crc_errors", 0.05),
    _borne("board_truncate", LINK, "lost_tactile", 0.05),
    _borne("board_duplicate", LINK, "duplicates", 0.05),
    _borne("board_garbage", LINK, "cobs_errors", 0.05),
)
