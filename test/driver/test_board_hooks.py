# SPDX-License-Identifier: Apache-2.0
"""Test hooks of the emulated board: slow boots, late packets, and callbacks for samplings and heartbeats."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import pytest

from deltacharger_driver.board.protocol import Packet, PacketDecoder, PacketType, encode_packet
from deltacharger_driver.emulators.bench_plant import BenchPlant
from deltacharger_driver.emulators.board import BoardEmulator

STEP = 0.001


class Host:
    """Exchanges packets with a board, with its own clock."""

    def __init__(self, build: Callable[[BenchPlant], BoardEmulator] = BoardEmulator) -> None:
        self.now = 100.0
        self.plant = BenchPlant(clock=lambda: self.now)
        self.board = build(self.plant)
        self._decoder = PacketDecoder()
        self._sequence = 0

    def send(self, type: PacketType, payload: bytes = b"") -> list[Packet]:
        self._sequence += 1
        packet = encode_packet(Packet(type, payload, self._sequence))
        return self._decoder.feed(self.board.receive(packet, self.now))

    def run(self, seconds: float, beating: bool = False) -> list[Packet]:
        """Advance time in steps of 1 ms, as a pseudo-terminal does, and return received packets."""
        packets = []
        for number in range(round(seconds / STEP)):
            self.now += STEP
            if beating and number % 20 == 0:
                packets += self.send(PacketType.HEARTBEAT)
            packets += self._decoder.feed(self.board.poll(self.now))
        return packets


def types(packets: list[Packet]) -> list[int]:
    return [packet.type for packet in packets]


def test_a_booting_board_neither_receives_nor_sends() -> None:
    host = Host(lambda plant: BoardEmulator(plant, boot_time=0.5))
    assert host.run(0.4) == []
    assert host.send(PacketType.START) == []
    assert host.run(0.098) == []
    packets = host.run(0.1)
    assert types(packets)[0] == PacketType.HELLO
    assert packets[0].device_time_us == 0  # its clock starts with it
    assert PacketType.ACK not in types(packets)
    assert PacketType.ACK in types(host.send(PacketType.START))


def test_a_reboot_first_opens_the_contactor_and_lasts_its_boot_time() -> None:
    host = Host()
    host.run(0.05)
    host.send(PacketType.PROBE)
    host.run(0.2, beating=True)
    host.send(PacketType.CONTACTOR, b"\1")
    host.run(0.3, beating=True)
    assert host.plant.read_power()[3]
    host.board.reboot(0.25)
    assert host.board.next_event(host.now) == 0.0
    assert host.run(STEP) == []
    assert not host.plant.read_power()[3]
    assert not host.board.contactor_commanded
    assert host.board.next_event(host.now) == pytest.approx(0.25)
    assert host.run(0.248) == []
    assert PacketType.HELLO in types(host.run(0.005))


def test_a_late_wire_keeps_the_order_and_loses_nothing() -> None:
    host = Host()
    host.send(PacketType.START)
    host.run(0.5)
    host.board.faults.delay = 0.1
    assert host.run(0.1 - STEP) == []
    host.run(0.2)
    host.board.faults.delay = 0.0
    first = host.run(1.0)
    sequences = [packet.sequence for packet in first if packet.type == PacketType.TACTILE]
    assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
    assert len(sequences) == pytest.approx(120 + 12, abs=2)  # delayed ones arrived too
    assert [packet.device_time_us for packet in first] == sorted(packet.device_time_us for packet in first)


def test_a_late_answer_wakes_the_server_when_it_is_due() -> None:
    host = Host()
    host.run(0.01)
    host.board.faults.delay = 0.03
    assert host.send(PacketType.PING, b"x") == []
    assert 0.0 < host.board.next_event(host.now) < 0.031
    assert PacketType.PING in types(host.run(0.031))


def test_recorders_get_every_sampling_and_every_heartbeat() -> None:
    samples: list[tuple[int, float, float]] = []
    beats: list[float] = []

    def build(plant: BenchPlant) -> BoardEmulator:
        return BoardEmulator(plant, on_sample=lambda *sample: samples.append(sample), on_heartbeat=beats.append)

    host = Host(build)
    host.run(0.01)
    host.send(PacketType.START)
    started = host.now
    frames = [packet for packet in host.run(1.0, beating=True) if packet.type == PacketType.TACTILE]
    assert [sequence for sequence, _, _ in samples][-len(frames) :] == [packet.sequence for packet in frames]
    for number, (_, nominal, real) in enumerate(samples):
        assert nominal == pytest.approx(started + number / 120.0, abs=1e-6)
        assert 0.0 <= real - nominal <= STEP + 1e-9
    assert len(beats) == 50
    assert all(math.isclose(later - earlier, 0.02) for earlier, later in itertools.pairwise(beats))
