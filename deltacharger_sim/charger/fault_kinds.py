# SPDX-License-Identifier: Apache-2.0
"""All kinds of faults of the emulated hardware, by name, with the affected servos and the amount.

Each kind uses the emulators' hooks, so the driver meets it as on the robot: on the wire.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from deltacharger_core.machine import JOINTS
from deltacharger_driver.ports import SPEEDS
from deltacharger_sim.target_rows import ROWS, usual

if TYPE_CHECKING:
    from deltacharger_driver.emulators.board import BoardEmulator
    from deltacharger_driver.emulators.servo import ServoFirmware
    from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
    from deltacharger_driver.ports import PseudoTerminal
    from deltacharger_sim.shared_world import SharedWorld

ONE, SOME = "one", "some"
"""Servos affected by a fault: one (default: the second), or several (default: all)."""
SERVOS = len(JOINTS)
_SPEEDS = {speed: value for value, speed in SPEEDS.items()}
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
Apply = Callable[[Hardware, FaultOrder], "Undo | None"]


@dataclass(frozen=True)
class Amount:
    """Meaning of a kind's `amount`.

    Attributes:
        name: with unit and range, e.g. "a share of 0 to 1".
        low, high: range.
        default: where none is given.
        choice: allowed values; empty = all from `low` to `high`.
        whole: whether only whole numbers are allowed.
    """

    name: str
    low: float
    high: float
    default: float
    choice: tuple[float, ...] = ()
    whole: bool = False

    def problem(self, value: float) -> str:
        """Return what is wrong with a value; '' = nothing."""
        fits = self.low <= value <= self.high and (not self.whole or float(value).is_integer())
        return "" if fits and (not self.choice or value in self.choice) else f"{value:.10g} is not {self.name}"


@dataclass(frozen=True)
class Kind:
    """One kind of fault.

    Attributes:
        text: description.
        apply: causes it, and returns the function that ends it.
        lasts: whether it lasts until it is ended; else it is momentary.
        servo: ONE, SOME, or '' if it affects no servo.
        amount: None if it has no amount.
        several: whether faults with different amounts may coexist.
    """

    text: str
    apply: Apply
    lasts: bool = True
    servo: str = ""
    amount: Amount | None = None
    several: bool = False


def _servo_share(kind: str, hardware: Hardware, order: FaultOrder) -> Undo:
    faults = hardware.servos.faults
    rates = faults.rate_of.setdefault(order.servo, {}) if order.servo else faults.rate
    rates[kind] = order.amount
    return lambda: rates.pop(kind, None)


def _board_share(kind: str, hardware: Hardware, order: FaultOrder) -> Undo:
    hardware.board.faults.probability[kind] = order.amount
    return functools.partial(hardware.board.faults.probability.__setitem__, kind, 0.0)


def _servo_missing(hardware: Hardware, order: FaultOrder) -> Undo:
    # Without supply, a servo loses its torque and later returns as after a restart.
    hardware.servos.alter(order.place, lambda servo: servo.reboot(order.now))
    hardware.servos.faults.missing.add(order.servo)
    return lambda: hardware.servos.faults.missing.discard(order.servo)


def _wire(device: str, name: str, hardware: Hardware, order: FaultOrder) -> Undo:
    """Delay the wire to "servos" or "board" by the amount, or block one direction."""
    faults = getattr(hardware, device).faults
    before = getattr(faults, name)
    setattr(faults, name, order.amount if name == "delay" else True)
    return lambda: setattr(faults, name, before)


def _servo_error(bit: int, hardware: Hardware, order: FaultOrder) -> None:
    hardware.servos.alter(order.place, lambda servo: servo.raise_error(1 << bit))


def _servo_reboot(hardware: Hardware, order: FaultOrder) -> None:
    hardware.servos.alter(order.place, lambda servo: servo.reboot(order.now))


def _servo_watchdog(hardware: Hardware, order: FaultOrder) -> None:
    hardware.servos.alter(order.place, lambda servo: servo.trip_watchdog(order.now))


def _servo_undervoltage(hardware: Hardware, order: FaultOrder) -> Undo:
    def limit(volts: float, servo: ServoFirmware) -> None:
        servo.supply_limit = volts

    hardware.servos.alter(order.place, functools.partial(limit, order.amount))
    return lambda: hardware.servos.alter(order.place, functools.partial(limit, math.inf))


def _servo_register(name: str, value: int, hardware: Hardware, order: FaultOrder) -> Undo:
    before = 0

    def change(servo: ServoFirmware) -> None:
        nonlocal before
        before = servo.table.get(name)
        servo.table.set(name, value)

    hardware.servos.alter(order.place, change)
    return lambda: hardware.servos.alter(order.place, lambda servo: servo.table.set(name, before))


def _servo_wrong_baud(hardware: Hardware, order: FaultOrder) -> Undo:
    return _servo_register("baud", _SPEEDS[round(order.amount)], hardware, order)


def _servo_duplicate_id(hardware: Hardware, order: FaultOrder) -> Undo:
    return _servo_register("id", round(order.amount), hardware, order)


def _unplugged(port: str, hardware: Hardware, order: FaultOrder) -> Undo:
    terminal: PseudoTerminal = getattr(hardware, f"{port}_terminal")
    terminal.unplug()
    return terminal.replug


def _board_reboot(hardware: Hardware, order: FaultOrder) -> None:
    hardware.board.reboot(order.amount)


def _board_trip(hardware: Hardware, order: FaultOrder) -> None:
    hardware.board.trip(round(order.amount))


def _board_dead_taxel(hardware: Hardware, order: FaultOrder) -> Undo:
    pad, taxel = divmod(round(order.amount), 100)
    place = (pad, *divmod(taxel, 10))
    hardware.board.set_dead(*place)
    return lambda: hardware.board.set_dead(*place, dead=False)


def _target_port(hardware: Hardware, order: FaultOrder) -> Undo:
    before = hardware.world.change_target(usual(list(ROWS.values())[round(order.amount) - 1].port))
    return lambda: hardware.world.change_target(before)


_DAMAGE = {
    "drop": "lost", "corrupt": "changed", "truncate": "cut short", "duplicate": "sent twice",
    "garbage": "preceded by noise",
}  # fmt: skip
_SHARE = Amount("a share of 0 to 1", 0.0, 1.0, 0.1)
_DELAY = Amount("a delay of 0 to 2 s", 0.0, 2.0, 0.05)
_VOLTS = Amount("a supply of 6 to 9.4 V", 6.0, 9.4, 9.0)
_SPEED = Amount(
    f"a speed in bit/s, {', '.join(map(str, _SPEEDS))}", min(_SPEEDS), max(_SPEEDS), 57600, choice=tuple(_SPEEDS)
)
_ID = Amount(f"an id of 1 to {SERVOS}", 1, SERVOS, 1, whole=True)
_CODE = Amount("a fault code of ChargerPower, 1 to 9", 1, 9, 9, whole=True)
_TAXEL = Amount("a taxel, 0 to 99 left and 100 to 199 right, row by row from the top", 0, 199, 44, whole=True)
_ROW = Amount(
    f"a row of 1 to {len(ROWS)}", 1, len(ROWS), 19, tuple(n for n, row in enumerate(ROWS.values(), 1) if row.port), True
)
_BOOT = Amount("a boot of 0 to 10 s", 0.0, 10.0, 0.0)

KINDS: dict[str, Kind] = {
    "servo_missing": Kind("the servo loses its supply, and with it torque and set-up", _servo_missing, servo=ONE),
    "servo_reboot": Kind("the servo restarts by itself", _servo_reboot, lasts=False, servo=ONE),
    **{
        f"servo_{name}": Kind(
            f"the servo reports the hardware error '{name}', until it is rebooted",
            functools.partial(_servo_error, bit),
            lasts=False,
            servo=ONE,
        )
        for name, bit in _HARDWARE_ERRORS.items()
    },
    "servo_undervoltage": Kind(
        "the servo's supply sags to `amount` V; its latched error remains",
        _servo_undervoltage,
        servo=ONE,
        amount=_VOLTS,
    ),
    "servo_watchdog": Kind("the servo stops as if commands no longer arrived", _servo_watchdog, lasts=False, servo=ONE),
    "servo_wrong_baud": Kind(
        "the servo listens at `amount` bit/s and ignores any other speed",
        _servo_wrong_baud,
        servo=ONE,
        amount=_SPEED,
    ),
    "servo_duplicate_id": Kind(
        "the servo takes the id `amount`, and replies of both collide", _servo_duplicate_id, servo=ONE, amount=_ID
    ),
    "servo_deaf": Kind(
        "nothing reaches the servos; they stop after 0.12 s", functools.partial(_wire, "servos", "deaf")
    ),
    "servo_delay": Kind(
        "every reply of the servos arrives `amount` s late", functools.partial(_wire, "servos", "delay"), amount=_DELAY
    ),
    "servo_unplugged": Kind("the servo port disappears", functools.partial(_unplugged, "servo")),
    **{
        f"servo_{name}": Kind(
            f"a share `amount` of the servos' replies is {text}",
            functools.partial(_servo_share, name),
            servo=SOME,
            amount=_SHARE,
        )
        for name, text in _DAMAGE.items()
    },
    "board_reboot": Kind("the board boots, in `amount` s", _board_reboot, lasts=False, amount=_BOOT),
    "board_trip": Kind("the power stage opens with fault `amount`", _board_trip, lasts=False, amount=_CODE),
    "board_dead_taxel": Kind("taxel `amount` dies", _board_dead_taxel, amount=_TAXEL, several=True),
    "board_silent": Kind("nothing leaves the board", functools.partial(_wire, "board", "silent")),
    "board_deaf": Kind("nothing reaches the board", functools.partial(_wire, "board", "deaf")),
    "board_delay": Kind(
        "every packet of the board arrives `amount` s late",
        functools.partial(_wire, "board", "delay"),
        amount=_DELAY,
    ),
    "board_unplugged": Kind("the board's port disappears", functools.partial(_unplugged, "board")),
    **{
        f"board_{name}": Kind(
            f"a share `amount` of the board's packets is {text}",
            functools.partial(_board_share, name),
            amount=_SHARE,
        )
        for name, text in _DAMAGE.items()
    },
    "target_port": Kind("the target's port behaves as row `amount` of docs/targets.md", _target_port, amount=_ROW),
}
"""Every fault by name."""
