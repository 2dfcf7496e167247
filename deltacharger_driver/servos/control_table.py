# SPDX-License-Identifier: Apache-2.0
"""Memory of an emulated MX-64: registers with access rules, limits and indirect addressing."""

from __future__ import annotations

import struct

from deltacharger_driver.servos.mx64 import INDIRECT_COUNT, REGISTERS, Register, indirect_address, indirect_data

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
_OWNER: dict[int, str] = {
    register.address + offset: name for name, register in REGISTERS.items() for offset in range(register.size)
}
_POINTERS = {indirect_address(slot) + offset: (slot, offset) for slot in range(INDIRECT_COUNT) for offset in range(2)}
_DATA = {indirect_data(slot): slot for slot in range(INDIRECT_COUNT)}
_FIRST_TARGET = 64
"""Indirect addresses may point only to RAM."""


class ControlTable:
    """Registers of one servo as bytes, with the rules for writes from the bus.

    Args:
        servo: its id.
        baud: value of the baud register.
    """

    def __init__(self, servo: int, baud: int = 3) -> None:
        self._memory = bytearray(SIZE)
        self._targets: list[int] = []
        for name, register in REGISTERS.items():
            if register.eeprom:
                self.set(name, register.default)
        self.set("id", servo)
        self.set("baud", baud)
        self.restart()

    def restart(self) -> None:
        """Reset all registers outside EEPROM to their defaults, as at power-on."""
        for name, register in REGISTERS.items():
            if not register.eeprom:
                self.set(name, register.default)
        for name, limit in _LIMITS.items():
            if name in ("goal_pwm", "goal_current"):
                self.set(name, self.get(limit))
        for slot in range(INDIRECT_COUNT):
            self._memory[indirect_data(slot)] = 0
            struct.pack_into("<H", self._memory, indirect_address(slot), indirect_data(slot))
        self._targets = [indirect_data(slot) for slot in range(INDIRECT_COUNT)]

    def get(self, name: str) -> int:
        """Return a register."""
        register = REGISTERS[name]
        start = register.address
        return int.from_bytes(self._memory[start : start + register.size], "little", signed=register.signed)

    def set(self, name: str, value: int) -> None:
        """Set a register from inside the servo, without the rules for the bus."""
        register = REGISTERS[name]
        self._memory[register.address : register.address + register.size] = register.to_bytes(value)

    def set_present(self, current: int, velocity: int, position: int, voltage: int, temperature: int) -> None:
        """Set all measured values, in register units."""
        struct.pack_into("<hii", self._memory, 126, current, velocity, position)
        struct.pack_into("<HB", self._memory, 144, voltage, temperature)

    def set_movement(self, moving: bool, status: int) -> None:
        """Set registers moving and moving_status."""
        self._memory[122] = moving
        self._memory[123] = status

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
            name = _OWNER.get(at)
            if name is None:
                if at not in _DATA:
                    return ACCESS, {}
                continue
            if name in values:
                continue
            register = REGISTERS[name]
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

    def _allowed(self, name: str, register: Register, value: int) -> int:
        if not register.low <= value <= register.high:
            return RANGE
        if name in GOALS and self.get("bus_watchdog") == 255:
            return RANGE
        if name == "bus_watchdog" and value and self.get("bus_watchdog") == 255:
            return RANGE
        if name == "operating_mode" and value not in (0, 1, 3, 4, 5, 16):
            return RANGE
        if name in _LIMITS and abs(value) > self.get(_LIMITS[name]):
            return LIMIT
        if name == "goal_position" and self.get("operating_mode") == 3:
            return OK if self.get("min_position") <= value <= self.get("max_position") else LIMIT
        return OK

    def _point(self, pointers: dict[int, int]) -> int:
        """Set indirect addresses; their targets must lie in RAM."""
        memory = bytearray(self._memory)
        for at, byte in pointers.items():
            memory[at] = byte
        targets = list(self._targets)
        for slot in {_POINTERS[at][0] for at in pointers}:
            (target,) = struct.unpack_from("<H", memory, indirect_address(slot))
            if not _FIRST_TARGET <= target < SIZE:
                return RANGE
            targets[slot] = target
        self._memory, self._targets = memory, targets
        return OK
