# SPDX-License-Identifier: Apache-2.0
"""Faults of the emulated hardware: all kinds by name, scheduled from the scene and on request while it runs.

Each kind uses the emulators' hooks, so the driver meets it as on the robot: on the wire.
"""

from __future__ import annotations

import functools
import heapq
import itertools
import logging
import math
import threading
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from deltacharger_core import machine, parameters, servo_types
from deltacharger_core.parameters import number, words
from deltacharger_sim.circuit import TARGET_KINDS, usual_port

if TYPE_CHECKING:
    from deltacharger_driver.ports import PseudoTerminal
    from deltacharger_sim.emulators.board import BoardEmulator
    from deltacharger_sim.emulators.servo import ServoFirmware
    from deltacharger_sim.emulators.servo_bus import ServoBusEmulator
    from deltacharger_sim.world import SharedWorld


ONE, SOME = "one", "some"
"""Servos affected by a fault: one (default: the second), or several (default: all)."""
SERVOS = len(machine.JOINTS)
_SPEEDS = {speed: value for value, speed in servo_types.SPEEDS.items()}
_HARDWARE_ERRORS = {"voltage": 0, "overheating": 2, "encoder": 3, "shock": 4, "overload": 5}  # bits of the MX-64


@dataclass(frozen=True)
class Hardware:
    """The affected hardware: both emulators, the terminals that serve them, and the world behind."""

    servos: ServoBusEmulator
    board: BoardEmulator
    servo_terminal: PseudoTerminal
    board_terminal: PseudoTerminal
    world: SharedWorld


@dataclass(frozen=True)
class FaultOrder:
    """One fault to cause: servo (1 to 3, 0 = all), amount in the kind's unit, time (s, monotonic)."""

    servo: int
    amount: float
    now: float

    @property
    def place(self) -> int:
        """Index of the servo on the bus."""
        return self.servo - 1


Undo = Callable[[], Any]


@dataclass(frozen=True)
class Amount:
    """Meaning of a kind's `amount`.

    Attributes:
        name: with unit and range, e.g. "a share of 0 to 1".
        default: where none is given.
        low, high: range.
        choice: allowed values; empty = all of the range.
    """

    name: str
    default: float
    low: float
    high: float
    choice: Collection[float] = ()

    def problem(self, value: float) -> str:
        """Return what is wrong with a value; '' = nothing."""
        fits = value in self.choice if self.choice else self.low <= value <= self.high
        return "" if fits else f"{value:.10g} is not {self.name}"


@dataclass(frozen=True)
class Kind:
    """One kind of fault.

    Attributes:
        text: description.
        apply: causes it, and returns the function that ends it.
        given: its further arguments.
        lasts: whether it lasts until it is ended; else it is momentary.
        servo: ONE, SOME, or '' if it affects no servo.
        amount: None if it has no amount.
        several: whether faults with different amounts may coexist.
    """

    text: str
    apply: Callable[..., Undo | None]
    given: tuple[Any, ...] = ()
    lasts: bool = True
    servo: str = ""
    amount: Amount | None = None
    several: bool = False


def _share(hardware: Hardware, order: FaultOrder, device: str, kind: str) -> Undo:
    """Damage the given share of the packets from "servos" or "board"."""
    faults = getattr(hardware, device).faults
    rates = faults.rate_of.setdefault(order.servo, {}) if order.servo else faults.rate
    rates[kind] = order.amount
    return lambda: rates.pop(kind, None)


def _servo_missing(hardware: Hardware, order: FaultOrder) -> Undo:
    # Without supply, a servo loses its torque and later returns as after a restart.
    hardware.servos.alter(order.place, lambda servo: servo.reboot(order.now))
    hardware.servos.faults.missing.add(order.servo)
    return lambda: hardware.servos.faults.missing.discard(order.servo)


def _wire(hardware: Hardware, order: FaultOrder, device: str, name: str) -> Undo:
    """Delay the wire to "servos" or "board" by the amount, or block one direction."""
    faults = getattr(hardware, device).faults
    before = getattr(faults, name)
    setattr(faults, name, order.amount if name == "delay" else True)
    return lambda: setattr(faults, name, before)


def _error(hardware: Hardware, order: FaultOrder, bit: int) -> None:
    hardware.servos.alter(order.place, lambda servo: servo.raise_error(1 << bit))


def _servo_moment(hardware: Hardware, order: FaultOrder, what: str) -> None:
    """Let a servo do something of itself: reboot, or trip its watchdog."""
    hardware.servos.alter(order.place, lambda servo: getattr(servo, what)(order.now))


def _servo_undervoltage(hardware: Hardware, order: FaultOrder) -> Undo:
    def limit(volts: float, servo: ServoFirmware) -> None:
        servo.supply_limit = volts

    hardware.servos.alter(order.place, functools.partial(limit, order.amount))
    return lambda: hardware.servos.alter(order.place, functools.partial(limit, math.inf))


def _register(hardware: Hardware, order: FaultOrder, name: str) -> Undo:
    """Set the register "baud" or "id" to what the amount means."""
    number, before = round(order.amount), []

    def change(servo: ServoFirmware) -> None:
        before.append(servo.table.get(name))
        servo.table.set(name, _SPEEDS[number] if name == "baud" else number)

    hardware.servos.alter(order.place, change)
    return lambda: hardware.servos.alter(order.place, lambda servo: servo.table.set(name, before[0]))


def _unplugged(hardware: Hardware, order: FaultOrder, port: str) -> Undo:
    terminal: PseudoTerminal = getattr(hardware, f"{port}_terminal")
    terminal.unplug()
    return terminal.replug


def _board_moment(hardware: Hardware, order: FaultOrder, what: str) -> None:
    """Let the board boot, or trip with a fault code."""
    getattr(hardware.board, what)(order.amount)


def _board_dead_taxel(hardware: Hardware, order: FaultOrder) -> Undo:
    pad, taxel = divmod(round(order.amount), 100)
    place = (pad, *divmod(taxel, 10))
    hardware.board.set_dead(*place)
    return lambda: hardware.board.set_dead(*place, dead=False)


def _target_port(hardware: Hardware, order: FaultOrder) -> Undo:
    before = hardware.world.change_target(usual_port(round(order.amount)))
    return lambda: hardware.world.change_target(before)


_DAMAGE = {
    "drop": "lost", "corrupt": "changed", "truncate": "cut short", "duplicate": "sent twice",
    "garbage": "preceded by noise",
}  # fmt: skip
_IDS = range(1, SERVOS + 1)
_SHARE = Amount("a share of 0 to 1", 0.1, 0.0, 1.0)
_DELAY = Amount("a delay of 0 to 2 s", 0.05, 0.0, 2.0)
_VOLTS = Amount("a supply of 6 to 9.4 V", 9.0, 6.0, 9.4)
_SPEED = Amount(f"a speed in bit/s, {', '.join(map(str, _SPEEDS))}", 57600, min(_SPEEDS), max(_SPEEDS), _SPEEDS)
_ID = Amount(f"an id of 1 to {SERVOS}", 1, 1, SERVOS, _IDS)
_CODE = Amount("a fault code of ChargerPower, 1 to 9", 9, 1, 9, range(1, 10))
_TAXEL = Amount("a taxel, 0 to 99 left and 100 to 199 right, row by row from the top", 44, 0, 199, range(200))
_PORTS = [number for number, kind in enumerate(TARGET_KINDS.values(), 1) if "port" in kind]
_ROW = Amount(f"a kind of 1 to {len(TARGET_KINDS)}", 19, 1, len(TARGET_KINDS), _PORTS)
_BOOT = Amount("a boot of 0 to 10 s", 0.0, 0.0, 10.0)

KINDS: dict[str, Kind] = {
    "servo_missing": Kind("the servo loses its supply, and with it torque and set-up", _servo_missing, servo=ONE),
    "servo_reboot": Kind("the servo restarts by itself", _servo_moment, ("reboot",), False, ONE),
    **{
        f"servo_{name}": Kind(f"the servo reports the error '{name}', until it is rebooted", _error, (bit,), False, ONE)
        for name, bit in _HARDWARE_ERRORS.items()
    },
    "servo_undervoltage": Kind(
        "the servo's supply sags to `amount` V; its latched error remains", _servo_undervoltage, (), True, ONE, _VOLTS
    ),
    "servo_watchdog": Kind(
        "the servo stops as if commands no longer arrived", _servo_moment, ("trip_watchdog",), False, ONE
    ),
    "servo_wrong_baud": Kind(
        "the servo listens at `amount` bit/s and ignores any other speed", _register, ("baud",), True, ONE, _SPEED
    ),
    "servo_duplicate_id": Kind(
        "the servo takes the id `amount`, and replies of both collide", _register, ("id",), True, ONE, _ID
    ),
    "servo_deaf": Kind("nothing reaches the servos; they stop after 0.26 s", _wire, ("servos", "deaf")),
    "servo_delay": Kind("replies of the servos arrive `amount` s late", _wire, ("servos", "delay"), amount=_DELAY),
    "servo_unplugged": Kind("the servo port disappears", _unplugged, ("servo",)),
    "board_reboot": Kind("the board boots, in `amount` s", _board_moment, ("reboot",), False, amount=_BOOT),
    "board_trip": Kind("the power stage opens with fault `amount`", _board_moment, ("trip",), False, amount=_CODE),
    "board_dead_taxel": Kind("taxel `amount` dies", _board_dead_taxel, amount=_TAXEL, several=True),
    "board_silent": Kind("nothing leaves the board", _wire, ("board", "silent")),
    "board_deaf": Kind("nothing reaches the board", _wire, ("board", "deaf")),
    "board_delay": Kind("packets of the board arrive `amount` s late", _wire, ("board", "delay"), amount=_DELAY),
    "board_unplugged": Kind("the board's port disappears", _unplugged, ("board",)),
    "target_port": Kind(
        "the target's port behaves as kind `amount` of config/target_kinds.yaml", _target_port, amount=_ROW
    ),
    **{
        f"{device}_{name}": Kind(f"a share `amount` of {whose} is {text}", _share, (to, name), True, servo, _SHARE)
        for device, to, whose, servo in (
            ("servo", "servos", "the servos' replies", SOME),
            ("board", "board", "the board's packets", ""),
        )
        for name, text in _DAMAGE.items()
    },
}
"""Every fault by name."""


_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Fault(parameters.Bounded):
    """One fault."""

    kind: str = words("", "one of " + ", ".join(KINDS))
    at: float = number(0.0, 0.0, 1e6, "s", "after the simulated charger's start")
    last: float = number(0.0, 0.0, 1e6, "s", "until it is over; 0 = for good")
    servo: int = number(0, 0, SERVOS, "", "id; 0 = servo 2 for a fault of one servo, all for a fault of several")
    amount: float | None = number(
        None, -math.inf, math.inf, "", "share 0 to 1, s, V, bit/s, id, taxel or fault code, depending on kind"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind not in KINDS:
            raise parameters.ParameterError(
                "kind", self.kind, f"unknown fault {self.kind!r}: give one of {', '.join(KINDS)}"
            )
        kind = KINDS[self.kind]
        if self.last and not kind.lasts:
            raise parameters.ParameterError("last", self.last, f"{self.kind} is momentary: leave out its duration")
        if self.servo and not kind.servo:
            raise parameters.ParameterError(
                "servo", self.servo, f"{self.kind} does not affect a single servo: leave out servo"
            )
        self._check_amount(kind)

    def _check_amount(self, kind: Kind) -> None:
        if self.amount is None:
            problem = ""
        elif kind.amount is None:
            problem = f"{self.kind} takes no amount"
        else:
            problem = kind.amount.problem(self.amount)
        if not problem and self.kind == "servo_duplicate_id" and self.whom == self.how_much:
            problem = f"servo {self.whom} already has that id: give another amount or servo"
        if problem:
            raise parameters.ParameterError("amount", self.amount, problem)

    @property
    def whom(self) -> int:
        """The affected servo, 0 = none in particular."""
        return self.servo or (2 if KINDS[self.kind].servo == ONE else 0)

    @property
    def how_much(self) -> float:
        """Its amount: the given one, else the kind's default; 0 if the kind has none."""
        amount = KINDS[self.kind].amount
        if self.amount is not None:
            return self.amount
        return 0.0 if amount is None else amount.default

    @property
    def key(self) -> tuple[str, int, float]:
        """Identifies a fault; a new fault replaces an active one with the same key."""
        return self.kind, self.whom, self.how_much if KINDS[self.kind].several else 0.0


@dataclass(frozen=True)
class _Active:
    fault: Fault
    undo: Undo
    until: float  # s on the clock; inf = until it is cleared


class Faults:
    """Causes and ends faults; thread-safe. Its thread exists only while an event is scheduled.

    An error in that thread is logged with the fault's kind; other faults continue as scheduled.

    Args:
        scheduled: faults of the scene, at times after now.
        hardware: to affect.
        clock: s, monotonic.
    """

    def __init__(self, scheduled: Sequence[Fault], hardware: Hardware, clock: Callable[[], float]) -> None:
        self._hardware = hardware
        self._clock = clock
        self._condition = threading.Condition(threading.RLock())
        self._active: dict[tuple[str, int, float], _Active] = {}
        self._later: list[tuple[float, int, str, Callable[[], None]]] = []
        self._numbers = itertools.count()
        self._stopping = False
        self._thread: threading.Thread | None = None
        start = clock()
        for fault in scheduled:
            self._plan(start + fault.at, fault.kind, functools.partial(self.begin_fault, fault))

    def begin_fault(self, fault: Fault) -> None:
        """Cause a fault now, regardless of its `at`; it ends after its `last`, or with `clear`."""
        kind = KINDS[fault.kind]
        with self._condition:
            self._end(fault.key)
            now = self._clock()
            undo = kind.apply(self._hardware, FaultOrder(fault.whom, fault.how_much, now), *kind.given)
            if undo is None:
                return
            until = now + fault.last if fault.last else float("inf")
            active = self._active[fault.key] = _Active(fault, undo, until)
            if fault.last:
                self._plan(until, f"the end of {fault.kind}", lambda: self._end(fault.key, active))

    def clear(self) -> None:
        """End all lasting faults; latched errors remain for the driver to clear."""
        with self._condition:
            for key in reversed(list(self._active)):
                self._end(key)

    def active(self) -> list[dict[str, Any]]:
        """Return the lasting faults: kind, servo and amount (None = has none), remaining_s (None = unlimited)."""
        with self._condition:
            now = self._clock()
            return [
                {
                    "kind": each.fault.kind,
                    "servo": each.fault.whom or None,
                    "amount": each.fault.how_much if KINDS[each.fault.kind].amount else None,
                    "remaining_s": max(each.until - now, 0.0) if each.fault.last else None,
                }
                for each in self._active.values()
            ]

    def close(self) -> None:
        """Cause no further faults. Safe to call twice."""
        with self._condition:
            self._stopping = True
            self._condition.notify_all()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _end(self, key: tuple[str, int, float], only: _Active | None = None) -> None:
        with self._condition:
            active = self._active.get(key)
            if active is not None and only in (None, active):
                del self._active[key]
                active.undo()

    def _plan(self, at: float, what: str, action: Callable[[], None]) -> None:
        with self._condition:
            heapq.heappush(self._later, (at, next(self._numbers), what, action))
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="faults", daemon=True)
                self._thread.start()
            self._condition.notify_all()

    def _run(self) -> None:
        with self._condition:
            while not self._stopping:
                wait = self._later[0][0] - self._clock() if self._later else None
                if wait is None or wait > 0.0:
                    self._condition.wait(wait)
                else:
                    self._do(*heapq.heappop(self._later)[2:])

    def _do(self, what: str, action: Callable[[], None]) -> None:
        try:
            action()
        except Exception:  # an impossible fault must not stop the others
            _log.exception("simulated fault failed: %s", what)
