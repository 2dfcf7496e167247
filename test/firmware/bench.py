# SPDX-License-Identifier: Apache-2.0
"""A board on the host program's bench and a host that sends only on command, in simulated microseconds."""

from __future__ import annotations

from pathlib import Path

from deltacharger_core.machine import ChargeLimits
from deltacharger_driver.board import protocol
from deltacharger_driver.packets import Packet, PacketDecoder, encode_packet

from .board_host import BoardHost

MS = 1000
S = 1_000_000
STRONG = "battery 29.7", "target 10.5", "resistance 1"  # a circuit of 19 A without a limit
LIMITS = ChargeLimits(18.0, 29.4)


class Bench:
    """Board, plant and wire.

    Args:
        program: path of board_host.
        start: us on the board's 32-bit counter at boot.
        settings: commands before the boot, e.g. noise=0.
    """

    def __init__(self, program: Path, start: int = 0, **settings: float) -> None:
        self.host = BoardHost(program, start)
        self.now = self.booted = start  # us
        self.packets: list[Packet] = []
        self.decoder = PacketDecoder()
        self.beating = False
        self._sequence = 0
        self._beat = start
        for name, value in settings.items():
            self.host.command(f"{name} {value}")
        self._decode(self.host.sent(f"boot {start}"))

    def close(self) -> None:
        """End the program; no packet that it sent may be damaged."""
        self.host.close()
        assert self.decoder.counters.damaged == 0

    def set(self, *lines: str) -> None:
        """Send commands to the bench, e.g. 'press 8'."""
        for line in lines:
            self.host.command(line)

    def send(self, *packets: tuple[int, bytes]) -> list[Packet]:
        """Send packets at once and return the immediate answers."""
        wire = b""
        for type, payload in packets:
            self._sequence = (self._sequence + 1) % 65536
            wire += encode_packet(Packet(type, payload, self._sequence))
        return self._decode(self.host.sent(f"wire {wire.hex()}"))

    def run(self, duration: int) -> list[Packet]:
        """Advance `duration` us, with a heartbeat every 20 ms while `beating`, and return received packets."""
        start, until = len(self.packets), self.now + duration
        while self.beating:
            self._beat = max(self._beat, self.now)
            if self._beat > until:
                break
            self._advance(self._beat)
            self.beat()
            self._beat += 20 * MS
        self._advance(until)
        return self.packets[start:]

    def jump(self, instant: int) -> list[Packet]:
        """Set the counter without polls in between."""
        self.now = instant
        return self._decode(self.host.sent(f"jump {instant}"))

    def _advance(self, until: int) -> None:
        self.now = until
        self._decode(self.host.sent(f"advance {until}"))

    def _decode(self, data: bytes) -> list[Packet]:
        new = self.decoder.feed(data)
        self.packets += new
        return new

    def ask(self, type: int, payload: bytes = b"", wait: int = 0) -> protocol.Ack:
        """Send a command and return its answer, which must arrive once and within `wait` us."""
        packets = self.send((type, payload))
        sequence = self._sequence
        if wait:
            packets = packets + self.run(wait)
        (answer,) = [ack for ack in acks(packets) if (ack.type, ack.sequence) == (type, sequence)]
        return answer

    def power(self) -> protocol.Power:
        """The last POWER packet."""
        return protocol.decode_power([p for p in self.packets if p.type == protocol.PacketType.POWER][-1].payload)

    def state(self, name: str) -> float:
        """One value of the host program's `state`."""
        return self.host.state()[name]

    def check(self, **expected: float) -> None:
        """Assert values of the state."""
        state = self.host.state()
        assert {name: state[name] for name in expected} == expected

    def beat(self, last: bool = False) -> None:
        """Send a heartbeat; the last one ends the regular ones."""
        self.beating = self.beating and not last
        self.send((protocol.PacketType.HEARTBEAT, b""))

    def reboot(self) -> None:
        """Boot now."""
        self.host.sent(f"boot {self.now}")

    def probe(self) -> protocol.Ack:
        """Probe and wait for the answer."""
        return self.ask(protocol.PacketType.PROBE, wait=160 * MS)

    def open(self) -> int:
        """Command an opening and return the error."""
        return self.ask(protocol.PacketType.CONTACTOR, b"\0").error

    def close_contactor(self, limits: ChargeLimits = LIMITS) -> int:
        """Command a close and return the error."""
        return self.ask(protocol.PacketType.CONTACTOR, protocol.encode_close(limits)).error

    def charge(self, duration: int = 1 * S, limits: ChargeLimits = LIMITS) -> Bench:
        """Heartbeat, probe, close, and wait until current flows."""
        self.beating = True
        self.run(0)
        assert self.probe().error == 0
        assert self.close_contactor(limits) == 0
        self.run(duration)
        self.check(contactor=1, commanded=1, fault=0)
        return self

    def run_until(self, name: str, value: float, longest: int, step: int = 1 * MS) -> int:
        """Advance time until the state has this value, and return the time taken, us."""
        start = self.now
        while self.state(name) != value:
            assert self.now - start < longest, f"{name} is not {value} after {longest} us"
            self.run(step)
        return self.now - start


def acks(packets: list[Packet]) -> list[protocol.Ack]:
    """The ACKs among packets."""
    return [protocol.decode_ack(packet.payload) for packet in packets if packet.type == protocol.PacketType.ACK]


def tactile(packets: list[Packet]) -> list[Packet]:
    """The TACTILE packets among packets."""
    return [packet for packet in packets if packet.type == protocol.PacketType.TACTILE]
