# SPDX-License-Identifier: Apache-2.0
"""Emulated servos in virtual time or behind real pseudo-terminals, and their hosts."""

from collections.abc import Iterator
from typing import Any

import pytest

from deltacharger_core.servo_types import MX_64, ServoType
from deltacharger_driver.ports import PseudoTerminal
from deltacharger_driver.servos.bus import ServoBus
from deltacharger_driver.servos.link import ServoLink
from deltacharger_driver.servos.registers import BusSettings
from deltacharger_sim.emulators.servo_bus import ServoBusEmulator

from ..emulated_ports import board, board_port, one_cable, servo_port, servos
from ..plants import BenchArm
from .servo_rig import START, Rig
from .virtual_line import Clock, Line

__all__ = ("board", "board_port", "one_cable", "servo_port", "servos")


@pytest.fixture
def clock() -> Any:
    return Clock()


@pytest.fixture
def kind() -> ServoType:
    """Type of the servos."""
    return MX_64


@pytest.fixture
def arm(clock: Any, kind: ServoType) -> BenchArm:
    return BenchArm(START, clock, kind.torque_constant)


@pytest.fixture
def emulator(arm: BenchArm, kind: ServoType) -> ServoBusEmulator:
    return ServoBusEmulator(arm, kind=kind)


@pytest.fixture
def line(emulator: ServoBusEmulator, clock: Any) -> Iterator[Any]:
    with Line(emulator, clock) as line:
        yield line


@pytest.fixture
def terminal(emulator: ServoBusEmulator) -> Iterator[PseudoTerminal]:
    with PseudoTerminal(emulator) as terminal:
        emulator.line_speed = terminal.speed  # one that answers late would else answer at a speed that it has not
        yield terminal


@pytest.fixture
def link(line: Any) -> Iterator[ServoLink]:
    link = ServoLink(line.path, 1_000_000, handler=line.handler)
    link.open()
    yield link
    link.close()


@pytest.fixture
def closed(line: Any) -> Iterator[ServoBus]:
    """A bus that a test opens itself."""
    bus = ServoBus(BusSettings(line.path), line.handler)
    yield bus
    bus.close()


@pytest.fixture
def bus(closed: ServoBus) -> ServoBus:
    closed.open()
    return closed


@pytest.fixture
def rig(arm: BenchArm, emulator: ServoBusEmulator, line: Any, clock: Any) -> Iterator[Rig]:
    rig = Rig(arm, emulator, line, clock)
    rig.controller.open()
    yield rig
    rig.controller.close()
