# SPDX-License-Identifier: Apache-2.0
"""The servos' bus on the emulated board: its bytes in packets of the board link, at the speed set by the host."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from deltacharger_core.machine import BAUD_RATE
from deltacharger_driver.board.protocol import LONGEST_SERVO, MINOR, SERVO_MINOR, AckError

if TYPE_CHECKING:
    from deltacharger_driver.pseudo_terminal import ByteDevice

SLOWEST, FASTEST = 9600, 4_500_000  # bit/s, range of SERVO_SPEED


class BoardServos:
    """The board's end of the servos' bus.

    Bytes from the bus are dropped until the host has sent a SERVO packet since the boot: an older host gets none.

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
        """Minor protocol version of a board with this bus."""
        return MINOR if self._bus is None else SERVO_MINOR

    def reset(self) -> None:
        """Discard received bytes, as a boot does."""
        self.speed = BAUD_RATE
        self._host_has_sent = False
        self._received = b""

    def set_speed(self, speed: int) -> AckError:
        """Set the speed, bit/s, if the board supports it."""
        if not SLOWEST <= speed <= FASTEST:
            return AckError.BAD_PAYLOAD
        self.speed, self._received = speed, b""
        return AckError.DONE

    def send(self, data: bytes, now: float) -> None:
        """Send bytes of the host to the servos."""
        self._host_has_sent = True
        if self._bus is not None:
            self._received += self._bus.receive(data, now)

    def take(self, now: float) -> list[bytes]:
        """Return the bytes from the servos, cut into pieces that fit a packet."""
        if self._bus is not None:
            self._received += self._bus.poll(now)
        received, self._received = self._received if self._host_has_sent else b"", b""
        return [received[at : at + LONGEST_SERVO] for at in range(0, len(received), LONGEST_SERVO)]

    def next_event(self, now: float) -> float:
        """Return the seconds until `take` returns bytes; inf for never."""
        if self._bus is None:
            return math.inf
        return 0.0 if self._received else self._bus.next_event(now)
