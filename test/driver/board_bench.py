# SPDX-License-Identifier: Apache-2.0
"""A board in simulated time: every `now` is passed in. Its tests also run on the firmware (test/firmware)."""

from __future__ import annotations

from typing import Any

import pytest

from deltacharger_core.machine import ChargeLimits
from deltacharger_driver.board import protocol
from deltacharger_driver.packets import Packet, PacketDecoder, encode_packet
from deltacharger_sim.emulators.board import BoardEmulator

from ..plants import BenchPlant

STEP = 0.005
LIMITS = ChargeLimits(current=1.0, voltage=29.4, gap_time=0.2)
CLOSE = protocol.encode_close(LIMITS)


class Bench:
    """A board, its plant and a host that sends only on command; `run` advances time."""

    def __init__(self, hooks: dict[str, Any] | None = None, **plant: float) -> None:
        self.now = 100.0
        self.plant = BenchPlant(clock=lambda: self.now, **plant)  # type: ignore[arg-type]
        self.board = BoardEmulator(self.plant, seed=7, **(hooks or {}))
        self.decoder = PacketDecoder()
        self.packets: list[Packet] = []
        self.sequence = 0
        self.beating = False
        self.take(self.board.poll(self.now))
        self.now += 1e-7  # so that rounding never delays a due event

    def take(self, data: bytes) -> list[Packet]:
        new = self.decoder.feed(data)
        self.packets += new
        return new

    def send(self, type: int, payload: bytes = b"", version: int = 1, flags: int = 0, format: int = 0) -> list[Packet]:
        self.sequence += 1
        packet = Packet(type, payload, self.sequence, flags=flags, format=format)
        return self.receive(encode_packet(packet, version))

    def send_together(self, *commands: tuple[int, bytes]) -> list[Packet]:
        """Send several packets at once."""
        wire = b""
        for type, payload in commands:
            self.sequence += 1
            wire += encode_packet(Packet(type, payload, self.sequence))
        return self.receive(wire)

    def receive(self, wire: bytes) -> list[Packet]:
        return self.take(self.board.receive(wire, self.now))

    def run(self, seconds: float) -> list[Packet]:
        start = len(self.packets)
        for number in range(round(seconds / STEP)):
            self.now += STEP
            if self.beating and number % 4 == 0:
                self.send(protocol.PacketType.HEARTBEAT)
            self.take(self.board.poll(self.now))
        return self.packets[start:]

    def ack(self, type: int, payload: bytes = b"", wait: float = 0.0) -> protocol.Ack:
        packets = self.send(type, payload) + (self.run(wait) if wait else [])
        answers = [a for a in acks(packets) if a.type == type]
        assert answers[0].sequence == self.sequence or self.beating
        return answers[0]

    def error(self, type: int, payload: bytes = b"", wait: float = 0.0) -> int:
        return self.ack(type, payload, wait).error

    def power(self) -> protocol.Power:
        return protocol.decode_power([p for p in self.packets if p.type == protocol.PacketType.POWER][-1].payload)

    def probe(self) -> protocol.Ack:
        return self.ack(protocol.PacketType.PROBE, wait=0.2)

    def close(self) -> int:
        return self.error(protocol.PacketType.CONTACTOR, CLOSE)

    def closed(self) -> Bench:
        """Heartbeat, probe, close, and wait until current flows."""
        self.beating = True
        assert self.probe().error == 0
        assert self.close() == 0
        self.run(0.3)
        assert self.power().contactor_closed
        assert self.power().charge_current == pytest.approx(1.0)
        return self


def tactile(packets: list[Packet]) -> list[Packet]:
    return [p for p in packets if p.type == protocol.PacketType.TACTILE]


def acks(packets: list[Packet]) -> list[protocol.Ack]:
    return [protocol.decode_ack(p.payload) for p in packets if p.type == protocol.PacketType.ACK]
