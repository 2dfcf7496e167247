"""How the servos are wired, and what is known of them after one cycle."""

from __future__ import annotations

from dataclasses import dataclass

from deltacharger_driver.errors import DriverError, RangeError
from deltacharger_driver.servo_port import REPLY_MARGIN
from deltacharger_driver.servo_setup import WATCHDOG


@dataclass(frozen=True)
class BusSettings:
    """How the arm's servos are wired and mounted.

    Attributes:
        port: path of the serial port.
        baud_rate: bit/s.
        ids: of the servos of limbs 0, 1, 2.
        zero_ticks: encoder count at angle 0, per servo.
        direction: +1 or −1 per servo: whether the count rises with the angle.
        watchdog: units of 20 ms, 1–6.
        reply_margin: s, see `servo_port.REPLY_MARGIN`.
    """

    port: str
    baud_rate: int = 1_000_000
    ids: tuple[int, ...] = (1, 2, 3)
    zero_ticks: tuple[int, ...] = (2048, 2048, 2048)
    direction: tuple[int, ...] = (1, 1, 1)
    watchdog: int = WATCHDOG
    reply_margin: float = REPLY_MARGIN

    def __post_init__(self) -> None:
        count = len(self.ids)
        if not count == len(set(self.ids)) == len(self.zero_ticks) == len(self.direction):
            raise DriverError(
                f"ids {self.ids}, zero_ticks {self.zero_ticks} and direction {self.direction} must have one value per "
                "servo, and no id twice"
            )
        if any(sign not in (1, -1) for sign in self.direction):
            raise DriverError(f"direction {self.direction}: each value is 1 or -1")
        if not 1 <= self.watchdog <= WATCHDOG:
            raise RangeError("watchdog", self.watchdog, 1, WATCHDOG, " × 20 ms")


@dataclass(frozen=True)
class Snapshot:
    """The servos in one cycle, in the order of the ids. What was not measured is NaN, never 0.

    Attributes:
        time: when the replies had arrived, s, monotonic.
        valid: a good reply came in this cycle.
        angle: rad.
        velocity: rad/s.
        current: A, positive is torque toward +angle.
        voltage: V.
        temperature: °C.
        hardware_error: latched error bits; the last known.
        torque_enabled: the last known.
        rebooted: the servo answers but has lost its set-up; call `ServoBus.configure`.
        missed: cycles since the last good reply.
        missing: it gave none for so long that something must be wrong with it.
    """

    time: float
    valid: tuple[bool, ...]
    angle: tuple[float, ...]
    velocity: tuple[float, ...]
    current: tuple[float, ...]
    voltage: tuple[float, ...]
    temperature: tuple[float, ...]
    hardware_error: tuple[int, ...]
    torque_enabled: tuple[bool, ...]
    rebooted: tuple[bool, ...]
    missed: tuple[int, ...]
    missing: tuple[bool, ...]

    @property
    def complete(self) -> bool:
        """Whether every servo gave a good reply."""
        return all(self.valid)
