# SPDX-License-Identifier: Apache-2.0
"""A host that exchanges bytes with emulated servos, with its own clock."""

from __future__ import annotations

from typing import Any

from deltacharger_driver.emulators.servo import OK
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.packets import HEADER, READ, WRITE, crc16
from deltacharger_driver.servos.registers import REGISTERS

from ..plants import BenchArm


class Host:
    """Exchanges packets with an emulator, with its own clock."""

    def __init__(self, **kwargs: Any) -> None:
        self.now = 100.0
        self.arm = BenchArm(clock=lambda: self.now)
        self.bus = ServoBusEmulator(self.arm, **kwargs)
        for servo in (1, 2, 3):
            self.bus.servo(servo).table.set("return_delay", 0)

    def advance(self, seconds: float) -> bytes:
        """Advance time as a pseudo-terminal does, and return received bytes."""
        end, received = self.now + seconds, b""
        while (wait := self.bus.next_event(self.now)) <= end - self.now:
            self.now += max(wait, 1e-6)
            received += self.bus.poll(self.now)
        self.now = end
        return received + self.bus.poll(end)

    def send(self, servo: int, code: int, parameters: bytes = b"") -> bytes:
        return self.bus.receive(self.packet(servo, code, parameters), self.now)

    @staticmethod
    def packet(servo: int, code: int, parameters: bytes = b"") -> bytes:
        head = HEADER + bytes((servo,)) + (len(parameters) + 3).to_bytes(2, "little") + bytes((code,)) + parameters
        return head + crc16(head).to_bytes(2, "little")

    def ask(self, servo: int, code: int, parameters: bytes = b"") -> list[tuple[int, int, bytes]]:
        """Return (id, error, parameters) of each reply."""
        return parse(self.send(servo, code, parameters) or self.advance(0.002))

    def read(self, servo: int, name: str) -> int:
        register = REGISTERS[name]
        ((_, error, data),) = self.ask(servo, READ, words(register.address, register.size))
        assert error & 0x7F == OK
        return register.from_bytes(data)

    def write(self, servo: int, name: str, value: int, code: int = WRITE) -> int:
        register = REGISTERS[name]
        ((_, error, _),) = self.ask(servo, code, words(register.address) + register.to_bytes(value))
        return error & 0x7F


def words(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)


def parse(data: bytes) -> list[tuple[int, int, bytes]]:
    replies = []
    while data:
        assert data.startswith(HEADER)
        size = int.from_bytes(data[5:7], "little") + 7
        packet, data = data[:size], data[size:]
        assert crc16(packet[:-2]) == int.from_bytes(packet[-2:], "little")
        replies.append((packet[4], packet[8], packet[9:-2]))
    return replies
