# SPDX-License-Identifier: Apache-2.0
"""Emulator of the board of docs/board-link.md: bytes in, bytes out, the clock passed in.

Served on a `PseudoTerminal`, it behaves like a real board, except for the differences listed in docs/emulators.md.
"""

from __future__ import annotations

import math
import threading
from collections import Counter
from collections.abc import Callable
from typing import Protocol

import numpy as np

from deltacharger_core.machine import COLUMNS, ROWS
from deltacharger_driver.board.payloads import (
    Ack,
    Hello,
    decode_close,
    decode_limit,
    decode_ping,
    decode_rate,
    decode_servo,
    decode_servo_speed,
    encode_ack,
    encode_hello,
    encode_power,
    encode_probe,
    encode_samples,
)
from deltacharger_driver.board.protocol import (
    CLEAR_WELD,
    CLOSE,
    DEFAULT_RATE,
    FLAG_OVERRUN,
    FLAG_TARED,
    LIMIT,
    OPEN,
    POWER_RATE,
    VERSION,
    AckError,
    DecoderCounters,
    Packet,
    PacketDecoder,
    PacketError,
    PacketType,
    SampleFormat,
    check_header,
    encode_packet,
)
from deltacharger_driver.emulators.board_servos import BoardServos
from deltacharger_driver.emulators.pads import EmulatedPads, PadPlant
from deltacharger_driver.emulators.power import EmulatedPower, PowerPlant
from deltacharger_driver.emulators.stage import StageParameters
from deltacharger_driver.emulators.wire_faults import DelayLine, WireFaults
from deltacharger_driver.pseudo_terminal import ByteDevice

SLOWEST, FASTEST = 0.1, 1000.0  # Hz, range of RATE
_BACKLOG = 16  # samplings kept until the next poll


class BoardPlant(PadPlant, PowerPlant, Protocol):
    """Everything that the board measures and switches; it has its own clock."""


class BoardEmulator:
    """The board as a `ByteDevice`.

    Thread-safe: hooks may be called while a `PseudoTerminal` serves it.

    Attributes:
        faults: errors of the wire.
        servos: the bus behind the board.
        unknown_types: number of packets of unknown types.

    Args:
        plant: the physics.
        sample_format: encoding of the taxels.
        probe_time: s that a probe takes, at most 0.25.
        drift: rate error of the board's clock, s/s; positive = fast.
        seed: of boot ids and wire faults; None draws one.
        boot_time: duration of a boot, s; during it the board neither receives nor sends, and its contactor is open.
        on_sample: called for every sampling with its sequence number, its due time and its actual time, s.
        on_heartbeat: called for every heartbeat with its arrival, s.
        servos: the servos' bus, if it is connected to the board.
        stage: the power stage, as its wiring declares it.
    """

    def __init__(
        self,
        plant: BoardPlant,
        sample_format: SampleFormat = SampleFormat.U12,
        probe_time: float = 0.150,
        drift: float = 0.0,
        seed: int | None = None,
        boot_time: float = 0.0,
        on_sample: Callable[[int, float, float], object] | None = None,
        on_heartbeat: Callable[[float], object] | None = None,
        servos: ByteDevice | None = None,
        stage: StageParameters | None = None,
    ) -> None:
        self._format = sample_format
        self._drift = drift
        self._random = np.random.default_rng(seed)
        self._pads = EmulatedPads(plant)
        self._power = EmulatedPower(plant, probe_time, stage)
        self._lock = threading.RLock()
        self._decoder = PacketDecoder()
        self._boot_time = boot_time
        self._boot_wanted: float | None = boot_time  # s that the boot will take
        self._running_from = math.inf  # end of the boot under way
        self._booted_at = 0.0
        self._next_power = self._next_sample = math.inf
        self._out: list[bytes] = []
        self._wire = DelayLine()
        self._on_sample = on_sample
        self._on_heartbeat = on_heartbeat
        self.faults = WireFaults(seed)
        self.servos = BoardServos(servos)
        self.unknown_types = 0

    @property
    def counters(self) -> DecoderCounters:
        """Counters of the board's decoder."""
        return self._decoder.counters

    @property
    def contactor_commanded(self) -> bool:
        """Whether a close was accepted and no opening followed."""
        return self._power.closed

    @property
    def fault(self) -> int:
        """The latched fault, 0 none."""
        return self._power.fault

    def reboot(self, boot_time: float | None = None) -> None:
        """Boot at the next poll (within 50 ms when served); `boot_time` in s, None = as constructed."""
        self._boot_wanted = self._boot_time if boot_time is None else boot_time

    def trip(self, fault: int) -> None:
        """Open the power stage at once and latch a fault, as if it had detected one."""
        with self._lock:
            self._power.trip(fault)

    def set_dead(self, pad: int, row: int, column: int, dead: bool = True) -> None:
        """Make a taxel dead or live: pad 0 is left, 1 right."""
        with self._lock:
            self._pads.set_dead(pad, row, column, dead)

    def receive(self, data: bytes, now: float) -> bytes:
        """Take bytes from the host at `now` and return what the board sends."""
        with self._lock:
            if self._advance(now) and not self.faults.deaf:
                for packet in self._decoder.feed(data):
                    self._execute(packet, now)
                    self._finish(now)  # an opening ends a probe: answer it before another PROBE replaces it
            return self._flush(now)

    def poll(self, now: float) -> bytes:
        """Return what the board sends on its own at `now`."""
        with self._lock:
            self._advance(now)
            return self._flush(now)

    def next_event(self, now: float) -> float:
        """Return the seconds until `poll` is due."""
        with self._lock:
            if self._boot_wanted is not None:
                return 0.0
            if self._running_from < math.inf:
                return max(min(self._running_from, self._wire.due) - now, 0.0)
            due = min(
                self._next_power, self._next_sample, self._pads.tare_due, self._power.next_event(), self._wire.due
            )
            return max(min(due - now, self.servos.next_event(now)), 0.0)

    def _flush(self, now: float) -> bytes:
        packets, self._out = self._out, []
        return self._wire.pass_on(packets, self.faults.delay, now)

    def _boot(self, now: float) -> None:
        self._running_from = math.inf
        self._booted_at = now
        self._boot_id = int(self._random.integers(1, 2**32))
        self._rate = DEFAULT_RATE
        self._sequences = Counter[int]()
        self._overrun = False
        self._next_sample = math.inf
        self._next_power = now + 1.0 / POWER_RATE
        self._probe_sequence = self._tare_sequence = 0
        counters, self._decoder = self._decoder.counters, PacketDecoder()
        self._decoder.counters = counters
        self._pads.reset()
        self._power.reset(now)
        self.servos.reset()
        self._send_hello(now)

    def _advance(self, now: float) -> bool:
        """Do everything due at `now`, the contactor first; return whether the board is running."""
        if self._boot_wanted is not None:
            self._running_from, self._boot_wanted = now + self._boot_wanted, None
            self._power.reset(now)
        if self._running_from < math.inf:
            if now < self._running_from:
                return False
            self._boot(now)
        self._power.poll(now)
        self._finish(now)
        self._stream(now)
        if now >= self._next_power:
            missed = math.floor((now - self._next_power) * POWER_RATE)
            self._next_power += (missed + 1) / POWER_RATE
            self._queue(PacketType.POWER, now, encode_power(self._power.report()))
        for data in self.servos.take(now):
            self._queue(PacketType.SERVO, now, data)
        return True

    def _finish(self, now: float) -> None:
        """Answer the probe and the tare if they have ended."""
        if self._power.probe_aborted:
            self._power.probe_aborted = False
            self._acknowledge(PacketType.PROBE, self._probe_sequence, AckError.NOT_NOW, now)
        result = self._power.poll_probe(now)
        if result is not None:
            data = encode_probe(*result)
            self._acknowledge(PacketType.PROBE, self._probe_sequence, AckError.DONE, now, data)
        tare = self._pads.poll_tare(now)
        if tare is not None:
            self._acknowledge(PacketType.TARE, self._tare_sequence, tare, now)

    def _stream(self, now: float) -> None:
        """Send every due sampling; sampling continues even if the host polls slowly."""
        period = 1.0 / self._rate
        behind = math.floor((now - self._next_sample) / period) if now >= self._next_sample else -1
        if behind >= _BACKLOG:
            lost = behind - _BACKLOG + 1
            self._next_sample += lost * period
            self._sequences[PacketType.TACTILE] = (self._sequences[PacketType.TACTILE] + lost) % 65536
            self._overrun = True
        while now >= self._next_sample:
            left, right = self._pads.sample()
            if self._on_sample is not None:
                self._on_sample(self._sequences[PacketType.TACTILE], self._next_sample, now)
            flags = FLAG_TARED * self._pads.tared | FLAG_OVERRUN * self._overrun
            payload = encode_samples(left, right, self._format)
            self._queue(PacketType.TACTILE, self._next_sample, payload, flags, self._format)
            self._overrun = False
            self._next_sample += period

    def _queue(self, type: PacketType, time: float, payload: bytes, flags: int = 0, format: int = 0) -> None:
        sequence = self._sequences[type]
        self._sequences[type] = (sequence + 1) % 65536
        device_time = max(round((time - self._booted_at) * (1.0 + self._drift) * 1e6), 0)
        wire = encode_packet(Packet(type, payload, sequence, device_time, flags, format))
        self._out.append(self.faults.apply(wire, type))

    def _acknowledge(self, type: int, sequence: int, error: AckError, now: float, data: bytes = b"") -> None:
        self._queue(PacketType.ACK, now, encode_ack(Ack(type, error, sequence, data)))

    def _send_hello(self, now: float) -> None:
        stage = self._power.parameters
        known = VERSION, self.servos.minor, ROWS, COLUMNS, self._boot_id, self._rate
        hello = Hello(*known, stage.steps_up, stage.stage_voltage or math.nan)
        self._queue(PacketType.HELLO, now, encode_hello(hello))

    def _execute(self, packet: Packet, now: float) -> None:
        command = _COMMANDS.get(packet.type)
        if command is None or (packet.type in _OF_SERVOS and not self.servos):
            self.unknown_types += 1
            self._acknowledge(packet.type, packet.sequence, AckError.UNKNOWN, now)
            return
        try:
            check_header(packet)
            if packet.payload and packet.type not in _WITH_PAYLOAD:
                raise PacketError(packet.type, f"{len(packet.payload)} bytes instead of none")
            error: AckError | None = command(self, packet, now)
        except PacketError:
            error = AckError.BAD_PAYLOAD
        if error is not None and packet.type not in _UNACKNOWLEDGED:
            self._acknowledge(packet.type, packet.sequence, error, now)

    def _heartbeat(self, packet: Packet, now: float) -> None:
        self._power.heartbeat(now)
        if self._on_heartbeat is not None:
            self._on_heartbeat(now)

    def _ping(self, packet: Packet, now: float) -> None:
        self._queue(PacketType.PING, now, decode_ping(packet.payload))

    def _hello(self, packet: Packet, now: float) -> AckError:
        self._send_hello(now)
        return AckError.DONE

    def _start(self, packet: Packet, now: float) -> AckError:
        if self._next_sample == math.inf:
            self._next_sample = now
        return AckError.DONE

    def _stop(self, packet: Packet, now: float) -> AckError:
        self._next_sample = math.inf
        return AckError.DONE

    def _tare(self, packet: Packet, now: float) -> AckError | None:
        error = self._pads.start_tare(now)
        if error is AckError.DONE:
            self._tare_sequence = packet.sequence
            return None
        return error

    def _set_rate(self, packet: Packet, now: float) -> AckError:
        rate = decode_rate(packet.payload)
        if not SLOWEST <= rate <= FASTEST:  # also refuses NaN
            return AckError.BAD_PAYLOAD
        self._rate = rate
        if self._next_sample < math.inf:
            self._next_sample = now + 1.0 / rate
        return AckError.DONE

    def _contactor(self, packet: Packet, now: float) -> AckError:
        if packet.payload[:1] == bytes([CLOSE]):
            return self._power.close(decode_close(packet.payload), now)
        if packet.payload[:1] == bytes([LIMIT]):
            return self._power.limit(decode_limit(packet.payload))
        if packet.payload == bytes([CLEAR_WELD]):
            return self._power.clear_weld()
        if packet.payload != bytes([OPEN]):
            return AckError.BAD_PAYLOAD
        self._power.open(now)
        return AckError.DONE

    def _probe(self, packet: Packet, now: float) -> AckError | None:
        error = self._power.start_probe(now)
        if error is AckError.DONE:
            self._probe_sequence = packet.sequence
            return None
        return error

    def _send_to_servos(self, packet: Packet, now: float) -> None:
        self.servos.send(decode_servo(packet.payload), now)

    def _set_servo_speed(self, packet: Packet, now: float) -> AckError:
        return self.servos.set_speed(decode_servo_speed(packet.payload))


_UNACKNOWLEDGED = (PacketType.HEARTBEAT, PacketType.PING, PacketType.SERVO)
_OF_SERVOS = (PacketType.SERVO, PacketType.SERVO_SPEED)
_WITH_PAYLOAD = (PacketType.RATE, PacketType.CONTACTOR, PacketType.PING, *_OF_SERVOS)
_COMMANDS: dict[int, Callable[[BoardEmulator, Packet, float], AckError | None]] = {
    PacketType.HELLO: BoardEmulator._hello,
    PacketType.START: BoardEmulator._start,
    PacketType.STOP: BoardEmulator._stop,
    PacketType.TARE: BoardEmulator._tare,
    PacketType.RATE: BoardEmulator._set_rate,
    PacketType.CONTACTOR: BoardEmulator._contactor,
    PacketType.PROBE: BoardEmulator._probe,
    PacketType.SERVO: BoardEmulator._send_to_servos,
    PacketType.SERVO_SPEED: BoardEmulator._set_servo_speed,
    PacketType.HEARTBEAT: BoardEmulator._heartbeat,
    PacketType.PING: BoardEmulator._ping,
}
