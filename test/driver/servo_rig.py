# SPDX-License-Identifier: Apache-2.0
"""A servo controller over emulated servos; waiting for a condition runs its cycles."""

from collections.abc import Callable
from typing import Any

from deltacharger_driver.servos import bus, controller, motion, registers
from deltacharger_sim.emulators.servo_bus import ServoBusEmulator

from ..plants import BenchArm
from ..waiting import DEADLINE

OVERLOAD = 1 << 5
BOUND = (0.83, 0.83, 0.83)
START = (-0.7, -0.5, 0.2)
NAMES = ("a", "b", "c")
LIMITS = motion.JointLimits(NAMES, -1.2, 1.3, 4.4)
DEFAULT = 0.83


class Rig:
    """A controller, and a contactor that opens `delay` s after a request and records the arm's torque then."""

    def __init__(self, arm: BenchArm, emulator: ServoBusEmulator, line: Any, clock: Any, **settings: Any) -> None:
        self.arm, self.emulator, self.line, self.clock = arm, emulator, line, clock
        self.events: list[tuple[str, str]] = []
        self.requests: list[float] = []
        self.delay = 0.0
        self.torque_when_opened: list[bool] | None = None
        self.controller = controller.ServoController(
            registers.BusSettings(line.path, **settings),
            lambda *event: self.events.append(event),
            self,
            line.handler,
        )
        self.report: Any = None

    def request_open(self) -> None:
        self.requests.append(self.clock())

    def is_open(self) -> bool:
        if not self.requests or self.clock() < self.requests[0] + self.delay:
            return False
        self.torque_when_opened = self.torque_when_opened or self.arm.torque_enabled()
        return True

    def cycle(self) -> bus.ServoReport:
        self.report = self.controller.cycle()
        self.clock.sleep(0.005)
        return self.report

    def until(self, condition: Callable[[bus.ServoReport], Any]) -> Any:
        deadline = self.clock() + DEADLINE
        while not (result := condition(self.cycle())):
            assert self.clock() < deadline, f"the condition did not become true; {self.report}"
        return result

    def pause(self) -> None:
        """Send nothing until the watchdogs have tripped, as if this thread got no processor."""
        while any(
            self.emulator.servo(each).table.get("bus_watchdog") != registers.WATCHDOG_TRIPPED for each in (1, 2, 3)
        ):
            self.clock.sleep(0.05)

    def ask(self, action: str) -> controller.ServoRequest:
        request = self.controller.request(action)
        self.until(lambda report: request.wait(0.0))
        return request

    def torque_on(self) -> None:
        request = self.ask("torque_on")
        assert request.success, request.message

    def send(self, *rows: tuple[Any, ...], start: float | None = None) -> None:
        trajectory = motion.check(NAMES, [motion.ServoWaypoint(*row) for row in rows], LIMITS)
        self.controller.submit(trajectory, *([] if start is None else [start]))

    def references(self) -> list[float]:
        return [command[1] for command in self.arm.commands]

    def bounds(self) -> list[float]:
        return [command[2] for command in self.arm.commands]
