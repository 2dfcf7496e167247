# SPDX-License-Identifier: Apache-2.0
"""Devices of the contract: emulated ones behind pseudo-terminals, or real ones on their ports.

A site states how to reach a device and what is known of it; tests use nothing else.
"""

import contextlib
import math
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from deltacharger_core.servo_types import MX_64, ServoType
from deltacharger_driver import parameters, ports
from deltacharger_driver.servos.registers import BusSettings
from deltacharger_sim.emulators import board, servo_bus

from ...plants import BenchArm, BenchPlant

DEAD_TAXEL = (0, 3, 4)  # pad, row, column of the one that every emulated board has
LOAD = 2.0  # ohm between an emulated board's electrodes once a load is connected
_LARGEST_CURRENT = 3.0  # A
_EMULATOR_MARGIN = 0.5  # s until a reply counts as lost


@dataclass(frozen=True)
class ServoSite:
    """Three servos on a port.

    Attributes:
        path: of the port.
        real: whether it was given with --port.
        kind: type of the servos.
    """

    path: str
    real: bool
    kind: ServoType = MX_64

    @property
    def settings(self) -> BusSettings:
        """Wiring and mounting of the drawing; an emulator on the tests' computer gets more time than a servo."""
        margin = parameters.REPLY_MARGIN if self.real else _EMULATOR_MARGIN
        return BusSettings(self.path, reply_margin=margin, current_max=min(_LARGEST_CURRENT, self.kind.stall_current))


@dataclass(frozen=True)
class BoardSite:
    """A board on a port.

    Attributes:
        path: of the port.
        real: whether it was given with --port.
        dead: (pad, row, column) of its dead taxels; None if unknown.
        connect_load: connects a load to the electrodes; on a real board it is connected beforehand.
    """

    path: str
    real: bool
    dead: frozenset[tuple[int, int, int]] | None = None
    connect_load: Callable[[], object] = lambda: None


@contextlib.contextmanager
def emulated_servos(kind: ServoType = MX_64) -> Iterator[ServoSite]:
    """Serve emulated servos; their arms have different angles, so that they cannot be confused."""
    emulator = servo_bus.ServoBusEmulator(BenchArm((-0.7, -0.5, 0.2), torque_constant=kind.torque_constant), kind=kind)
    with ports.PseudoTerminal(emulator) as terminal:
        emulator.line_speed = terminal.speed
        yield ServoSite(terminal.path, real=False, kind=kind)
    assert terminal.error is None


@contextlib.contextmanager
def emulated_board() -> Iterator[BoardSite]:
    """Serve an emulated board whose electrodes touch nothing."""
    plant = BenchPlant()
    plant.resistance = math.inf
    emulator = board.BoardEmulator(plant)
    emulator.set_dead(*DEAD_TAXEL)
    with ports.PseudoTerminal(emulator) as terminal:
        yield BoardSite(terminal.path, False, frozenset({DEAD_TAXEL}), lambda: setattr(plant, "resistance", LOAD))
    assert terminal.error is None


@contextlib.contextmanager
def firmware_board(program: Path, port: Path) -> Iterator[BoardSite]:
    """Run the firmware's host program as `emulated_board`."""
    process = subprocess.Popen(
        [program, "--pty", str(port)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )

    def command(line: str) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(line + "\n")
        process.stdin.flush()
        assert process.stdout.readline() == "ok\n"

    try:
        assert process.stdout is not None
        assert process.stdout.readline() == f"ready {port}\n"
        command("resistance inf")
        command(f"dead {' '.join(map(str, DEAD_TAXEL))} 1")
        yield BoardSite(str(port), False, frozenset({DEAD_TAXEL}), lambda: command(f"resistance {LOAD}"))
        _, errors = process.communicate("quit\n", timeout=10.0)
        assert (process.returncode, errors) == (0, "")
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()
