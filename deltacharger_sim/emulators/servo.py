# SPDX-License-Identifier: Apache-2.0
"""An emulated servo: memory with access rules, limits and indirect addresses; modes, watchdog, errors, restart."""

import functools
import math
import struct
from typing import Protocol

from deltacharger_core.servo_types import MX_64, SPEEDS, ServoType
from deltacharger_driver.servos import registers
from deltacharger_driver.servos.registers import WATCHDOG_UNIT

SIZE = 662

OK, RESULT_FAIL, INSTRUCTION, CHECKSUM, RANGE, LENGTH, LIMIT, ACCESS = range(8)
"""Error numbers of a status packet."""

GOALS = frozenset({"goal_pwm", "goal_current", "goal_velocity", "goal_position"})
"""Registers locked by a tripped bus watchdog."""

_LIMITS = {
    "goal_pwm": "pwm_limit",
    "goal_current": "current_limit",
    "goal_velocity": "velocity_limit",
    "profile_velocity": "velocity_limit",
    "profile_acceleration": "acceleration_limit",
}
_POINTERS = {
    registers.indirect_address(slot) + offset: (slot, offset)
    for slot in range(registers.INDIRECT_COUNT)
    for offset in range(2)
}
_DATA = {registers.indirect_data(slot): slot for slot in range(registers.INDIRECT_COUNT)}
_FIRST_TARGET = 64
"""Indirect addresses may point only to RAM."""
ZERO_TICKS = 2048
"""Encoder count of an emulated servo at angle 0 of its plant; counts rise with the angle."""
RESTART_TIME = 0.3  # s that a servo is silent after a reboot
_OVERHEATING, _VOLTAGE = 1 << 2, 1 << 0
_POSITION_MODES = (registers.MODE_POSITION, registers.MODE_EXTENDED, registers.MODE_CURRENT_POSITION)


@functools.cache
def _owners(kind: ServoType) -> dict[int, str]:
    """Return the register that holds each byte of a type's control table."""
    table = registers.registers_of(kind)
    return {table[name].address + offset: name for name in table for offset in range(table[name].size)}


class ControlTable:
    """Registers of one servo as bytes, with the rules for writes from the bus.

    Args:
        servo: its id.
        baud: value of the baud register.
        kind: its type.
    """

    def __init__(self, servo: int, baud: int = 3, kind: ServoType = MX_64) -> None:
        self._registers, self._owner = registers.registers_of(kind), _owners(kind)
        self._memory = bytearray(SIZE)
        self._targets: list[int] = []
        for name, register in self._registers.items():
            if register.eeprom:
                self.set(name, register.default)
        self.set("id", servo)
        self.set("baud", baud)
        self.restart()

    def restart(self) -> None:
        """Reset all registers outside EEPROM to their defaults, as at power-on."""
        for name, register in self._registers.items():
            if not register.eeprom:
                self.set(name, register.default)
        for name in ("goal_pwm", "goal_current"):
            self.set(name, self.get(_LIMITS[name]))
        for slot in range(registers.INDIRECT_COUNT):
            self._memory[registers.indirect_data(slot)] = 0
            struct.pack_into("<H", self._memory, registers.indirect_address(slot), registers.indirect_data(slot))
        self._targets = [registers.indirect_data(slot) for slot in range(registers.INDIRECT_COUNT)]

    def get(self, name: str) -> int:
        """Return a register."""
        register = self._registers[name]
        start = register.address
        return int.from_bytes(self._memory[start : start + register.size], "little", signed=register.signed)

    def set(self, name: str, value: int) -> None:
        """Set a register from inside the servo, without the rules for the bus."""
        register = self._registers[name]
        self._memory[register.address : register.address + register.size] = register.to_bytes(value)

    def set_present(self, current: int, velocity: int, position: int, voltage: int, temperature: int) -> None:
        """Set all measured values, in register units."""
        struct.pack_into("<hii", self._memory, 126, current, velocity, position)
        struct.pack_into("<HB", self._memory, 144, voltage, temperature)

    def read(self, address: int, length: int) -> bytes | None:
        """Return `length` bytes from `address`, through the indirect registers; None beyond the table."""
        end = address + length
        if end > SIZE:
            return None
        if (address >= 224 and end <= 252) or (address >= 634 and end <= SIZE):
            slot = _DATA[address]
            memory = self._memory
            return bytes([memory[target] for target in self._targets[slot : slot + length]])
        return bytes(self._memory[self._resolve(at)] for at in range(address, end))

    def write(self, address: int, data: bytes) -> tuple[int, dict[str, int]]:
        """Write `data` from `address` on, all or nothing, as an instruction from the bus.

        Returns:
            Error number of the status packet, and the written registers with their values.
        """
        if address + len(data) > SIZE:
            return ACCESS, {}
        plain: dict[int, int] = {}
        pointers: dict[int, int] = {}
        for offset, byte in enumerate(data):
            at = address + offset
            if at in _POINTERS:
                pointers[at] = byte
            else:
                plain[self._resolve(at)] = byte
        error, values = self._check(plain)
        if error == OK and pointers:
            error = self._point(pointers)
        if error != OK:
            return error, {}
        for at, byte in plain.items():
            self._memory[at] = byte
        return OK, values

    def _resolve(self, address: int) -> int:
        slot = _DATA.get(address)
        return address if slot is None else self._targets[slot]

    def _check(self, plain: dict[int, int]) -> tuple[int, dict[str, int]]:
        """Return (error, values) of the registers that these bytes form."""
        values: dict[str, int] = {}
        for at in plain:
            name = self._owner.get(at)
            if name is None:
                if at not in _DATA:
                    return ACCESS, {}
                continue
            if name in values:
                continue
            register = self._registers[name]
            if not register.writable or (register.eeprom and self.get("torque_enable")):
                return ACCESS, {}
            places = range(register.address, register.address + register.size)
            if any(place not in plain for place in places):
                return LENGTH, {}
            value = register.from_bytes(bytes(plain[place] for place in places))
            error = self._allowed(name, register, value)
            if error != OK:
                return error, {}
            values[name] = value
        return OK, values

    def _allowed(self, name: str, register: registers.Register, value: int) -> int:
        if not register.low <= value <= register.high:
            return RANGE
        if name in GOALS and self.get("bus_watchdog") == 255:
            return RANGE
        if name == "bus_watchdog" and value and self.get("bus_watchdog") == 255:
            return RANGE
        if name == "operating_mode" and value not in (0, 1, 3, 4, 5, 16):
            return RANGE
        if (limit := _LIMITS.get(name)) in self._registers and abs(value) > self.get(limit):
            return LIMIT
        return OK

    def _point(self, pointers: dict[int, int]) -> int:
        """Set indirect addresses; their targets must lie in RAM."""
        memory = bytearray(self._memory)
        for at, byte in pointers.items():
            memory[at] = byte
        targets = list(self._targets)
        for slot in {_POINTERS[at][0] for at in pointers}:
            (target,) = struct.unpack_from("<H", memory, registers.indirect_address(slot))
            if not _FIRST_TARGET <= target < SIZE:
                return RANGE
            targets[slot] = target
        self._memory, self._targets = memory, targets
        return OK


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
        kind: its type.

    Attributes:
        table: its registers.
        supply_limit: upper limit of the supply, V, whatever the plant returns; inf = none.
    """

    def __init__(self, plant: ServoPlant, index: int, servo: int, kind: ServoType = MX_64) -> None:
        self.table = ControlTable(servo, kind=kind)
        self._kind, self._usual = kind, kind.gains
        self.supply_limit = math.inf
        self._plant = plant
        self._index = index
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
        return number | (registers.ALERT if self.table.get("hardware_error") else 0)

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
        table, kind = self.table, self._kind
        table.set_present(
            max(-32768, min(32767, round(current / kind.current_unit))),
            round(velocity / kind.velocity_unit),
            self._ticks(angle),
            max(0, min(65535, round(voltage / kind.voltage_unit))),
            max(0, min(255, round(temperature))),
        )
        counts = voltage / kind.voltage_unit
        errors = 0
        if temperature >= table.get("temperature_limit"):
            errors |= _OVERHEATING
        if not table.get("min_voltage") <= counts <= table.get("max_voltage"):
            errors |= _VOLTAGE
        if errors & ~table.get("hardware_error"):
            self.raise_error(errors)
        return angle

    def _ticks(self, angle: float) -> int:
        return ZERO_TICKS + round(angle / registers.TICK)

    def _angle(self, ticks: int) -> float:
        return (ticks - ZERO_TICKS) * registers.TICK

    def _start(self, now: float) -> None:
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
        armed = 0 < period < registers.WATCHDOG_TRIPPED and self.table.get("torque_enable")
        return self._heard + period * WATCHDOG_UNIT if armed else math.inf

    def trip_watchdog(self, now: float) -> None:
        """Stop and lock the goals, as after too long a silence; do nothing if the watchdog is off."""
        if not 0 < self.table.get("bus_watchdog") < registers.WATCHDOG_TRIPPED:
            return
        self.table.set("bus_watchdog", registers.WATCHDOG_TRIPPED)
        self._reference = self.measure(now)
        self._forward()

    def _forward(self) -> None:
        """Command the plant if anything has changed."""
        table = self.table
        mode = table.get("operating_mode")
        on = bool(table.get("torque_enable")) and mode in _POSITION_MODES
        limit = table.get("current_limit")
        if mode == registers.MODE_CURRENT_POSITION:
            limit = min(limit, abs(table.get("goal_current")))
        stiff, damped = self._usual
        gain, braking = table.get("position_p_gain") / stiff, table.get("position_d_gain") / damped
        command = (on, self._reference, limit * self._kind.current_unit, gain, braking)
        if command != self._commanded:
            self._commanded = command
            self._plant.command_servo(self._index, *command)
