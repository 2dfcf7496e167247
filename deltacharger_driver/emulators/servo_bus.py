# SPDX-License-Identifier: Apache-2.0
"""Emulated servos on a bus: bytes in, bytes out, with injected faults. docs/emulators.md lists what is not simulated.

Serve a `ServoBusEmulator(BenchArm())` on a `PseudoTerminal` and open the terminal's path like any serial port.
"""

from __future__ import annotations

import functools
import itertools
import math
import random
import threading
from collections.abc import Callable, Sequence

from deltacharger_core.machine import SERVO_IDS
from deltacharger_driver.emulators.servo_faults import ServoFaults, collide
from deltacharger_driver.emulators.servo_firmware import ServoFirmware, ServoPlant
from deltacharger_driver.errors import DriverError
from deltacharger_driver.servos.control_table import CHECKSUM, INSTRUCTION, LENGTH, OK
from deltacharger_driver.servos.packets import (
    ACTION,
    BROADCAST,
    PING,
    READ,
    REBOOT,
    REG_WRITE,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    Instruction,
    InstructionParser,
    status,
    status_1,
)


class ServoBusEmulator:
    """Emulated MX-64 servos with Protocol 2.0 on one bus, a `ByteDevice` for `PseudoTerminal`.

    Their configuration is the one the driver expects on the robot: 1 Mbit/s, everything else as from the factory.

    Args:
        plant: their physics; servo i of the bus is servo i of the plant.
        ids: of the servos, in the plant's order.
        paced: delay bytes by their wire time too, not only by the return delay.
        line_speed: returns the host's speed, bit/s, such as `PseudoTerminal.speed`; servos receive nothing at another
            speed than theirs. None = any.
        seed: of the random faults.

    Attributes:
        faults: injected faults; may be changed at any time.
        line_speed: as above; may be set later, once the terminal exists.
    """

    def __init__(
        self,
        plant: ServoPlant,
        ids: Sequence[int] = SERVO_IDS,
        paced: bool = False,
        line_speed: Callable[[], int] | None = None,
        seed: int = 0,
    ) -> None:
        self.faults = ServoFaults()
        self.line_speed = line_speed
        self._paced = paced
        self._lock = threading.RLock()
        self._random = random.Random(seed)
        self._parser = InstructionParser()
        self._servos = [ServoFirmware(plant, index, servo) for index, servo in enumerate(ids)]
        self._outgoing: list[tuple[float, bytes]] = []

    def servo(self, servo: int) -> ServoFirmware:
        """Return the emulated servo with id `servo`, to inspect its registers or break it.

        Raises:
            DriverError: no servo has this id.
        """
        for firmware in self._servos:
            if firmware.servo == servo:
                return firmware
        raise DriverError(f"no emulated servo {servo}; there are {[f.servo for f in self._servos]}")

    def alter(self, place: int, change: Callable[[ServoFirmware], None]) -> None:
        """Apply `change` between two instructions to the servo at `place` in `ids`, whatever its present id."""
        with self._lock:
            change(self._servos[place])

    def raise_hardware_error(self, servo: int, bits: int) -> None:
        """Latch hardware error `bits` (mx64.HARDWARE_ERRORS) in a servo."""
        with self._lock:
            self.servo(servo).raise_error(bits)

    def reboot(self, servo: int, now: float) -> None:
        """Restart a servo at `now` (s, monotonic), as after a dip of its supply."""
        with self._lock:
            self.servo(servo).reboot(now)

    def use_protocol_1(self, servo: int) -> None:
        """Give a servo Protocol 1.0 firmware."""
        with self._lock:
            self.servo(servo).protocol = 1
            self._parser.protocol_1 = True

    def set_speed(self, servo: int, baud: int) -> None:
        """Set a servo's baud register (key of mx64.SPEEDS), as found from the factory: 1."""
        with self._lock:
            self.servo(servo).table.set("baud", baud)

    def receive(self, data: bytes, now: float) -> bytes:
        """Take bytes from the host and return the replies that are due at once."""
        with self._lock:
            if not self.faults.deaf:
                for instruction in self._parser.feed(data, now):
                    self._execute(instruction, now)
            return self._due(now)

    def poll(self, now: float) -> bytes:
        """Advance time and return the replies due now."""
        with self._lock:
            for servo in self._servos:
                servo.tick(now)
            return self._due(now)

    def next_event(self, now: float) -> float:
        """Return the seconds until `poll` is needed; inf for never."""
        with self._lock:
            waits = [servo.next_event(now) for servo in self._servos]
            waits += [due - now for due, _ in self._outgoing]
            return max(min(waits, default=math.inf), 0.0)

    def _due(self, now: float) -> bytes:
        if not self._outgoing:
            return b""
        ready = b"".join(reply for due, reply in self._outgoing if due <= now)
        self._outgoing = [item for item in self._outgoing if item[0] > now]
        return ready

    def _execute(self, instruction: Instruction, now: float) -> None:
        speed = self.line_speed() if self.line_speed is not None else None
        present = [
            servo
            for servo in self._servos
            if servo.answers(now)
            and servo.servo not in self.faults.missing
            and servo.protocol == instruction.protocol
            and speed in (None, servo.speed)
        ]
        start = now + (instruction.size * 10.0 / present[0].speed if self._paced and present else 0.0)
        if instruction.protocol == 1:
            replies = _protocol_1(instruction, present)
        else:
            replies = self._replies(instruction, present, now)
        self._send(replies, start)

    def _send(self, replies: list[tuple[ServoFirmware, bytes]], start: float) -> None:
        """Queue replies one after another; replies of servos with the same id collide."""
        for _, group in itertools.groupby(replies, key=lambda item: item[0].servo):
            together = list(group)
            servo = together[0][0]
            reply = functools.reduce(lambda a, b: collide(a, b, self._random), (each for _, each in together))
            start += servo.return_delay
            if self._paced:
                start += len(reply) * 10.0 / servo.speed
            damaged = self.faults.apply(servo.servo, reply, self._random)
            if damaged:
                self._outgoing.append((start + self.faults.delay, damaged))

    def _replies(
        self, instruction: Instruction, present: list[ServoFirmware], now: float
    ) -> list[tuple[ServoFirmware, bytes]]:
        addressed = [servo for servo in present if instruction.servo in (BROADCAST, servo.servo)]
        addressed.sort(key=lambda servo: servo.servo)  # each waits for those with lower ids
        if not instruction.intact:
            if instruction.servo == BROADCAST:
                return []
            return [(servo, status(servo.servo, servo.error_byte(CHECKSUM))) for servo in addressed]
        for servo in addressed:
            servo.note_instruction(now)
        code, data = instruction.code, instruction.parameters
        if code == SYNC_READ:
            address, length = _words(data)
            return _chain(present, [(servo, address, length) for servo in data[4:]], now)
        if code == SYNC_WRITE:
            _sync_write(present, data, now)
            return []
        replies = []
        for servo in addressed:
            # The state before the instruction decides whether a servo answers: a reboot is still confirmed.
            level, servo_id = servo.table.get("status_return_level"), servo.servo
            error, payload = _single(servo, code, data, now)
            quiet = instruction.servo == BROADCAST and code != PING
            if not quiet and (code == PING or level == 2 or (level == 1 and code == READ)):
                replies.append((servo, status(servo_id, servo.error_byte(error), payload)))
        return replies


def _words(data: bytes) -> tuple[int, int]:
    return int.from_bytes(data[:2], "little"), int.from_bytes(data[2:4], "little")


def _single(servo: ServoFirmware, code: int, data: bytes, now: float) -> tuple[int, bytes]:
    """Execute an instruction for one servo and return (error number, parameters of the reply)."""
    if code == PING:
        return OK, servo.table.get("model").to_bytes(2, "little") + bytes((servo.table.get("firmware"),))
    if code == READ:
        return servo.read(*_words(data), now) if len(data) == 4 else (LENGTH, b"")
    if code in (WRITE, REG_WRITE):
        if len(data) < 3:
            return LENGTH, b""
        address = int.from_bytes(data[:2], "little")
        if code == REG_WRITE:
            return servo.register_write(address, data[2:]), b""
        return servo.write(address, data[2:], now), b""
    if code == ACTION:
        return servo.action(now), b""
    if code == REBOOT:
        servo.reboot(now)
        return OK, b""
    return INSTRUCTION, b""


def _chain(
    present: list[ServoFirmware], wanted: Sequence[tuple[int, int, int]], now: float
) -> list[tuple[ServoFirmware, bytes]]:
    """Return the replies to a sync read; each waits for the one before, so a missing servo ends them."""
    replies = []
    for servo_id, address, length in wanted:
        answering = [servo for servo in _named(present, servo_id) if servo.table.get("status_return_level")]
        if not answering:
            break
        for servo in answering:
            error, payload = servo.read(address, length, now)
            replies.append((servo, status(servo_id, servo.error_byte(error), payload)))
    return replies


def _named(present: list[ServoFirmware], servo_id: int) -> list[ServoFirmware]:
    return [servo for servo in present if servo.servo == servo_id]


def _sync_write(present: list[ServoFirmware], data: bytes, now: float) -> None:
    address, length = _words(data)
    for at in range(4, len(data) - length, length + 1):
        for servo in _named(present, data[at]):
            servo.write(address, data[at + 1 : at + 1 + length], now)


def _protocol_1(instruction: Instruction, present: list[ServoFirmware]) -> list[tuple[ServoFirmware, bytes]]:
    """Answer a ping, or a read of the model number (310), as a servo with Protocol 1.0 firmware."""
    for servo in present:
        if servo.servo != instruction.servo or not instruction.intact:
            continue
        if instruction.code == PING:
            return [(servo, status_1(servo.servo, 0))]
        if instruction.code == READ and instruction.parameters == b"\0\2":
            return [(servo, status_1(servo.servo, 0, (310).to_bytes(2, "little")))]
    return []
