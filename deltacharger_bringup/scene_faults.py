"""Faults that a scene orders from its emulated hardware, at a time after its start.

They are done by the emulators' own hooks, so the driver meets them where it would on the robot: on the wire.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from deltacharger_sim.parameters import Bounded, ParameterError, number

if TYPE_CHECKING:
    from deltacharger_driver.board_emulator import BoardEmulator
    from deltacharger_driver.pseudo_terminal import PseudoTerminal
    from deltacharger_driver.servo_emulator import ServoBusEmulator

_OVERLOAD = 32  # hardware error bit of the MX-64
_WIRE = ("drop", "corrupt", "truncate", "duplicate", "garbage")

KINDS: dict[str, str] = {
    "servo_missing": "servo `servo` loses its supply",
    "servo_overload": "servo `servo` reports overload and stops until it is rebooted",
    "servo_reboot": "servo `servo` restarts by itself",
    "servo_delay": "every reply of the servos comes `amount` s late",
    "servo_unplugged": "the servo port disappears",
    "board_reboot": "the board boots",
    "board_silent": "nothing leaves the board",
    "board_deaf": "nothing reaches the board",
    "board_trip": "the power stage opens with fault `amount` (a code of ChargerPower)",
    "board_unplugged": "the board's port disappears",
    **{f"servo_{kind}": f"a share `amount` of the servos' replies suffers: {kind}" for kind in _WIRE},
    **{f"board_{kind}": f"a share `amount` of the board's packets suffers: {kind}" for kind in _WIRE},
}
"""Every fault by name, with what it does."""


@dataclass(frozen=True)
class Fault(Bounded):
    """One fault."""

    kind: str = field(default="", metadata={"doc": "what happens: " + ", ".join(KINDS)})
    at: float = number(0.0, 0.0, 1e6, "s", "after the simulated charger's start")
    last: float = number(0.0, 0.0, 1e6, "s", "until it is over; 0 = for good")
    servo: int = number(2, 1, 3, "", "id, where it concerns one servo")
    amount: float = number(0.1, 0.0, 9.0, "", "share 0 to 1, s, or fault code, as its kind says")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind not in KINDS:
            raise ParameterError("kind", self.kind, f"{self.kind!r} is no fault; there are {', '.join(KINDS)}")
        if self.kind.split("_", 1)[1] in _WIRE and self.amount > 1.0:
            raise ParameterError("amount", self.amount, f"{self.amount!r} is not a share of 0 to 1")


@dataclass(frozen=True)
class Hardware:
    """What faults can befall: both emulators and the terminals that serve them."""

    servos: ServoBusEmulator
    board: BoardEmulator
    servo_terminal: PseudoTerminal
    board_terminal: PseudoTerminal


class FaultSchedule:
    """Carries out a scene's faults in time, from one thread that exists only where there are any.

    Args:
        faults: what to do.
        hardware: whom it befalls.
        clock: s, monotonic.
    """

    def __init__(self, faults: Sequence[Fault], hardware: Hardware, clock: Callable[[], float]) -> None:
        self._hardware = hardware
        self._clock = clock
        self._start = clock()
        events = [(fault.at, True, fault) for fault in faults]
        events += [(fault.at + fault.last, False, fault) for fault in faults if fault.last > 0.0]
        self._events = sorted(events, key=lambda event: event[0])
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        if self._events:
            self._thread = threading.Thread(target=self._run, name="scene faults", daemon=True)
            self._thread.start()

    def close(self) -> None:
        """Cause no more faults. Safe to call twice."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _run(self) -> None:
        for at, begins, fault in self._events:
            if self._stop.wait(max(self._start + at - self._clock(), 0.0)):
                return
            (_begin if begins else _end)(fault, self._hardware, self._clock)


def _begin(fault: Fault, hardware: Hardware, clock: Callable[[], float]) -> None:
    device, kind = fault.kind.split("_", 1)
    servos, board = hardware.servos, hardware.board
    actions: dict[str, Callable[[], Any]] = {
        "servo_missing": lambda: servos.faults.missing.add(fault.servo),
        "servo_overload": lambda: servos.raise_hardware_error(fault.servo, _OVERLOAD),
        "servo_reboot": lambda: servos.reboot(fault.servo, clock()),
        "servo_delay": lambda: setattr(servos.faults, "delay", fault.amount),
        "servo_unplugged": hardware.servo_terminal.unplug,
        "board_reboot": board.reboot,
        "board_silent": lambda: setattr(board.faults, "silent", True),
        "board_deaf": lambda: setattr(board.faults, "deaf", True),
        "board_trip": lambda: board.trip(round(fault.amount)),
        "board_unplugged": hardware.board_terminal.unplug,
    }
    if fault.kind in actions:
        actions[fault.kind]()
    elif device == "servo":
        servos.faults.rate[kind] = fault.amount
    else:
        board.faults.probability[kind] = fault.amount


def _end(fault: Fault, hardware: Hardware, clock: Callable[[], float]) -> None:
    device, kind = fault.kind.split("_", 1)
    servos, board = hardware.servos, hardware.board
    actions: dict[str, Callable[[], Any]] = {
        "servo_missing": lambda: servos.faults.missing.discard(fault.servo),
        "servo_delay": lambda: setattr(servos.faults, "delay", 0.0),
        "servo_unplugged": hardware.servo_terminal.replug,
        "board_silent": lambda: setattr(board.faults, "silent", False),
        "board_deaf": lambda: setattr(board.faults, "deaf", False),
        "board_unplugged": hardware.board_terminal.replug,
    }
    if fault.kind in actions:
        actions[fault.kind]()
    elif kind in _WIRE and device == "servo":
        servos.faults.rate.pop(kind, None)
    elif kind in _WIRE:
        board.faults.probability[kind] = 0.0
