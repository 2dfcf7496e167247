# SPDX-License-Identifier: Apache-2.0
"""Emulated servos in virtual time: whatever waits for them advances their clock."""

from __future__ import annotations

from typing import ClassVar

from deltacharger_driver.errors import PortGone, PortMissing
from deltacharger_driver.ports import ByteDevice
from deltacharger_driver.servos.link import ServoPort


class Clock:
    """Virtual time, s; it runs only while someone waits."""

    def __init__(self) -> None:
        self.now = 100.0
        self.line: Line | None = None

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        """Let time pass without a host."""
        if self.line is None:
            self.now += seconds
        else:
            self.line.advance(seconds)


class Line:
    """Connects a device to ports of the class `handler`, in place of a `PseudoTerminal`.

    Attributes:
        arrived: bytes that no port has read yet.
    """

    path = "the virtual line"

    def __init__(self, device: ByteDevice, clock: Clock) -> None:
        self.clock, self.device, self.arrived = clock, device, b""
        self.is_plugged, self.baud_rate = False, 0
        clock.line = self
        self.handler = type("LinePort", (LinePort,), {"line": self})

    def start(self) -> Line:
        self.is_plugged = True
        return self

    def stop(self) -> None:
        self.is_plugged = False

    def speed(self) -> int:
        return self.baud_rate

    def advance(self, seconds: float, until_bytes: bool = False) -> None:
        """Let time pass, at most until bytes arrive."""
        end = self.clock.now + seconds
        self.arrived += self.device.poll(self.clock.now)
        while not (until_bytes and self.arrived):
            wait = max(self.device.next_event(self.clock.now), 1e-6)
            self.clock.now = min(self.clock.now + wait, end)
            self.arrived += self.device.poll(self.clock.now)
            if self.clock.now >= end:
                return

    def __enter__(self) -> Line:
        return self.start()

    def __exit__(self, *exception: object) -> None:
        self.stop()


class LinePort(ServoPort):
    """The driver's port handler on a `Line`."""

    line: ClassVar[Line]

    def setupPort(self, cflag_baud: int) -> bool:
        if not self.line.is_plugged:
            raise PortMissing(self.port_name)
        self.line.baud_rate = cflag_baud
        self.is_open, self.is_using = True, False
        self.tx_time_per_byte = 10_000.0 / cflag_baud
        self.clearPort()
        return True

    def closePort(self) -> None:
        self._buffer.clear()
        self.is_open = self.is_using = False

    def clearPort(self) -> None:
        self._collect()
        self._buffer.clear()

    def writePort(self, packet: object) -> int:
        self._collect()
        data = bytes(packet)  # type: ignore[call-overload]
        self.line.arrived = self.line.device.receive(data, self.now())
        return len(data)

    def now(self) -> float:
        return self.line.clock.now

    def sleep(self, seconds: float) -> None:
        self.line.clock.sleep(seconds)

    def _wait(self, timeout: float) -> bool:
        before = len(self._buffer)
        self.line.advance(max(timeout, 1e-6), until_bytes=True)
        self._collect()
        return len(self._buffer) > before

    def _collect(self) -> None:
        """Buffer what arrived."""
        if not self.line.is_plugged:
            self.is_using = False
            self._buffer.clear()
            raise PortGone(self.port_name)
        self._buffer += self.line.arrived
        self.line.arrived = b""
