# SPDX-License-Identifier: Apache-2.0
"""Required behaviour under every fault: one row each, for moving, pressing and charging.

The limits are those of docs/docking.md. A board without packets opens within 0.1 s. The contactor's holder releases it
within 0.35 s (lease and heartbeat), plus the time to notice the fault: 0.1 s for frames and latched errors, 0.2 s for a
servo that does not answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from .fault_bench import Phase

BUS, LINK, PADS, POWER = "servo bus", "board link", "tactile arrays", "power stage"
NEVER = 0.0


@dataclass(frozen=True)
class Row:
    """Effects of one fault.

    Attributes:
        kind, servo, amount: the fault, as for `deltacharger fault`.
        part: name of the diagnostic that reports it.
        warning: words of its warning; empty if the fault is tolerated and only counted.
        counted: name of its counter.
        opens: s within which a closed contactor opens; NEVER = it stays closed.
        torque_off: whether the servos' torque is switched off.
        at_once: servos that lose their torque by the fault itself; no driver can open the contactor before that.
        deaf: servos that cannot receive commands during the fault; their own watchdog stops them.
        unknown: values unknown during it: servo ids (their floats are NaN), "frames" and "power" (these topics are
            silent) or "taxel 44".
        asked: a service that refuses during it, with words of its response; nothing else reports the fault.
        recovery: services that a person calls after it, in this order, in addition to set_torque and probe.
        idle: differences while the contactor is open.
    """

    kind: str
    part: str = BUS
    warning: tuple[str, ...] = ()
    counted: str = ""
    opens: float = NEVER
    torque_off: bool = False
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
        """Name in the list of tests."""
        return self.kind if self.amount is None else f"{self.kind}-{self.amount:g}"

    def at(self, phase: Phase) -> Row:
        """Return its effects in a phase."""
        return self if phase is Phase.CHARGING or self.idle is None else self.idle


def _stopped(kind: str, *warning: str, within: float = 0.35 + 0.2, **others: object) -> Row:
    """Return the row of a servo fault that stops all three."""
    return replace(Row(kind, warning=warning, opens=within, torque_off=True), **others)  # type: ignore[arg-type]


def _latched(kind: str, error: str, **others: object) -> Row:
    """Return the row of a hardware error that only a reboot clears."""
    return _stopped(kind, f"servo 2 has latched: {error}", within=0.1, recovery=("reboot_servos",), **others)


def _tolerated(kind: str, part: str, counted: str, amount: float) -> Row:
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
    _tolerated("servo_delay", BUS, "", 0.005),
    _stopped("servo_unplugged", "/servo", within=0.35, deaf=(1, 2, 3), unknown=(1, 2, 3)),
    _tolerated("servo_drop", BUS, "timeouts", 0.05),
    _stopped("servo_drop", "servo 3 does not answer", servo=3, unknown=(3,), amount=1.0),
    _tolerated("servo_corrupt", BUS, "corrupt", 0.05),
    _tolerated("servo_truncate", BUS, "corrupt", 0.05),
    _tolerated("servo_duplicate", BUS, "", 0.05),
    _tolerated("servo_garbage", BUS, "", 0.05),
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
    _tolerated("board_delay", LINK, "", 0.03),
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
    _tolerated("board_drop", LINK, "lost_tactile", 0.05),
    _tolerated("board_corrupt", LINK, "crc_errors", 0.05),
    _tolerated("board_truncate", LINK, "lost_tactile", 0.05),
    _tolerated("board_duplicate", LINK, "duplicates", 0.05),
    _tolerated("board_garbage", LINK, "cobs_errors", 0.05),
)
