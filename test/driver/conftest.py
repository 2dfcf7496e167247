# SPDX-License-Identifier: Apache-2.0
"""Emulated servos behind real pseudo-terminals, and their hosts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from deltacharger_driver.emulators.bench_arm import BenchArm
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.servos.bus import ServoBus
from deltacharger_driver.servos.link import ServoLink
from deltacharger_driver.servos.snapshot import BusSettings

from ..emulated_ports import board, board_port, servo_port, servos
from .servo_host import Host
from .servo_rig import Rig

__all__ = ("board", "board_port", "servo_port", "servos")


@pytest.fixture
def host() -> Host:
    return Host()


@pytest.fixture
def arm() -> BenchArm:
    return BenchArm((-0.7, -0.5, 0.2))


@pytest.fixture
def emulator(arm: BenchArm) -> ServoBusEmulator:
    return ServoBusEmulator(arm)


@pytest.fixture
def terminal(emulator: ServoBusEmulator) -> Iterator[PseudoTerminal]:
    with PseudoTerminal(emulator) as terminal:
        yield terminal


@pytest.fixture
def link(terminal: PseudoTerminal) -> Iterator[ServoLink]:
    link = ServoLink(terminal.path, 1_000_000)
    link.open()
    yield link
    link.close()


@pytest.fixture
def closed(terminal: PseudoTerminal) -> Iterator[ServoBus]:
    """A bus that a test opens itself."""
    bus = ServoBus(BusSettings(terminal.path))
    yield bus
    bus.close()


@pytest.fixture
def bus(closed: ServoBus) -> ServoBus:
    closed.open()
    return closed


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    rig = Rig(tmp_path / "servo")
    rig.controller.open()
    yield rig
    rig.close()
