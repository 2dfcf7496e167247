# SPDX-License-Identifier: Apache-2.0
"""A host that exchanges bytes with emulated servos, with its own clock."""

from __future__ import annotations

from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.packets import PING, instruction_packet

from ..plants import BenchArm


class Host:
    """Exchanges packets with an emulator, with its own clock."""

    def __init__(self) -> None:
        self.now = 100.0
        self.bus = ServoBusEmulator(BenchArm(clock=lambda: self.now))

    def advance(self, seconds: float) -> bytes:
        """Advance time as a pseudo-terminal does, and return received bytes."""
        end, received = self.now + seconds, b""
        while (wait := self.bus.next_event(self.now)) <= end - self.now:
            self.now += max(wait, 1e-6)
            received += self.bus.poll(self.now)
        self.now = end
        return received + self.bus.poll(end)

    def answers(self, servo: int) -> bool:
        """Return whether a servo answers a ping."""
        data = self.bus.receive(instruction_packet(servo, PING), self.now) + self.advance(0.002)
        return data[4:5] == bytes((servo,))
