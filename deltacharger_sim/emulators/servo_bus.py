# SPDX-License-Identifier: Apache-2.0
"""Emulated servos on a bus: bytes in, bytes out, with injected faults. docs/emulators.md lists what is not simulated.

Serve it on a `PseudoTerminal` and open the terminal's path like any serial port.
"""

import functools
import itertools
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from deltacharger_core import machine, servo_types
from deltacharger_driver import errors, packets
from deltacharger_sim.emulators.servo import CHECKSUM, INSTRUCTION, LENGTH, OK, ServoFirmware, ServoPlant
from deltacharger_sim.emulators.wire import DelayLine, WireFaults

STUFFED = packets.PLAIN + b"\xfd"

_LONGEST = 1024  # bytes of a packet; a longer length is noise
_SILENCE = 0.02  # s without a byte after which an incomplete packet is discarded


@dataclass(frozen=True)
class Instruction:
    """One instruction packet.

    Attributes:
        servo: id of the addressed servo, or BROADCAST.
        code: instruction.
        parameters: unstuffed.
        intact: whether its checksum is right.
    """

    servo: int
    code: int
    parameters: bytes
    intact: bool


def status(servo: int, error: int, parameters: bytes = b"") -> bytes:
    """Return the status packet (Protocol 2.0) of a servo."""
    return packets.servo_packet(servo, bytes((packets.STATUS, error)) + parameters)


def _interrupted(body: bytearray) -> bool:
    """Return whether an unstuffed header precedes the checksum: a servo restarts its parser there."""
    if packets.PLAIN not in body:
        return False
    at = body.replace(STUFFED, b"\0\0\0\0").find(packets.PLAIN)
    return 0 <= at < len(body) - 4


class InstructionParser:
    """Finds instruction packets in a stream of bytes; skips anything else, as a servo does."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._heard = 0.0

    def feed(self, data: bytes, now: float) -> list[Instruction]:
        """Take `data`, received at `now` (s), and return the packets completed by it."""
        if now - self._heard > _SILENCE:
            self._buffer.clear()
        self._heard = now
        self._buffer += data
        found = []
        while (instruction := self._next()) is not None:
            found.append(instruction)
        return found

    def _next(self) -> Instruction | None:
        buffer = self._buffer
        while True:
            start = buffer.find(b"\xff\xff")
            if start < 0:
                del buffer[: max(len(buffer) - 1, 0)]
                return None
            del buffer[:start]
            if len(buffer) < 4:
                return None
            if buffer.startswith(packets.HEADER):
                if len(buffer) < 10:
                    return None
                size = int.from_bytes(buffer[5:7], "little") + 7
                if 10 <= size <= _LONGEST and not _interrupted(buffer[7:size]):
                    return self._take(size) if len(buffer) >= size else None
            del buffer[0]

    def _take(self, size: int) -> Instruction:
        packet = bytes(self._buffer[:size])
        del self._buffer[:size]
        parameters = packet[8:-2]
        if STUFFED in packet:
            parameters = packet[7:-2].replace(STUFFED, packets.PLAIN)[1:]
        intact = packets.crc16(packet[:-2]) == int.from_bytes(packet[-2:], "little")
        return Instruction(packet[4], packet[7], parameters, intact)


def collide(first: bytes, second: bytes) -> bytes:
    """Return what the line carries if a second reply begins a byte after the first: a bit that is 0 in either wins."""
    pairs = itertools.zip_longest(first, b"\xff" + second, fillvalue=0xFF)
    return bytes(one & other for one, other in pairs)


class ServoBusEmulator:
    """Emulated servos with Protocol 2.0 on one bus, a `ByteDevice` for `PseudoTerminal`.

    Their configuration is the one the driver expects on the robot: 1 Mbit/s, everything else as from the factory.

    Args:
        plant: their physics; servo i of the bus is servo i of the plant.
        ids: of the servos, in the plant's order.
        line_speed: returns the host's speed, bit/s, such as `PseudoTerminal.speed`; servos receive nothing at another
            speed than theirs. None = any.
        seed: of the random faults.
        kind: type of the servos.

    Attributes:
        faults: injected faults; may be changed at any time.
        line_speed: as above; may be set later, once the terminal exists.
    """

    def __init__(
        self,
        plant: ServoPlant,
        ids: Sequence[int] = machine.SERVO_IDS,
        line_speed: Callable[[], int] | None = None,
        seed: int = 0,
        kind: servo_types.ServoType = servo_types.MX_64,
    ) -> None:
        self.faults = WireFaults(seed, head=7)  # up to the length: the checksum must detect the damage
        self.line_speed = line_speed
        self._lock = threading.RLock()
        self._parser = InstructionParser()
        self._servos = [ServoFirmware(plant, index, servo, kind) for index, servo in enumerate(ids)]
        self._wire = DelayLine()

    def servo(self, servo: int) -> ServoFirmware:
        """Return the emulated servo with id `servo`, to inspect its registers or break it.

        Raises:
            DriverError: no servo has this id.
        """
        for firmware in self._servos:
            if firmware.servo == servo:
                return firmware
        raise errors.DriverError(f"no emulated servo {servo}; there are {[f.servo for f in self._servos]}")

    def alter(self, place: int, change: Callable[[ServoFirmware], None]) -> None:
        """Apply `change` between two instructions to the servo at `place` in `ids`, whatever its present id."""
        with self._lock:
            change(self._servos[place])

    def receive(self, data: bytes, now: float) -> bytes:
        """Take bytes from the host and return the replies that are due at once."""
        with self._lock:
            if not self.faults.deaf:
                for instruction in self._parser.feed(data, now):
                    self._execute(instruction, now)
            return self._wire.arrived(now)

    def poll(self, now: float) -> bytes:
        """Advance time and return the replies due now."""
        with self._lock:
            for servo in self._servos:
                servo.tick(now)
            return self._wire.arrived(now)

    def next_event(self, now: float) -> float:
        """Return the seconds until `poll` is needed; inf for never."""
        with self._lock:
            waits = [servo.next_event(now) for servo in self._servos]
            return max(min(*waits, self._wire.due - now), 0.0)

    def _execute(self, instruction: Instruction, now: float) -> None:
        speed = self.line_speed() if self.line_speed is not None else None
        present = [
            servo
            for servo in self._servos
            if servo.answers(now) and servo.servo not in self.faults.missing and speed in (None, servo.speed)
        ]
        self._send(self._replies(instruction, present, now), now)

    def _send(self, replies: list[tuple[ServoFirmware, bytes]], start: float) -> None:
        """Queue replies one after another; replies of servos with the same id collide."""
        for _, group in itertools.groupby(replies, key=lambda item: item[0].servo):
            together = list(group)
            servo = together[0][0]
            reply = functools.reduce(collide, (each for _, each in together))
            start += servo.return_delay
            if damaged := self.faults.apply(reply, servo.servo):
                self._wire.send(damaged, start + self.faults.delay)

    def _replies(
        self, instruction: Instruction, present: list[ServoFirmware], now: float
    ) -> list[tuple[ServoFirmware, bytes]]:
        addressed = [servo for servo in present if instruction.servo in (packets.BROADCAST, servo.servo)]
        addressed.sort(key=lambda servo: servo.servo)  # each waits for those with lower ids
        if not instruction.intact:
            if instruction.servo == packets.BROADCAST:
                return []
            return [(servo, status(servo.servo, servo.error_byte(CHECKSUM))) for servo in addressed]
        for servo in addressed:
            servo.note_instruction(now)
        code, data = instruction.code, instruction.parameters
        if code == packets.SYNC_READ:
            address, length = _words(data)
            return _chain(present, [(servo, address, length) for servo in data[4:]], now)
        if code == packets.SYNC_WRITE:
            _sync_write(present, data, now)
            return []
        replies = []
        for servo in addressed:
            # The state before the instruction decides whether a servo answers: a reboot is still confirmed.
            level, servo_id = servo.table.get("status_return_level"), servo.servo
            error, payload = _single(servo, code, data, now)
            quiet = instruction.servo == packets.BROADCAST and code != packets.PING
            if not quiet and (code == packets.PING or level == 2 or (level == 1 and code == packets.READ)):
                replies.append((servo, status(servo_id, servo.error_byte(error), payload)))
        return replies


def _words(data: bytes) -> tuple[int, int]:
    return int.from_bytes(data[:2], "little"), int.from_bytes(data[2:4], "little")


def _single(servo: ServoFirmware, code: int, data: bytes, now: float) -> tuple[int, bytes]:
    """Execute an instruction for one servo and return (error number, parameters of the reply)."""
    if code == packets.PING:
        return OK, servo.table.get("model").to_bytes(2, "little") + bytes((servo.table.get("firmware"),))
    if code == packets.READ:
        return servo.read(*_words(data), now) if len(data) == 4 else (LENGTH, b"")
    if code == packets.WRITE:
        return (servo.write(int.from_bytes(data[:2], "little"), data[2:], now) if len(data) >= 3 else LENGTH), b""
    if code == packets.REBOOT:
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
