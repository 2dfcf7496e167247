# SPDX-License-Identifier: Apache-2.0
"""Identify which device of the charger is on a serial port, and its speed. Writes no device register.

Sends only requests that are safe at any time: pings of servos, and HELLO to the board.
"""

import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from deltacharger_core import machine, servo_types
from deltacharger_driver import packets, ports
from deltacharger_driver.board.protocol import POWER_RATE, PacketType

SERVO_SPEEDS = (
    machine.BAUD_RATE,
    57600,
    *(speed for speed in servo_types.SPEEDS.values() if speed not in (machine.BAUD_RATE, 57600)),
)
"""Every speed of a servo, the likely ones first, bit/s."""
_PATIENCE = 0.05  # s; servos with ids up to about 15 answer a broadcast ping in this time
_LISTEN = 2.4 / POWER_RATE  # s in which a board sends POWER at least twice
_HELLO_WAIT = 0.15  # s
_ATTEMPTS = 4
_PING_REPLY = 14  # bytes
_PING_LENGTH = 64  # bytes; upper limit for a ping and the replies of an arm


@dataclass(frozen=True)
class FoundServo:
    """A servo that answered a ping.

    Attributes:
        servo: its id.
        speed: bit/s.
        protocol: 1 or 2.
        model: model number; 0 with Protocol 1.0, whose ping does not report it.
        firmware: version; 0 with Protocol 1.0.
        garbled: this id answered every ping with bytes but never with an intact reply: two servos share the id and
            answer at the same time.
    """

    servo: int
    speed: int
    protocol: int = 2
    model: int = 0
    firmware: int = 0
    garbled: bool = False

    def __str__(self) -> str:
        if self.garbled:
            return f"id {self.servo} at {self.speed} bit/s, garbled replies"
        if self.protocol == 1:
            return f"id {self.servo} at {self.speed} bit/s with Protocol 1.0"
        return f"id {self.servo} at {self.speed} bit/s, {servo_types.model_name(self.model)}, firmware {self.firmware}"


@dataclass(frozen=True)
class PortIdentity:
    """The device on a port.

    Attributes:
        port: its path.
        kind: "servos", "board", "silent" (no answer) or "other" (bytes that neither of them sends).
        details: description in words.
        servos: those that answered.
    """

    port: str
    kind: Literal["servos", "board", "silent", "other"]
    details: str
    servos: tuple[FoundServo, ...] = ()


def identify(
    path: str,
    speeds: Iterable[int] = SERVO_SPEEDS,
    ids: Iterable[int] = machine.SERVO_IDS,
    patience: float = _PATIENCE,
) -> PortIdentity:
    """Identify the device on a port: listen, send HELLO, then ping servos at every speed.

    Args:
        path: of the port; no other program may have it open.
        speeds: to try for servos, bit/s.
        ids: to ping with Protocol 1.0, which has no broadcast ping.
        patience: s to wait for replies to a broadcast ping; a servo answers 3 ms later per id.

    Raises:
        PortMissing, PortNotSerial, PortBusy, PortDenied, PortError: the port cannot be opened.
        PortGone: it vanished while being identified.
    """
    port = ports.RawPort(path, machine.BAUD_RATE)
    try:
        decoder = packets.PacketDecoder()
        decoder.feed(
            _receive(port, _LISTEN)
            + _exchange(port, packets.encode_packet(packets.Packet(PacketType.HELLO)), _HELLO_WAIT)
        )
        received = decoder.counters.bytes
        if decoder.counters.packets or decoder.counters.version_errors:
            return PortIdentity(path, "board", "the board")
        servos = find_servos(port, speeds, ids, patience)
    finally:
        port.close()
    if servos and not (received and all(servo.garbled for servo in servos)):
        return PortIdentity(path, "servos", "servos: " + "; ".join(map(str, servos)), tuple(servos))
    if received:
        return PortIdentity(path, "other", f"received {received} bytes that neither servos nor board send")
    return PortIdentity(path, "silent", "no answer at any speed")


def _receive(port: ports.RawPort, duration: float) -> bytes:
    """Return all bytes received within `duration` s."""
    received = bytearray()
    end = time.monotonic() + duration
    while (left := end - time.monotonic()) > 0.0:
        received += port.read(left)
    return bytes(received)


def find_servos(port: ports.RawPort, speeds: Iterable[int], ids: Iterable[int], patience: float) -> list[FoundServo]:
    """Ping all servos at each speed; arguments as in `identify`. The port stays at the last speed.

    Raises:
        PortGone: the port vanished.
    """
    found: list[FoundServo] = []
    latency = 2.0 * ports.latency_timer(port.port)
    ids = tuple(ids)
    for speed in speeds:
        port.set_speed(speed)
        wire = 10.0 * _PING_LENGTH / speed
        port.write(packets.instruction_packet(packets.BROADCAST, packets.PING))
        found += _ping_replies(_receive(port, patience + latency + wire), speed)
        known = {servo.servo for servo in found if not servo.garbled}
        for servo in (servo for servo in ids if servo not in known):
            found += _ask_one(port, servo, speed, 0.4 * _PATIENCE + latency + wire)
    return found


def _ask_one(port: ports.RawPort, servo: int, speed: int, wait: float) -> list[FoundServo]:
    """Ping one servo that did not answer the broadcast ping: its reply was lost, or it supports only Protocol 1.0."""
    answers = 0
    for _ in range(_ATTEMPTS):
        reply = _exchange(port, packets.instruction_packet(servo, packets.PING), wait)
        found = [one for one in _ping_replies(reply, speed) if one.servo == servo]
        if found:
            return found
        if not reply:
            break
        answers += 1
    status_1, ping_1 = b"\xff\xff" + bytes((servo, 2)), b"\xff\xff" + bytes((servo, 2, 1, ~(servo + 3) & 0xFF))
    if status_1 in _exchange(port, ping_1, wait):  # without parameters both begin alike
        return [FoundServo(servo, speed, protocol=1)]
    return [FoundServo(servo, speed, garbled=True)] if answers == _ATTEMPTS else []


def _exchange(port: ports.RawPort, question: bytes, wait: float) -> bytes:
    """Send `question` and return the bytes received within `wait` s, without the echo that some adapters give."""
    port.write(question)
    return _receive(port, wait).replace(question, b"")


def _ping_replies(data: bytes, speed: int) -> list[FoundServo]:
    """Return the servos with an intact ping reply in `data`."""
    found = []
    start = data.find(packets.HEADER)
    while start >= 0:
        reply = data[start : start + _PING_REPLY]
        length = int.from_bytes(reply[5:7], "little")
        intact = len(reply) == _PING_REPLY and length == _PING_REPLY - 7 and reply[7] == packets.STATUS
        if intact and packets.crc16(reply[:-2]) == int.from_bytes(reply[-2:], "little"):
            model = int.from_bytes(reply[9:11], "little")
            found.append(FoundServo(reply[4], speed, model=model, firmware=reply[11]))
        start = data.find(packets.HEADER, start + 1)
    return found
