# SPDX-License-Identifier: Apache-2.0
"""The servos' registers as data, their units as pure functions, and the blocks that are exchanged in a cycle.

Addresses and sizes are from the vendor's e-manual for MX-64(2.0); what differs between types is in
deltacharger_core/servo_types.py.
"""

import functools
import math
import struct
from dataclasses import dataclass
from typing import NamedTuple

from deltacharger_core import machine
from deltacharger_core.servo_types import MX_64, ServoType
from deltacharger_driver import errors, parameters

TICK = 2.0 * math.pi / machine.TICKS_PER_TURN  # rad
WATCHDOG_UNIT = 0.02  # s
WATCHDOG_TRIPPED = 255  # −1 in one byte

MODE_POSITION, MODE_EXTENDED, MODE_CURRENT_POSITION = 3, 4, 5

HARDWARE_ERRORS = {0: "input voltage", 2: "overheating", 3: "encoder", 4: "electrical shock", 5: "overload"}
"""Bit of register hardware_error → its meaning; only a reboot clears it. Register shutdown has the same bits."""

STATUS_ERRORS = {
    1: "could not process the instruction",
    2: "unknown instruction",
    3: "received a bad checksum",
    4: "value out of range, or goals locked by the bus watchdog",
    5: "wrong number of bytes",
    6: "value beyond its limit register",
    7: "register does not exist, is read-only or is locked while torque is on",
}
"""Error number of a status packet → its meaning."""
ALERT = 0x80
"""Bit of the same byte: a hardware error is latched."""
INDIRECT_COUNT = 56

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
GAINS = ("position_p_gain", "position_d_gain")
"""Registers of the position loop that can be set; the I gain stays 0: it would press up to the current bound."""
WRITE_BLOCK = ("goal_current", "goal_position")
"""Registers written in a cycle, behind the read block, so that bound and goal change together."""

HOTTEST = 125
"""°C; beyond it the servo's electronics would not answer."""
CURRENT_SPAN = 2047
"""Range of the servo's current sensor, in counts, of either sign."""
LOWEST_VOLTAGE, HIGHEST_VOLTAGE = 40, 300
"""Units of 0.1 V: below, a servo does not run; the battery before its regulator never exceeds the upper value."""
LONGEST_WATCHDOG = 127
_BEYOND = 0.09  # rad beyond the joint limits
_READ_LAYOUT = struct.Struct("<BBhiiHBBBB")


@dataclass(frozen=True)
class Register:
    """One entry of the control table.

    Attributes:
        address: of the least significant byte.
        size: bytes.
        default: value after a factory reset (EEPROM) or a start (RAM).
        low: smallest value accepted.
        high: largest value accepted; as `low`: none may be written.
        signed: whether it is two's complement.
        eeprom: kept without power, and locked while torque is on.
    """

    address: int
    size: int
    default: int
    low: int = 0
    high: int = 0
    signed: bool = False
    eeprom: bool = False

    @property
    def writable(self) -> bool:
        """Whether an instruction may write it."""
        return self.low < self.high

    def to_bytes(self, value: int) -> bytes:
        """Return `value` as bytes for the wire.

        Raises:
            RangeError: the register cannot hold it.
        """
        bits = 8 * self.size
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if self.signed else (0, (1 << bits) - 1)
        if not low <= value <= high:
            raise errors.RangeError(f"register {self.address}", value, low, high)
        return value.to_bytes(self.size, "little", signed=self.signed)

    def from_bytes(self, data: bytes) -> int:
        """Return the value of `size` bytes from the wire."""
        return int.from_bytes(data, "little", signed=self.signed)


_eeprom = functools.partial(Register, eeprom=True)


@functools.cache
def registers_of(servo: ServoType) -> dict[str, Register]:
    """Return the control table of a type by name, without the indirect registers; do not change it.

    Addresses and sizes are those of the vendor's X series and the same for every type.
    """
    every = {
        "model": _eeprom(0, 2, servo.model),
        "firmware": _eeprom(6, 1, 45),
        "id": _eeprom(7, 1, 1, 0, 252),
        "baud": _eeprom(8, 1, 1, 0, 7),
        "return_delay": _eeprom(9, 1, 250, 0, 254),
        "drive_mode": _eeprom(10, 1, 0, 0, 5),
        "operating_mode": _eeprom(11, 1, 3, 0, 16),
        "secondary_id": _eeprom(12, 1, 255, 0, 255),
        "protocol": _eeprom(13, 1, 2, 1, 2),
        "homing_offset": _eeprom(20, 4, 0, -1_044_479, 1_044_479, True),
        "moving_threshold": _eeprom(24, 4, 10, 0, 1023),
        "temperature_limit": _eeprom(31, 1, servo.temperature_limit, 0, 100),
        "max_voltage": _eeprom(32, 2, servo.voltage_max, servo.voltage_min, servo.voltage_max),
        "min_voltage": _eeprom(34, 2, servo.voltage_min, servo.voltage_min, servo.voltage_max),
        "pwm_limit": _eeprom(36, 2, servo.pwm_limit, 0, servo.pwm_limit),
        "current_limit": _eeprom(38, 2, servo.current_limit, 0, servo.current_limit),
        "acceleration_limit": _eeprom(40, 4, 32767, 0, 32767),
        "velocity_limit": _eeprom(44, 4, servo.velocity_limit, 0, 1023),
        "max_position": _eeprom(48, 4, 4095, 0, 4095),
        "min_position": _eeprom(52, 4, 0, 0, 4095),
        "shutdown": _eeprom(63, 1, 52, 0, 61),
        "torque_enable": Register(64, 1, 0, 0, 1),
        "led": Register(65, 1, 0, 0, 1),
        "status_return_level": Register(68, 1, 2, 0, 2),
        "registered": Register(69, 1, 0),
        "hardware_error": Register(70, 1, 0),
        "velocity_i_gain": Register(76, 2, 1920, 0, machine.GAIN_MAX),
        "velocity_p_gain": Register(78, 2, 100, 0, machine.GAIN_MAX),
        "position_d_gain": Register(80, 2, 0, 0, machine.GAIN_MAX),
        "position_i_gain": Register(82, 2, 0, 0, machine.GAIN_MAX),
        "position_p_gain": Register(84, 2, servo.position_p_gain, 0, machine.GAIN_MAX),
        "feedforward_2_gain": Register(88, 2, 0, 0, machine.GAIN_MAX),
        "feedforward_1_gain": Register(90, 2, 0, 0, machine.GAIN_MAX),
        "bus_watchdog": Register(98, 1, 0, 0, 127),
        "goal_pwm": Register(100, 2, servo.pwm_limit, -servo.pwm_limit, servo.pwm_limit, True),
        "goal_current": Register(102, 2, servo.current_limit, -servo.current_limit, servo.current_limit, True),
        "goal_velocity": Register(104, 4, 0, -1023, 1023, True),
        "profile_acceleration": Register(108, 4, 0, 0, 32767),
        "profile_velocity": Register(112, 4, 0, 0, 32767),
        "goal_position": Register(116, 4, 0, -machine.EXTENDED_TICKS, machine.EXTENDED_TICKS, True),
        "moving": Register(122, 1, 0),
        "present_current": Register(126, 2, 0, signed=True),
        "present_velocity": Register(128, 4, 0, signed=True),
        "present_position": Register(132, 4, 0, signed=True),
        "input_voltage": Register(144, 2, 0),
        "temperature": Register(146, 1, 0),
    }
    return {name: register for name, register in every.items() if name not in servo.lacks}


REGISTERS = registers_of(MX_64)
"""The control table of the MX-64; the indirect registers are `indirect_address` and `indirect_data`."""


def indirect_address(slot: int) -> int:
    """Return the address that holds the two-byte target of indirect register `slot` (0–55)."""
    return 168 + 2 * slot if slot < 28 else 578 + 2 * (slot - 28)


def indirect_data(slot: int) -> int:
    """Return the address at which the target byte of indirect register `slot` (0–55) is read and written."""
    return 224 + slot if slot < 28 else 634 + (slot - 28)


def angle_to_ticks(angle: float, zero_ticks: int, direction: int) -> int:
    """Return the encoder count of an arm angle: zero_ticks + direction · angle · 4096 / 2π, rounded.

    Args:
        angle: rad, from radially outward toward +z.
        zero_ticks: count at angle 0.
        direction: +1 or −1.

    Raises:
        RangeError: outside the goal register's range, or not finite.
    """
    limit = machine.EXTENDED_TICKS * TICK
    if not -limit <= angle <= limit:
        raise errors.RangeError("angle", angle, -limit, limit, " rad")
    return zero_ticks + direction * round(angle / TICK)


def ticks_to_angle(ticks: int, zero_ticks: int, direction: int) -> float:
    """Return the arm angle, rad, of an encoder count: direction · (ticks − zero_ticks) · 2π / 4096."""
    return direction * (ticks - zero_ticks) * TICK


def current_to_counts(current: float, servo: ServoType) -> int:
    """Return a current, A, in counts of a type, rounded toward zero so that a bound is never exceeded.

    Raises:
        RangeError: outside the registers' range, or not finite.
    """
    largest = servo.largest_current
    if not -largest <= current <= largest:
        raise errors.RangeError("current", current, -largest, largest, " A")
    return int(current / servo.current_unit + math.copysign(1e-9, current))


def describe_hardware_error(bits: int) -> str:
    """Return the names of the latched hardware errors in `bits`, '' if there are none."""
    names = [name for bit, name in HARDWARE_ERRORS.items() if bits >> bit & 1]
    unknown = bits & ~sum(1 << bit for bit in HARDWARE_ERRORS)
    return ", ".join(names + ([f"unknown bits {unknown:#04x}"] if unknown else []))


def describe_status_error(code: int) -> str:
    """Return the meaning of a status packet's error byte; '' for 0."""
    number = code & ~ALERT
    text = STATUS_ERRORS.get(number, f"unknown error {number}") if number else ""
    if code & ALERT:
        text = f"{text}, hardware error latched" if text else "hardware error latched"
    return text


READ_LENGTH = sum(REGISTERS[name].size for name in READ_BLOCK)
WRITE_LENGTH = sum(REGISTERS[name].size for name in WRITE_BLOCK)
READ_ADDRESS = indirect_data(0)
WRITE_ADDRESS = indirect_data(READ_LENGTH)


@dataclass(frozen=True)
class Drive:
    """The numbers with which the servos of a type are driven.

    Attributes:
        servo: their type.
        torque_constant: N·m/A, converts torque bounds into currents.
        current_max: largest current bound of any goal, A. A servo with a lower current limit would ignore the whole
            goal, so the set-up refuses it.
        gains: P and D of the position loop, as in the registers. They are in RAM and lost at a restart.
    """

    servo: ServoType
    torque_constant: float
    current_max: float
    gains: tuple[int, ...]

    def __post_init__(self) -> None:
        if not 0.0 <= self.current_max <= self.servo.largest_current:
            raise errors.RangeError("current_max", self.current_max, 0.0, self.servo.largest_current, " A")

    @property
    def current_bound(self) -> float:
        """Of each servo if a trajectory sets none, A."""
        return min(self.servo.current_bound, self.current_max)


@dataclass(frozen=True)
class BusSettings:
    """Wiring and mounting of the arm's servos, and what is set of their `Drive`; None = as their type has it.

    Attributes:
        port: path of the serial port.
        baud_rate: bit/s.
        ids: of the servos of limbs 0, 1, 2.
        zero_ticks: encoder count at angle 0, per servo.
        direction: per servo, +1 if the count rises with the angle, −1 if it falls.
        reply_margin: s, see `parameters.REPLY_MARGIN`.
        torque_constant, current_max, gains: as in `Drive`.
        joint_min, joint_max: range of the arms' angles, rad.
    """

    port: str
    baud_rate: int = machine.BAUD_RATE
    ids: tuple[int, ...] = machine.SERVO_IDS
    zero_ticks: tuple[int, ...] = (2048, 2048, 2048)
    direction: tuple[int, ...] = (1, 1, 1)
    reply_margin: float = parameters.REPLY_MARGIN
    torque_constant: float | None = None
    current_max: float | None = None
    gains: tuple[int | None, ...] = (None, None)
    joint_min: float = machine.JOINT_MIN
    joint_max: float = machine.JOINT_MAX

    @property
    def reach(self) -> tuple[float, float]:
        """Range of angles (rad) in which an arm can be, pushed by hand or flying off magnets."""
        return self.joint_min - _BEYOND, self.joint_max + _BEYOND

    def __post_init__(self) -> None:
        count = len(self.ids)
        if not count == len(set(self.ids)) == len(self.zero_ticks) == len(self.direction):
            raise errors.DriverError(
                f"ids {self.ids}, zero_ticks {self.zero_ticks} and direction {self.direction} must have one value per "
                "servo, and no id twice"
            )
        if any(sign not in (1, -1) for sign in self.direction):
            raise errors.DriverError(f"direction {self.direction}: each value is 1 or -1")

    def drive(self, servo: ServoType) -> Drive:
        """Return the numbers for servos of a type.

        Raises:
            RangeError: `current_max` is beyond the type's registers.
        """
        constant = servo.torque_constant if self.torque_constant is None else self.torque_constant
        most = servo.stall_current if self.current_max is None else self.current_max
        gains = tuple(own if gain is None else gain for gain, own in zip(self.gains, servo.gains, strict=True))
        return Drive(servo, constant, most, gains)


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


def decode_block(data: bytes, servo: ServoType) -> Reading:
    """Read the `READ_LENGTH` bytes of a read block of a type.

    Raises:
        RangeError: names the first impossible value; the whole block must be discarded.
        struct.error: another length.
    """
    torque, error, current, velocity, ticks, voltage, temperature, watchdog, *constants = _READ_LAYOUT.unpack(data)
    for (name, expected), found in zip(CONSTANT_BLOCK.items(), constants, strict=True):
        if found != expected:
            raise errors.RangeError(name, found, expected, expected)
    if torque > 1:
        raise errors.RangeError("torque_enable", torque, 0, 1)
    if not -CURRENT_SPAN <= current <= CURRENT_SPAN:
        span = CURRENT_SPAN * servo.current_unit
        raise errors.RangeError("present_current", current * servo.current_unit, -span, span, " A")
    if not LOWEST_VOLTAGE <= voltage <= HIGHEST_VOLTAGE:
        low, high = LOWEST_VOLTAGE * servo.voltage_unit, HIGHEST_VOLTAGE * servo.voltage_unit
        raise errors.RangeError("input_voltage", voltage * servo.voltage_unit, low, high, " V")
    if temperature > HOTTEST:
        raise errors.RangeError("temperature", temperature, 0, HOTTEST, " °C")
    if LONGEST_WATCHDOG < watchdog < WATCHDOG_TRIPPED:
        raise errors.RangeError("bus_watchdog", watchdog, 0, LONGEST_WATCHDOG)
    return Reading(bool(torque), error, current, velocity, ticks, voltage, temperature, watchdog)
