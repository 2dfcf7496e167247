# SPDX-License-Identifier: Apache-2.0
"""Emulated servos, an emulated board and another device, each behind a real pseudo-terminal.

A conftest.py imports these fixtures for the tests beside it.
"""

import math
from collections.abc import Iterator

import pytest

from deltacharger_driver.ports import PseudoTerminal
from deltacharger_driver.servos.registers import REGISTERS
from deltacharger_sim.emulators.board import BoardEmulator
from deltacharger_sim.emulators.servo_bus import ServoBusEmulator

from .plants import BenchArm, BenchPlant

IDS = (1, 2, 3)


class Babbler:
    """A device that always sends the same answer, None: what it received; b"" is an open cable."""

    def __init__(self, answer: bytes | None = None) -> None:
        self._answer, self.received = answer, b""

    def receive(self, data: bytes, now: float) -> bytes:
        self.received += data
        return data if self._answer is None else self._answer

    def poll(self, now: float) -> bytes:
        return b""

    def next_event(self, now: float) -> float:
        return math.inf


def use_protocol_1(servos: ServoBusEmulator, servo: int) -> None:
    """Give a servo old firmware, which answers a ping and a read of its model number in Protocol 1.0."""
    receive = servos.receive
    servos.faults.missing.add(servo)

    def receive_both(data: bytes, now: float) -> bytes:
        replies = receive(data, now)
        for code, parameters, answer in ((1, b"", b""), (2, b"\0\2", (310).to_bytes(2, "little"))):
            if _packet_1(servo, code, parameters) in data:
                replies += _packet_1(servo, 0, answer)
        return replies

    servos.receive = receive_both  # type: ignore[method-assign]


def _packet_1(servo: int, code: int, parameters: bytes) -> bytes:
    body = bytes((servo, len(parameters) + 2, code)) + parameters
    return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))


def written(servos: ServoBusEmulator) -> dict[tuple[int, str], int]:
    """Every writable register of each servo."""
    return {
        (servo, name): servos.servo(servo).table.get(name)
        for servo in IDS
        for name, register in REGISTERS.items()
        if register.writable
    }


@pytest.fixture
def servos() -> ServoBusEmulator:
    return ServoBusEmulator(BenchArm())


@pytest.fixture
def servo_port(servos: ServoBusEmulator) -> Iterator[str]:
    with PseudoTerminal(servos) as terminal:
        servos.line_speed = terminal.speed
        yield terminal.path


@pytest.fixture
def board() -> BoardEmulator:
    return BoardEmulator(BenchPlant(), seed=1)


@pytest.fixture
def board_port(board: BoardEmulator) -> Iterator[str]:
    with PseudoTerminal(board) as terminal:
        yield terminal.path


@pytest.fixture
def one_cable(servos: ServoBusEmulator) -> Iterator[str]:
    """The port of a board with connected servos."""
    carrier = BoardEmulator(BenchPlant(), servos=servos)
    servos.line_speed = lambda: carrier.servos.speed
    with PseudoTerminal(carrier) as terminal:
        yield terminal.path


@pytest.fixture
def silent_port() -> Iterator[str]:
    with PseudoTerminal(Babbler(b"")) as terminal:
        yield terminal.path
