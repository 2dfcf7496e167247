# SPDX-License-Identifier: Apache-2.0
"""A servo controller over emulated servos on a real pseudo-terminal; waiting for a condition runs its cycles."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from deltacharger_core.machine import TORQUE_CONSTANT
from deltacharger_driver.emulators.bench_arm import BenchArm
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.servos.controller import ServoController
from deltacharger_driver.servos.report import ServoReport
from deltacharger_driver.servos.requests import ServoRequest
from deltacharger_driver.servos.snapshot import BusSettings
from deltacharger_driver.servos.trajectory import JointLimits, ServoWaypoint, check

from ..waiting import DEADLINE

OVERLOAD = 1 << 5
BOUND = (0.83, 0.83, 0.83)
START = (-0.7, -0.5, 0.2)
NAMES = ("a", "b", "c")
LIMITS = JointLimits(NAMES, -1.2, 1.3, 4.4)
DEFAULT = 0.83


class Contactor:
    """A contactor that opens `delay` s after a request; it records the state of the arm then."""

    def __init__(self, arm: BenchArm) -> None:
        self.arm = arm
        self.delay = 0.0
        self.requests: list[float] = []
        self.opened_at = 0.0
        self.torque_when_opened: list[bool] | None = None

    def request_open(self) -> None:
        self.requests.append(time.monotonic())
        self.opened_at = self.requests[0] + self.delay

    def is_open(self) -> bool:
        if not self.requests or time.monotonic() < self.opened_at:
            return False
        if self.torque_when_opened is None:
            self.torque_when_opened = self.arm.torque_enabled()
        return True


class Rig:
    """A controller that cycles at 100 Hz while it waits for a condition."""

    def __init__(self, path: Path) -> None:
        self.arm = BenchArm(START)
        self.emulator = ServoBusEmulator(self.arm)
        self.terminal = PseudoTerminal(self.emulator, path).start()
        self.events: list[tuple[str, str]] = []
        self.controller = ServoController(
            BusSettings(self.terminal.path), DEFAULT, TORQUE_CONSTANT, lambda *event: self.events.append(event)
        )
        self.contactor = Contactor(self.arm)
        self.report: Any = None

    def cycle(self) -> ServoReport:
        self.report = self.controller.cycle()
        time.sleep(0.005)
        return self.report

    def until(self, condition: Callable[[ServoReport], Any], seconds: float = DEADLINE) -> Any:
        deadline = time.monotonic() + seconds
        while not (result := condition(self.cycle())):
            assert time.monotonic() < deadline, f"the condition did not become true; {self.report}"
        return result

    def ask(self, action: str) -> ServoRequest:
        request = self.controller.request(action)
        self.until(lambda report: request.wait(0.0))
        return request

    def wire_contactor(self) -> None:
        """Give the controller a contactor."""
        self.controller._contactor = self.contactor

    def torque_on(self) -> None:
        request = self.ask("torque_on")
        assert request.success, request.message

    def send(self, *rows: tuple[Any, ...]) -> None:
        self.controller.submit(check(NAMES, [ServoWaypoint(*row) for row in rows], LIMITS))

    def references(self) -> list[float]:
        return [command[1] for command in self.arm.commands]

    def bounds(self) -> list[float]:
        return [command[2] for command in self.arm.commands]

    def close(self) -> None:
        self.controller.close()
        self.terminal.stop()
