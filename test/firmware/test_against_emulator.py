# SPDX-License-Identifier: Apache-2.0
"""The same random session on the emulated board and on the firmware: every answer, fault and command must match."""

from __future__ import annotations

import random
import struct

import numpy as np
import numpy.typing as npt
import pytest

from deltacharger_driver.board.payloads import decode_ack, decode_hello, decode_power, decode_samples
from deltacharger_driver.board.protocol import FLAG_TARED, Packet, PacketDecoder, PacketType, encode_packet
from deltacharger_driver.emulators.bench_plant import BenchPlant
from deltacharger_driver.emulators.board import BoardEmulator

from ..marks import night, rest
from .board_host import FirmwareBoard, FirmwarePlant

pytestmark = pytest.mark.usefixtures("firmware_boards")

STEP = 0.005
PROBE_TIME = 0.152  # ends between two steps, whatever the rounding
COMMANDS = [
    *[(PacketType.CONTACTOR, b"\1")] * 6,
    *[(PacketType.CONTACTOR, b"\0")] * 2,
    *[(PacketType.PROBE, b"")] * 6,
    *[(PacketType.TARE, b"")] * 3,
    (PacketType.HELLO, b""),
    (PacketType.START, b""),
    (PacketType.STOP, b""),
    (PacketType.RATE, struct.pack("<f", 60.0)),
    (PacketType.RATE, struct.pack("<f", 0.05)),
    (PacketType.CONTACTOR, b"\2"),
    (PacketType.PROBE, b"x"),
    (PacketType.RATE, b""),
    (PacketType.PING, b"ping"),
    (PacketType.PING, bytes(65)),
    (PacketType.TACTILE, b""),
    (PacketType.POWER, bytes(16)),
    (PacketType.ACK, b""),
    (200, bytes(230)),
    (PacketType.SERVO, b"servo"),  # neither board has a bus
    (PacketType.SERVO_SPEED, struct.pack("<I", 57600)),
]


class Side:
    """One of the two boards with its plant."""

    def __init__(self, board: BoardEmulator | FirmwareBoard, plant: BenchPlant | FirmwarePlant) -> None:
        self.board = board
        self.plant = plant
        self.decoder = PacketDecoder()
        self.received: list[Packet] = []

    def take(self, data: bytes) -> None:
        self.received += self.decoder.feed(data)

    def story(self) -> list[tuple[object, ...]]:
        """Return the packets to the host since the last call, in order, except frames and power."""
        events: list[tuple[object, ...]] = []
        for packet in self.received:
            if packet.type == PacketType.ACK:
                ack = decode_ack(packet.payload)
                events.append(("ack", ack.type, ack.error, ack.sequence, ack.data))
            elif packet.type == PacketType.HELLO:
                events.append(("hello", decode_hello(packet.payload).rate))
            elif packet.type == PacketType.PING:
                events.append(("ping", packet.payload))
        return events

    def state(self) -> tuple[object, ...]:
        powers = [packet for packet in self.received if packet.type == PacketType.POWER]
        return (
            self.board.contactor_commanded,
            self.board.fault,
            self.board.unknown_types,
            [(packet.sequence, decode_power(packet.payload).fault) for packet in powers],
        )

    def frame(self) -> tuple[int, npt.NDArray[np.float32]]:
        """Flags and forces of the last frame."""
        packet = [packet for packet in self.received if packet.type == PacketType.TACTILE][-1]
        return packet.flags & FLAG_TARED, np.stack(decode_samples(packet.payload, packet.format))


class Day:
    """Both boards and one host, on one clock."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.now = self.began = 100.0
        plant = BenchPlant(noise=0.0, clock=lambda: self.now)
        firmware_plant = FirmwarePlant(noise=0.0)
        self.sides = (
            Side(BoardEmulator(plant, probe_time=PROBE_TIME), plant),
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
            self.send((PacketType.CONTACTOR, b"\0"))  # an older probe is not valid for the new circuit
        for side in self.sides:
            side.plant.press(force)
            side.plant.detected = detected
            if not closed:
                side.plant.resistance, side.plant.target = resistance, target
        self.run(0.1)

    def change_taxel(self) -> None:
        """Make a taxel dead, or live again."""
        taxel, dead = self.random.choice(((0, 1, 2), (0, 5, 5), (1, 9, 0))), self.random.random() < 0.5
        for side in self.sides:
            side.board.set_dead(*taxel, dead)

    def do_something(self) -> None:
        deed = self.random.random()
        if deed < 0.1:
            self.change_plant()
        elif deed < 0.15:
            self.beating = not self.beating
        elif deed < 0.25:
            self.change_taxel()
        else:
            type, payload = self.random.choice(COMMANDS)
            flags, sample_format = self.random.choice(((0, 0),) * 20 + ((1, 0), (0, 2)))
            more = self.random.choices(COMMANDS, k=self.random.choice((0, 0, 0, 3)))
            self.send((type, payload), *more, flags=flags, format=sample_format)
            if any(each[0] == PacketType.CONTACTOR for each in ((type, payload), *more)):
                self.run(0.1)  # the plants' contactors differ by some milliseconds
        self.run(self.random.choice((0.01, 0.05, 0.2, 0.2, 0.5)))
        # Each board checks its detectors at its own times, so nothing must happen just before a POWER packet.
        phase = round(1e3 * (self.now - self.began)) % 50
        if not 20 <= phase <= 30:
            self.run(1e-3 * ((20 - phase) % 50))


@pytest.mark.parametrize(("seed", "deeds"), [(3, 20), rest(0, 120), *(night(seed, 120) for seed in range(1, 8))])
def test_a_random_session_is_the_same_on_both_boards(seed: int, deeds: int) -> None:
    day = Day(seed)
    emulated, firmware = day.sides
    for _ in range(deeds):
        day.do_something()
        assert firmware.story() == emulated.story()
        assert firmware.state() == emulated.state()
        for side in day.sides:
            side.received.clear()
    day.send((PacketType.START, b""))
    day.run(0.3)
    (emulated_flags, emulated_forces), (flags, forces) = emulated.frame(), firmware.frame()
    assert flags == emulated_flags
    np.testing.assert_allclose(forces, emulated_forces, atol=0.003)
