# SPDX-License-Identifier: Apache-2.0
"""The servos' bus on the emulated board: bytes in packets of the board link, at the speed that the host sets."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from deltacharger_core.machine import BAUD_RATE
from deltacharger_driver.board.protocol import LONGEST_SERVO, MINOR, SERVO_MINOR, AckError

if TYPE_CHECKING:
    from deltacharger_driver.pseudo_terminal import ByteDevice

SLOWEST, FASTEST = 9600, 4_500_000  # bit/s that SERVO_SPEED accepts


class BoardServos:
    """The board's end of the servos' bus.

    What comes from the bus is dropped until the host has sent something since the boot: an older host gets none of it.

    Args:
        bus: the servos; None = the board has no such bus.

    Attributes:
        speed: of the bus, bit/s.
    """

    def __init__(self, bus: ByteDevice | None) -> None:
        self._bus = bus
        self.reset()

    def __bool__(self) -> bool:
        """Whether there is a bus."""
        return self._bus is not None

    @property
    def minor(self) -> int:
        """The minor version that a board with this bus speaks."""
        return MINOR if self._bus is None else SERVO_MINOR

    def reset(self) -> None:
        """Forget what came, as a boot does."""
        self.speed = BAUD_RATE
        self._is_asked = False
        self._came = b""

    def set_speed(self, speed: int) -> AckError:
        """Speak at another speed, bit/s, where the board has it."""
        if not SLOWEST <= speed <= FASTEST:
            return AckError.BAD_PAYLOAD
        self.speed, self._came = speed, b""
        return AckError.DONE

    def send(self, data: bytes, now: float) -> None:
        """Send bytes of the host to the servos."""
        self._is_asked = True
        if self._bus is not None:
            self._came += self._bus.receive(data, now)

    def take(self, now: float) -> list[bytes]:
        """Return what has come from the servos, cut into pieces of a packet."""
        if self._bus is not None:
            self._came += self._bus.poll(now)
        came, self._came = self._came if self._is_asked else b"", b""
        return [came[at : at + LONGEST_SERVO] for at in range(0, len(came), LONGEST_SERVO)]

    def next_event(self, now: float) -> float:
        """Return the seconds until `take` has something; inf for never."""
        if self._bus is None:
            return math.inf
        return 0.0 if self._came else self._bus.next_event(now)
