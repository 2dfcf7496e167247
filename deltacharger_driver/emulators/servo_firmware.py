# SPDX-License-Identifier: Apache-2.0
"""Firmware of an emulated MX-64: modes, watchdog, latched errors, restart. A plant is its motor."""

from __future__ import annotations

import math
from typing import Protocol

from deltacharger_core.machine import POSITION_D_GAIN, POSITION_P_GAIN
from deltacharger_driver.servos.control_table import ACCESS, OK, RESULT_FAIL, ControlTable
from deltacharger_driver.servos.mx64 import (
    ALERT,
    CURRENT_UNIT,
    MODE_CURRENT_POSITION,
    MODE_EXTENDED,
    MODE_POSITION,
    SPEEDS,
    TICK,
    VELOCITY_UNIT,
    VOLTAGE_UNIT,
    WATCHDOG_TRIPPED,
    WATCHDOG_UNIT,
)

ZERO_TICKS = 2048
"""Encoder count of an emulated servo at angle 0 of its plant; counts rise with the angle."""
RESTART_TIME = 0.3  # s that a servo is silent after a reboot
_OVERHEATING, _VOLTAGE = 1 << 2, 1 << 0
_LARGEST_OFFSET = 1024  # counts; largest homing offset used in mode 3
_IN_POSITION = 10  # counts from the goal; the vendor gives no figure
_NOT_FOLLOWING = 114  # counts from the reference, 10°; the vendor gives no figure
_POSITION_MODES = (MODE_POSITION, MODE_EXTENDED, MODE_CURRENT_POSITION)


class ServoPlant(Protocol):
    """The physics behind emulated servos: motor, gear, load and supply. It has its own clock."""

    def command_servo(
        self,
        index: int,
        torque_enabled: bool,
        reference: float,
        current_limit: float,
        gain: float = 1.0,
        braking: float = 1.0,
    ) -> None:
        """Make the position loop of servo `index` hold `reference` (rad) with at most `current_limit` (A).

        `gain` and `braking` are the position P and D gains relative to servo_node's; they scale the plant's stiffness
        and damping.
        """

    def read_servo(self, index: int) -> tuple[float, float, float, float, float]:
        """Return angle (rad), velocity (rad/s), current (A, signed), voltage (V) and temperature (°C) now."""


class ServoFirmware:
    """One servo: control table and behaviour.

    Args:
        plant: its physics.
        index: of the servo in the plant.
        servo: id.

    Attributes:
        table: its registers.
        protocol: 2, or 1 to emulate old firmware, which answers only pings and reads of its model number.
        supply_limit: upper limit of the supply, V, whatever the plant returns; inf = none.
    """

    def __init__(self, plant: ServoPlant, index: int, servo: int) -> None:
        self.table = ControlTable(servo)
        self.protocol = 2
        self.supply_limit = math.inf
        self._plant = plant
        self._index = index
        self._registered: tuple[int, bytes] | None = None
        self._silent_until = -math.inf
        self._heard = -math.inf
        self._reference = 0.0  # rad, goal of the position loop
        self._commanded: tuple[bool, float, float, float, float] | None = None
        self._start(-math.inf)

    @property
    def servo(self) -> int:
        """Its id."""
        return self.table.get("id")

    @property
    def speed(self) -> int:
        """Its speed, bit/s."""
        return SPEEDS.get(self.table.get("baud"), 0)

    @property
    def return_delay(self) -> float:
        """Delay before an answer, s."""
        return self.table.get("return_delay") * 2e-6

    def answers(self, now: float) -> bool:
        """Return whether it is running at `now` (s); a restart takes a moment."""
        return now >= self._silent_until

    def error_byte(self, number: int) -> int:
        """Return the error byte of a status packet with error `number`."""
        return number | (ALERT if self.table.get("hardware_error") else 0)

    def note_instruction(self, now: float) -> None:
        """Record an instruction packet for this servo at `now` (s).

        Only `tick` checks the watchdog, after received bytes are read: if the emulator itself had to wait for the
        processor, the host was not silent.
        """
        self._heard = now

    def read(self, address: int, length: int, now: float) -> tuple[int, bytes]:
        """Return (error number, data) of a read instruction."""
        self.measure(now)
        data = self.table.read(address, length)
        return (ACCESS, b"") if data is None else (OK, data)

    def write(self, address: int, data: bytes, now: float) -> int:
        """Execute a write instruction and return its error number."""
        locked = self.table.get("hardware_error") & self.table.get("shutdown")
        if locked and address == 64 and data[:1] == b"\1":
            return RESULT_FAIL
        was_on = self.table.get("torque_enable")
        error, values = self.table.write(address, data)
        if error == OK and values:
            self._written(values, bool(was_on), now)
        return error

    def register_write(self, address: int, data: bytes) -> int:
        """Store a write for the next action instruction."""
        self._registered = (address, data)
        self.table.set("registered", 1)
        return OK

    def action(self, now: float) -> int:
        """Execute the registered write."""
        if self._registered is None:
            return RESULT_FAIL
        address, data = self._registered
        self._registered = None
        self.table.set("registered", 0)
        return self.write(address, data, now)

    def reboot(self, now: float) -> None:
        """Restart: torque off, RAM to defaults, latched errors cleared, no answers for `RESTART_TIME`."""
        self.table.restart()
        self._start(now)
        self._silent_until = now + RESTART_TIME

    def raise_error(self, bits: int) -> None:
        """Latch hardware error `bits`; torque goes off if the shutdown register selects it."""
        before = self.table.get("hardware_error")
        self.table.set("hardware_error", before | bits)
        if bits & self.table.get("shutdown"):
            self.table.set("torque_enable", 0)
            self._forward()

    def tick(self, now: float) -> None:
        """Advance the watchdog."""
        if now > self._watchdog_due():
            self.trip_watchdog(now)

    def next_event(self, now: float) -> float:
        """Return the seconds until `tick` is needed; inf for never."""
        return max(self._watchdog_due() - now + 1e-4, 0.0)

    def measure(self, now: float) -> float:
        """Copy the plant's state into the registers, latch resulting errors, and return the angle, rad."""
        angle, velocity, current, voltage, temperature = self._plant.read_servo(self._index)
        voltage = min(voltage, self.supply_limit)
        table = self.table
        table.set_present(
            max(-32768, min(32767, round(current / CURRENT_UNIT))),
            round(velocity / VELOCITY_UNIT),
            self._ticks(angle),
            max(0, min(65535, round(voltage / VOLTAGE_UNIT))),
            max(0, min(255, round(temperature))),
        )
        table.set_movement(*self._movement(angle, velocity))
        decivolts = voltage / VOLTAGE_UNIT
        errors = 0
        if temperature >= table.get("temperature_limit"):
            errors |= _OVERHEATING
        if not table.get("min_voltage") <= decivolts <= table.get("max_voltage"):
            errors |= _VOLTAGE
        if errors & ~table.get("hardware_error"):
            self.raise_error(errors)
        return angle

    def _offset(self) -> int:
        """Counts between the encoder and the registers: present = actual + homing offset. Mode 3 ignores large ones."""
        offset = self.table.get("homing_offset")
        if abs(offset) > _LARGEST_OFFSET and self.table.get("operating_mode") == MODE_POSITION:
            return 0
        return offset

    def _ticks(self, angle: float) -> int:
        return ZERO_TICKS + self._offset() + round(angle / TICK)

    def _angle(self, ticks: int) -> float:
        return (ticks - ZERO_TICKS - self._offset()) * TICK

    def _movement(self, angle: float, velocity: float) -> tuple[bool, int]:
        """Return registers 122 and 123."""
        table = self.table
        moving = abs(velocity) > table.get("moving_threshold") * VELOCITY_UNIT
        if not table.get("torque_enable") or table.get("operating_mode") not in _POSITION_MODES:
            return moving, 0
        distance = abs(self._reference - angle)
        return moving, (distance <= _IN_POSITION * TICK) | (distance > _NOT_FOLLOWING * TICK) << 3

    def _start(self, now: float) -> None:
        self._registered = None
        self._heard = -math.inf
        self._reference = self.measure(now)
        self.table.set("goal_position", self._ticks(self._reference))
        self._forward()

    def _written(self, values: dict[str, int], was_on: bool, now: float) -> None:
        begins = values.get("torque_enable") and not was_on
        if self.table.get("torque_enable") and ("goal_position" in values or begins):
            self._reference = self._angle(self.table.get("goal_position"))
        if values.get("bus_watchdog"):
            self._heard = now
        self._forward()

    def _watchdog_due(self) -> float:
        """Return when silence trips the watchdog, s; inf = never. Active only while torque is on (e-manual, 98)."""
        period = self.table.get("bus_watchdog")
        armed = 0 < period < WATCHDOG_TRIPPED and self.table.get("torque_enable")
        return self._heard + period * WATCHDOG_UNIT if armed else math.inf

    def trip_watchdog(self, now: float) -> None:
        """Stop and lock the goals, as after too long a silence; do nothing if the watchdog is off."""
        if not 0 < self.table.get("bus_watchdog") < WATCHDOG_TRIPPED:
            return
        self.table.set("bus_watchdog", WATCHDOG_TRIPPED)
        self._reference = self.measure(now)
        self._forward()

    def _forward(self) -> None:
        """Command the plant if anything has changed."""
        table = self.table
        mode = table.get("operating_mode")
        on = bool(table.get("torque_enable")) and mode in _POSITION_MODES
        limit = table.get("current_limit")
        if mode == MODE_CURRENT_POSITION:
            limit = min(limit, abs(table.get("goal_current")))
        gain, braking = table.get("position_p_gain") / POSITION_P_GAIN, table.get("position_d_gain") / POSITION_D_GAIN
        command = (on, self._reference, limit * CURRENT_UNIT, gain, braking)
        if command != self._commanded:
            self._commanded = command
            self._plant.command_servo(self._index, *command)
