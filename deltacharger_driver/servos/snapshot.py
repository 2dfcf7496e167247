# SPDX-License-Identifier: Apache-2.0
"""Settings of the servo bus, the registers exchanged in a cycle, and the snapshot after it."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from deltacharger_core.machine import (
    BAUD_RATE,
    JOINT_MAX,
    JOINT_MIN,
    POSITION_D_GAIN,
    POSITION_P_GAIN,
    SERVO_IDS,
    STALL_CURRENT,
)
from deltacharger_driver.errors import DriverError, RangeError
from deltacharger_driver.parameters import REPLY_MARGIN
from deltacharger_driver.servos.mx64 import (
    CURRENT_UNIT,
    LARGEST_CURRENT,
    REGISTERS,
    VOLTAGE_UNIT,
    WATCHDOG_TRIPPED,
    indirect_data,
)

WATCHDOG = 13
"""Bus watchdog, units of 20 ms: a servo that receives nothing for 260 ms stops on its own, which ends its push. Longer
than the contactor's lease: a stall that the lease outlives does not end a charge. A silent bus moves no goal."""

CONSTANT_BLOCK = {"status_return_level": 2, "registered": 0}
"""Registers of known value, read last. The checksum follows the data low byte first, so it may miss a burst error
across the last data byte and the checksum; such an error then changes one of these."""
READ_BLOCK = (
    "torque_enable",
    "hardware_error",
    "present_current",
    "present_velocity",
    "present_position",
    "input_voltage",
    "temperature",
    "bus_watchdog",
    *CONSTANT_BLOCK,
)
"""Registers read in a cycle, made contiguous by indirect addresses: 64, 70, 126, 128, 132, 144, 146, 98, 68, 69."""
GAINS = ("position_p_gain", "position_i_gain", "position_d_gain")
"""Registers of the position loop, written at every set-up."""
WRITE_BLOCK = ("goal_current", "goal_position")
"""Registers written in a cycle, behind the read block, so that bound and goal change together."""

READ_LENGTH = sum(REGISTERS[name].size for name in READ_BLOCK)
WRITE_LENGTH = sum(REGISTERS[name].size for name in WRITE_BLOCK)
READ_ADDRESS = indirect_data(0)
WRITE_ADDRESS = indirect_data(READ_LENGTH)

HOTTEST = 125
"""°C; beyond it the servo's electronics would not answer."""
CURRENT_SPAN = 2047
"""Range of the servo's current sensor, in counts of 3.36 mA, of either sign."""
LOWEST_VOLTAGE, HIGHEST_VOLTAGE = 40, 300
"""Units of 0.1 V: below, a servo does not run; the battery before its regulator never exceeds the upper value."""
LONGEST_WATCHDOG = 127
_BEYOND = 0.09  # rad beyond the joint limits
_READ_LAYOUT = struct.Struct("<BBhiiHBBBB")


@dataclass(frozen=True)
class BusSettings:
    """Wiring and mounting of the arm's servos.

    Attributes:
        port: path of the serial port.
        baud_rate: bit/s.
        ids: of the servos of limbs 0, 1, 2.
        zero_ticks: encoder count at angle 0, per servo.
        direction: per servo, +1 if the count rises with the angle, −1 if it falls.
        watchdog: units of 20 ms, 1–6.
        reply_margin: s, see `parameters.REPLY_MARGIN`.
        current_max: largest current bound of any goal, A. A servo with a lower current limit would ignore the whole
            goal, so the set-up refuses it.
        gains: P, I and D of the position loop, as in the registers. They are in RAM and lost at a restart.
        joint_min, joint_max: range of the arms' angles, rad.
    """

    port: str
    baud_rate: int = BAUD_RATE
    ids: tuple[int, ...] = SERVO_IDS
    zero_ticks: tuple[int, ...] = (2048, 2048, 2048)
    direction: tuple[int, ...] = (1, 1, 1)
    watchdog: int = WATCHDOG
    reply_margin: float = REPLY_MARGIN
    current_max: float = STALL_CURRENT
    gains: tuple[int, int, int] = (POSITION_P_GAIN, 0, POSITION_D_GAIN)
    joint_min: float = JOINT_MIN
    joint_max: float = JOINT_MAX

    @property
    def reach(self) -> tuple[float, float]:
        """Range of angles (rad) in which an arm can be, pushed by hand or flying off magnets."""
        return self.joint_min - _BEYOND, self.joint_max + _BEYOND

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
        if not 0.0 <= self.current_max <= LARGEST_CURRENT:
            raise RangeError("current_max", self.current_max, 0.0, LARGEST_CURRENT, " A")
        for name, gain in zip(GAINS, self.gains, strict=True):
            register = REGISTERS[name]
            if not register.low <= gain <= register.high:
                raise RangeError(name, gain, register.low, register.high)


class Reading(NamedTuple):
    """One servo's read block, in register units; every value is plausible."""

    torque_enabled: bool
    hardware_error: int
    current: int
    velocity: int
    ticks: int
    voltage: int
    temperature: int
    watchdog: int


def has_restarted(data: bytes) -> bool:
    """Return whether a read block is from a servo that lost its configuration. Its indirect registers then point to
    themselves and read 0, even the status return level, which is 2 in any servo that answers.
    """
    return not any(data)


def decode_block(data: bytes) -> Reading:
    """Read the `READ_LENGTH` bytes of a read block.

    Raises:
        RangeError: names the first impossible value; the whole block must be discarded.
        struct.error: another length.
    """
    torque, error, current, velocity, ticks, voltage, temperature, watchdog, *constants = _READ_LAYOUT.unpack(data)
    for (name, expected), found in zip(CONSTANT_BLOCK.items(), constants, strict=True):
        if found != expected:
            raise RangeError(name, found, expected, expected)
    if torque > 1:
        raise RangeError("torque_enable", torque, 0, 1)
    if not -CURRENT_SPAN <= current <= CURRENT_SPAN:
        span = CURRENT_SPAN * CURRENT_UNIT
        raise RangeError("present_current", current * CURRENT_UNIT, -span, span, " A")
    if not LOWEST_VOLTAGE <= voltage <= HIGHEST_VOLTAGE:
        low, high = LOWEST_VOLTAGE * VOLTAGE_UNIT, HIGHEST_VOLTAGE * VOLTAGE_UNIT
        raise RangeError("input_voltage", voltage * VOLTAGE_UNIT, low, high, " V")
    if temperature > HOTTEST:
        raise RangeError("temperature", temperature, 0, HOTTEST, " °C")
    if LONGEST_WATCHDOG < watchdog < WATCHDOG_TRIPPED:
        raise RangeError("bus_watchdog", watchdog, 0, LONGEST_WATCHDOG)
    return Reading(bool(torque), error, current, velocity, ticks, voltage, temperature, watchdog)


class BusSnapshot(NamedTuple):
    """The servos in one cycle, in the order of the ids. Missing values are NaN, never 0.

    Attributes:
        time: arrival of the replies, s, monotonic.
        valid: whether this cycle got a good reply.
        angle: rad.
        velocity: rad/s.
        current: A, positive is torque toward +angle.
        voltage: V.
        temperature: °C.
        hardware_error: latched error bits; the last known.
        torque_enabled: the last known.
        watchdog_tripped: it received nothing for too long, has stopped and ignores goals.
        rebooted: it answers but has lost its configuration; call `ServoBus.configure`.
        missed: cycles since the last good reply.
        missing: without a good reply for so long that it counts as a fault.
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
    watchdog_tripped: tuple[bool, ...]
    rebooted: tuple[bool, ...]
    missed: tuple[int, ...]
    missing: tuple[bool, ...]

    @property
    def complete(self) -> bool:
        """Whether every servo sent a good reply."""
        return all(self.valid)

    def with_torque(self, ids: Sequence[int], on: bool) -> list[int]:
        """Return the servos of `ids` that reported their torque on, or off."""
        known = zip(ids, self.valid, self.torque_enabled, strict=True)
        return [servo for servo, valid, torque in known if valid and torque == on]
