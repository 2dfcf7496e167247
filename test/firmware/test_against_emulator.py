# SPDX-License-Identifier: Apache-2.0
"""The same random session on the emulated board and on the firmware: every answer, fault and command must match."""

from __future__ import annotations

import math
import random
import struct
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from deltacharger_core.machine import ChargeLimits
from deltacharger_driver.board.protocol import (
    FLAG_TARED,
    PacketType,
    decode_ack,
    decode_hello,
    decode_power,
    decode_samples,
    encode_close,
    encode_limit,
)
from deltacharger_driver.emulators.board import BoardEmulator
from deltacharger_driver.packets import Packet, PacketDecoder, encode_packet

from ..marks import night, rest
from ..plants import BenchPlant
from .board_host import FirmwareBoard, FirmwarePlant

pytestmark = pytest.mark.usefixtures("firmware_boards")

STEP = 0.005
PROBE_TIME = 0.152  # ends between two steps, whatever the rounding
LIMITS = ChargeLimits(18.0, 29.4)
CLOSE, CLOSE_DEAD = encode_close(LIMITS), encode_close(LIMITS._replace(dead=True))
RATE, CONTACTOR, PING = PacketType.RATE, PacketType.CONTACTOR, PacketType.PING
COMMANDS = [
    *[(CONTACTOR, CLOSE), (PacketType.PROBE, b"")] * 6,
    *[(CONTACTOR, b"\0")] * 2,
    *[(PacketType.TARE, b"")] * 3,
    *((PacketType[name], b"") for name in ("HELLO", "START", "STOP", "TACTILE", "ACK")),
    *((RATE, payload) for payload in (struct.pack("<f", 60.0), struct.pack("<f", 0.05), b"")),
    *((PING, payload) for payload in (b"ping", bytes(65))),
    *[(CONTACTOR, b"\2")] * 2,
    *((CONTACTOR, payload) for payload in (encode_limit(5.0), encode_limit(0.0), CLOSE_DEAD, b"\1")),
    *((PacketType.PROBE, b"x"), (PacketType.POWER, bytes(16)), (200, bytes(230))),
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

    def frame(self) -> tuple[int, npt.NDArray[np.float32]]:
        """Flags and forces of the last frame."""
        packet = [packet for packet in self.received if packet.type == PacketType.TACTILE][-1]
        return packet.flags & FLAG_TARED, np.stack(decode_samples(packet.payload))


class Day:
    """Both boards and one host, on one clock."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
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

    def change_plant(self) -> None:
        """Change charge circuit or touch; the two plants differ while a contactor closes or opens."""
        resistance, target = self.random.choice((0.5, 2.0, 2.0, 20.0)), self.random.choice((24.0, 24.0, -24.0))
        force = self.random.choice((0.0, 0.0, 8.0))
        detected = self.random.choice((0, 0, 0, 2, 5, 9))
        closed = self.sides[0].board.contactor_commanded
        if not closed:
            self.send((CONTACTOR, b"\0"))  # an older probe is not valid for the new circuit
        for side in self.sides:
            side.plant.press(force)
            side.plant.detected = detected
            if not closed:
                side.plant.resistance, side.plant.target = resistance, target
        self.run(0.1)

    def set(self, **values: Any) -> None:
        """Change both plants."""
        for side in self.sides:
            for name, value in values.items():
                setattr(side.plant, name, value)

    def charge(self) -> None:
        """Probe and close a healthy circuit, and let current flow."""
        self.set(**HEALTHY, resistance=2.0, target=24.0)
        self.beating = True
        self.send((CONTACTOR, b"\0"))
        self.run(0.1)
        self.send((PacketType.PROBE, b""))
        self.run(0.2)
        self.send((CONTACTOR, CLOSE))
        self.run(0.3)

    def trouble(self) -> None:
        """Charge, let the power stage fail for a while or a moment, and cure it."""
        self.charge()
        changes, seconds = self.random.choice(TROUBLES)
        self.set(**changes)
        self.run(self.random.choice((0.015, 0.3, seconds)))  # the emulator checks every 10 ms
        self.set(measured={})
        self.send((CONTACTOR, b"\0"))
        self.run(0.2)
        self.set(**HEALTHY, resistance=self.random.choice((2.0, math.inf)))
        self.run(0.1)

    def do_something(self) -> None:
        deed = self.random.random()
        if deed < 0.1:
            self.change_plant()
        elif deed > 0.9:
            self.trouble()
        elif deed < 0.15:
            self.beating = not self.beating
        elif deed < 0.25:
            taxel, dead = self.random.choice(((0, 1, 2), (0, 5, 5), (1, 9, 0))), self.random.random() < 0.5
            for side in self.sides:
                side.board.set_dead(*taxel, dead)
        else:
            type, payload = self.random.choice(COMMANDS)
            flags, sample_format = self.random.choice(((0, 0),) * 20 + ((1, 0), (0, 2)))
            more = self.random.choices(COMMANDS, k=self.random.choice((0, 0, 0, 3)))
            self.send((type, payload), *more, flags=flags, format=sample_format)
            if any(each[0] == CONTACTOR for each in ((type, payload), *more)):
                self.run(0.1)  # the plants' contactors differ by some milliseconds
        self.run(self.random.choice((0.01, 0.05, 0.2, 0.2, 0.5)))
        # Each board checks its detectors at its own times, so nothing must happen just before a POWER packet.
        phase = round(1e3 * (self.now - self.began)) % 50
        if not 20 <= phase <= 30:
            self.run(1e-3 * ((20 - phase) % 50))


@pytest.mark.parametrize(("seed", "deeds"), [(3, 12), rest(0, 120), *(night(seed, 120) for seed in range(1, 8))])
def test_a_random_session_is_the_same_on_both_boards(seed: int, deeds: int) -> None:
    day = Day(seed)
    emulated, firmware = day.sides
    for _ in range(deeds):
        day.do_something()
        assert firmware.story() == emulated.story()
    day.send((PacketType.START, b""))
    day.run(0.3)
    (emulated_flags, emulated_forces), (flags, forces) = emulated.frame(), firmware.frame()
    assert flags == emulated_flags
    np.testing.assert_allclose(forces, emulated_forces, atol=0.003)
