# SPDX-License-Identifier: Apache-2.0
"""Emulated servos in virtual time: whatever waits for them advances their clock."""

from __future__ import annotations

from typing import Any, ClassVar

from deltacharger_driver import errors, ports
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

    def __init__(self, device: ports.ByteDevice, clock: Clock) -> None:
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

    def open_raw(self, path: str, baud_rate: int) -> Any:
        if not self.line.is_plugged:
            raise errors.PortMissing(path)
        self.line.baud_rate = baud_rate
        return LineBytes(self.line)

    def now(self) -> float:
        return self.line.clock.now

    def sleep(self, seconds: float) -> None:
        self.line.clock.sleep(seconds)


class LineBytes:
    """A `Line` with the methods of a `RawPort`."""

    def __init__(self, line: Line) -> None:
        self._line = line

    def set_speed(self, baud_rate: int) -> None:
        self._line.baud_rate = baud_rate

    def flush(self) -> None:
        if not self._line.is_plugged:
            raise errors.PortGone(self._line.path)
        self._line.arrived = b""

    def read(self, timeout: float) -> bytes:
        self._line.advance(max(timeout, 1e-6), until_bytes=True)
        data = self._line.arrived
        self.flush()
        return data

    def write(self, data: bytes) -> None:
        self._line.arrived = self._line.device.receive(data, self._line.clock.now)

    def close(self) -> None:
        pass
