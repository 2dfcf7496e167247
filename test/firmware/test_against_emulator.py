# SPDX-License-Identifier: Apache-2.0
"""The same random session on the emulated board and on the firmware: every answer, fault and command must match."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest

from deltacharger_core.machine import ChargeLimits
from deltacharger_driver.board.protocol import (
    PacketType,
    decode_ack,
    decode_hello,
    decode_power,
    encode_close,
    encode_limit,
)
from deltacharger_driver.emulators.board import BoardEmulator
from deltacharger_driver.packets import Packet, PacketDecoder, encode_packet

from ..plants import BenchPlant
from .board_host import FirmwareBoard, FirmwarePlant

pytestmark = pytest.mark.usefixtures("firmware_boards")

STEP = 0.005
PROBE_TIME = 0.152  # ends between two steps, whatever the rounding
LIMITS = ChargeLimits(18.0, 29.4)
CLOSE, CLOSE_DEAD = encode_close(LIMITS), encode_close(LIMITS._replace(dead=True))
RATE, CONTACTOR, PROBE, PING = PacketType.RATE, PacketType.CONTACTOR, PacketType.PROBE, PacketType.PING
COMMANDS = [
    *((PacketType[name], b"") for name in ("HELLO", "START", "STOP", "TARE", "TACTILE", "ACK")),
    *((RATE, payload) for payload in (struct.pack("<f", 60.0), struct.pack("<f", 0.05), b"")),
    *((PING, payload) for payload in (b"ping", bytes(65))),
    *((CONTACTOR, payload) for payload in (encode_limit(5.0), encode_limit(0.0), CLOSE_DEAD, CLOSE, b"\1", b"\2")),
    *((PROBE, payload) for payload in (b"x", b"")),
    *((PacketType.POWER, bytes(16)), (200, bytes(230))),
    *((PacketType.SERVO, b"servo"), (PacketType.SERVO_SPEED, struct.pack("<I", 57600))),  # neither board has a bus
]
NAN = math.nan
TROUBLES: list[tuple[dict[str, Any], float]] = [  # of a closed contactor; s until it opens
    ({"welded": True, "detected": 9}, 0.3),
    ({"dropped": True}, 0.1),
    ({"measured": {"current": 20.1}}, 0.05),
    ({"measured": {"current": -5.1}}, 0.05),
    ({"measured": {"current": -0.6}}, 0.13),
    ({"measured": {"current": 0.04}}, 0.25),
    ({"measured": {"current": NAN}}, 0.15),
    ({"measured": {"target": -1.0}}, 0.05),
    ({"measured": {"target": 1.9, "current": 5.0}}, 0.05),
    ({"measured": {"target": 9.9}}, 0.15),
    ({"measured": {"target": 29.8}}, 0.15),
    ({"measured": {"target": NAN}}, 0.15),
    ({"measured": {"battery": 29.9}}, 0.15),
    ({"measured": {"battery": 22.6}}, 5.05),
    ({"measured": {"battery": NAN}}, 0.15),
]
HEALTHY: dict[str, Any] = {"welded": False, "dropped": False, "measured": {}, "detected": 0}


class Side:
    """One of the two boards with its plant."""

    def __init__(self, board: BoardEmulator | FirmwareBoard, plant: BenchPlant | FirmwarePlant) -> None:
        self.board = board
        self.plant = plant
        self.decoder = PacketDecoder()
        self.received: list[Packet] = []

    def take(self, data: bytes) -> None:
        self.received += self.decoder.feed(data)

    def story(self) -> list[object]:
        """Return the state, and the packets to the host since the last call, without frames and figures of power."""
        events: list[object] = [self.board.contactor_commanded, self.board.fault]
        powers: list[object] = []  # which come at each board's own times
        for packet in self.received:
            if packet.type == PacketType.ACK:
                events.append(decode_ack(packet.payload))
            elif packet.type == PacketType.HELLO:
                events.append(decode_hello(packet.payload).rate)
            elif packet.type == PING:
                events.append(packet.payload)
            elif packet.type == PacketType.POWER:
                powers.append((packet.sequence, decode_power(packet.payload).fault))
        self.received.clear()
        return events + powers


class Day:
    """Both boards and one host, on one clock."""

    def __init__(self) -> None:
        self.now = self.began = 100.0
        plant, firmware_plant = BenchPlant(noise=0.0, clock=lambda: self.now), FirmwarePlant(noise=0.0)
        board = BoardEmulator(plant)
        board._power._probe_time = PROBE_TIME
        self.sides = (
            Side(board, plant),
            Side(FirmwareBoard(firmware_plant, probe_time=PROBE_TIME), firmware_plant),
        )
        self.sequence = 0
        self.beating = True
        self.next_beat = self.now
        for side in self.sides:
            side.take(side.board.poll(self.now))
        self.now += 1e-6

    def send(self, *commands: tuple[int, bytes], flags: int = 0, format: int = 0) -> None:
        """Send several packets at once."""
        wire = b""
        for type, payload in commands:
            wire += encode_packet(Packet(type, payload, self.sequence, flags=flags, format=format))
            self.sequence += 1
        for side in self.sides:
            side.take(side.board.receive(wire, self.now))

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP)):
            self.now += STEP
            if self.beating and self.now >= self.next_beat - 1e-4:
                self.send((PacketType.HEARTBEAT, b""))
                self.next_beat = self.now + 0.02
            for side in self.sides:
                side.take(side.board.poll(self.now))

    def settle(self) -> None:
        """Wait until 20 to 30 ms after a POWER packet: each board checks its detectors at its own times."""
        phase = round(1e3 * (self.now - self.began)) % 50
        if not 20 <= phase <= 30:
            self.run(1e-3 * ((20 - phase) % 50))

    def compare(self) -> None:
        """Assert that both boards have told the same since the last call."""
        self.settle()
        emulated, firmware = (side.story() for side in self.sides)
        assert firmware == emulated

    def set(self, **values: Any) -> None:
        """Change both plants."""
        for side in self.sides:
            for name, value in values.items():
                setattr(side.plant, name, value)

    def reach(self, state: str) -> None:
        """Open, probed or closed on a healthy circuit."""
        self.set(**HEALTHY, resistance=2.0, target=24.0)
        self.send((CONTACTOR, b"\0"))
        self.run(0.1)
        if state != "open":
            self.send((PROBE, b""))
            self.run(0.2)
        if state == "closed":
            self.send((CONTACTOR, CLOSE))
            self.run(0.3)


@pytest.mark.parametrize("state", ["open", "probed", "closed"])
def test_every_command_has_the_same_effect_on_both_boards(state: str) -> None:
    day = Day()
    for type, payload in COMMANDS:
        for headers in ({}, {"flags": 1}, {"format": 2}):
            day.reach(state)
            day.compare()
            day.send((type, payload), (PROBE, b""), (CONTACTOR, b"\0"), (type, payload), **headers)
            day.run(0.2)
            day.send((type, payload), **headers)
            day.run(0.2)
            day.compare()


@pytest.mark.parametrize(("changes", "seconds"), TROUBLES)
def test_every_trouble_ends_the_same_on_both_boards(changes: dict[str, Any], seconds: float) -> None:
    day = Day()
    for lasts, resistance in ((0.015, 2.0), (0.3, math.inf), (seconds, 2.0)):  # the emulator checks every 10 ms
        day.reach("closed")
        day.settle()
        day.set(**changes)
        day.run(lasts)
        day.set(measured={})
        day.compare()
        for command in ((CONTACTOR, b"\0"), (PROBE, b""), (CONTACTOR, CLOSE), (CONTACTOR, b"\2")):
            day.send(command)
            day.run(0.2)
            day.compare()
            day.set(**HEALTHY, resistance=resistance)
    day.beating = False
    day.run(0.2)
    day.compare()
