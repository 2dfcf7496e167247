# SPDX-License-Identifier: Apache-2.0
"""Emulator of the board of docs/board-link.md: bytes in, bytes out, the clock passed in; arrays, wire faults, servos.

Served on a `PseudoTerminal`, it behaves like a real board, except for the differences listed in docs/emulators.md.
"""

import math
import threading
from collections import Counter
from typing import Protocol

import numpy as np
import numpy.typing as npt

from deltacharger_core.machine import BAUD_RATE, COLUMNS, CONTACT_FORCE, ROWS
from deltacharger_driver.board import protocol
from deltacharger_driver.packets import VERSION, Packet, PacketDecoder, encode_packet
from deltacharger_driver.ports import ByteDevice
from deltacharger_sim.emulators.power import EmulatedPower, PowerPlant, StageParameters
from deltacharger_sim.emulators.wire import DelayLine, WireFaults

TARE_SAMPLES = 8
TARE_PERIOD = 0.004  # s between the samples of a tare: 28 ms in all
Forces = npt.NDArray[np.float64]

SLOWEST_BUS, FASTEST_BUS = 9600, 4_500_000  # bit/s, range of SERVO_SPEED

SLOWEST, FASTEST = 0.1, 1000.0  # Hz, range of RATE
_BACKLOG = 16  # samplings kept until the next poll

_UNACKNOWLEDGED = (protocol.PacketType.HEARTBEAT, protocol.PacketType.PING, protocol.PacketType.SERVO)
_OF_SERVOS = (protocol.PacketType.SERVO, protocol.PacketType.SERVO_SPEED)
_WITH_PAYLOAD = (protocol.PacketType.RATE, protocol.PacketType.CONTACTOR, protocol.PacketType.PING, *_OF_SERVOS)


class PadPlant(Protocol):
    """The physics behind the arrays, on its own clock."""

    def read_taxels(self) -> tuple[npt.NDArray[np.floating], npt.NDArray[np.floating]]:
        """Return left and right, (10, 10) N each, raw: offset and noise included, before the tare; NaN = dead."""


class EmulatedPads:
    """Both arrays on the board's side.

    Attributes:
        tared: whether a tare is subtracted.

    Args:
        plant: the physics.
    """

    def __init__(self, plant: PadPlant) -> None:
        self._plant = plant
        self._dead = np.zeros((2, ROWS, COLUMNS), bool)
        self.reset()

    def reset(self) -> None:
        """Boot: discard the tare."""
        self.tared = False
        self._baseline: Forces = np.full((2, ROWS, COLUMNS), np.nan)  # N; NaN = unknown
        self._tare_sum: Forces = np.zeros((2, ROWS, COLUMNS))
        self._tare_live = np.zeros((2, ROWS, COLUMNS), int)  # samples in the sum
        self._tare_count = 0
        self.tare_due = math.inf

    def set_dead(self, pad: int, row: int, column: int, dead: bool = True) -> None:
        """Make a taxel dead or live: pad 0 is left, 1 right."""
        self._dead[pad, row, column] = dead

    def sample(self) -> Forces:
        """Return (2, 10, 10) N: left and right after the tare, at least 0; NaN = dead, or not in the tare."""
        raw = self._read()
        return np.maximum(raw - self._baseline if self.tared else raw, 0.0)

    def start_tare(self, now: float) -> protocol.AckError:
        """Start a tare; DONE means that `poll_tare` will return the result."""
        if self.tare_due < math.inf or self._loaded(self._read()):
            return protocol.AckError.NOT_NOW
        self._tare_sum[:] = 0.0
        self._tare_live[:] = 0
        self._tare_count = 0
        self.tare_due = now
        return protocol.AckError.DONE

    def poll_tare(self, now: float) -> protocol.AckError | None:
        """Take due samples; return the result of the tare, None while it runs."""
        while now >= self.tare_due:
            raw = self._read()
            if self._loaded(raw):
                self.tare_due = math.inf
                return protocol.AckError.NOT_NOW
            self._tare_sum += np.nan_to_num(raw)
            self._tare_live += ~np.isnan(raw)
            self._tare_count += 1
            if self._tare_count == TARE_SAMPLES:
                with np.errstate(invalid="ignore"):
                    self._baseline = self._tare_sum / self._tare_live  # 0 / 0 is NaN: dead in every sample
                self.tared = True
                self.tare_due = math.inf
                return protocol.AckError.DONE
            self.tare_due += TARE_PERIOD
        return None

    def _read(self) -> Forces:
        raw: Forces = np.array(self._plant.read_taxels(), float)
        raw[self._dead] = np.nan
        return raw

    def _loaded(self, raw: Forces) -> bool:
        """Return whether any live taxel carries a load after the present tare.

        Without a tare, the resting value of a taxel may come near 1 N. The median of its pad then replaces the
        baseline, because contact covers only a quarter of a pad.
        """
        baseline = np.where(np.isnan(self._baseline), _medians(raw), self._baseline)
        return bool((raw - baseline >= CONTACT_FORCE).any())  # NaN compares false


def _medians(raw: Forces) -> Forces:
    """Return the median of each pad's live taxels (2, 1, 1) N; 0 for a pad without any."""
    return np.array([_median(np.sort(pad[~np.isnan(pad)])) for pad in raw]).reshape(2, 1, 1)


def _median(ordered: Forces) -> float:
    """Return the median; numpy's own imports numpy.ma first, which stalls an emulator by 0.1 s on a busy computer."""
    count = len(ordered)
    return 0.5 * float(ordered[(count - 1) // 2] + ordered[count // 2]) if count else 0.0


class BoardServos:
    """The board's end of the servos' bus.

    Bytes from the bus are dropped until the host has sent a SERVO packet since the boot: an older host gets none.

    Args:
        bus: the servos; None = the board has no such bus.

    Attributes:
        speed: of the bus, bit/s.
    """

    def __init__(self, bus: ByteDevice | None) -> None:
        self._bus = bus
        self.reset()

    def __bool__(self) -> bool:
        """Whether there is a bus."""
        return self._bus is not None

    @property
    def minor(self) -> int:
        """Minor protocol version of a board with this bus."""
        return protocol.MINOR if self._bus is None else protocol.SERVO_MINOR

    def reset(self) -> None:
        """Discard received bytes, as a boot does."""
        self.speed = BAUD_RATE
        self._host_has_sent = False
        self._received = b""

    def set_speed(self, speed: int) -> protocol.AckError:
        """Set the speed, bit/s, if the board supports it."""
        if not SLOWEST_BUS <= speed <= FASTEST_BUS:
            return protocol.AckError.BAD_PAYLOAD
        self.speed, self._received = speed, b""
        return protocol.AckError.DONE

    def send(self, data: bytes, now: float) -> None:
        """Send bytes of the host to the servos."""
        self._host_has_sent = True
        if self._bus is not None:
            self._received += self._bus.receive(data, now)

    def take_bytes(self, now: float) -> list[bytes]:
        """Return the bytes from the servos, cut into pieces that fit a packet."""
        if self._bus is not None:
            self._received += self._bus.poll(now)
        received, self._received = self._received if self._host_has_sent else b"", b""
        return [received[at : at + protocol.LONGEST_SERVO] for at in range(0, len(received), protocol.LONGEST_SERVO)]

    def next_event(self, now: float) -> float:
        """Return the seconds until `take` returns bytes; inf for never."""
        if self._bus is None:
            return math.inf
        return 0.0 if self._received else self._bus.next_event(now)


class BoardPlant(PadPlant, PowerPlant, Protocol):
    """Everything that the board measures and switches; it has its own clock."""


class BoardEmulator:
    """The board as a `ByteDevice`.

    Thread-safe: hooks may be called while a `PseudoTerminal` serves it.

    Attributes:
        faults: errors of the wire.
        servos: the bus behind the board.

    Args:
        plant: the physics.
        seed: of boot ids and wire faults; None draws one.
        servos: the servos' bus, if it is connected to the board.
        stage: the power stage, as its wiring declares it.
    """

    def __init__(
        self,
        plant: BoardPlant,
        seed: int | None = None,
        servos: ByteDevice | None = None,
        stage: StageParameters | None = None,
    ) -> None:
        self._random = np.random.default_rng(seed)
        self._pads = EmulatedPads(plant)
        self._power = EmulatedPower(plant, stage)
        self._lock = threading.RLock()
        self._decoder = PacketDecoder()
        self._boot_wanted: float | None = 0.0  # s that the boot will take
        self._running_from = math.inf  # end of the boot under way
        self._booted_at = 0.0
        self._next_power = self._next_sample = math.inf
        self._out: list[bytes] = []
        self._wire = DelayLine()
        self.faults = WireFaults(seed)
        self.servos = BoardServos(servos)

    @property
    def contactor_commanded(self) -> bool:
        """Whether a close was accepted and no opening followed."""
        return self._power.closed

    @property
    def fault(self) -> int:
        """The latched fault, 0 none."""
        return self._power.fault

    def reboot(self, boot_time: float = 0.0) -> None:
        """Boot at the next poll (within 50 ms when served) for some s: deaf and silent, with an open contactor."""
        self._boot_wanted = boot_time

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
        for packet in packets:
            self._wire.send(packet, now + self.faults.delay)
        return self._wire.arrived(now)

    def _boot(self, now: float) -> None:
        self._running_from = math.inf
        self._booted_at = now
        self._boot_id = int(self._random.integers(1, 2**32))
        self._rate = protocol.DEFAULT_RATE
        self._sequences = Counter[int]()
        self._overrun = False
        self._next_sample = math.inf
        self._next_power = now + 1.0 / protocol.POWER_RATE
        self._probe_sequence = self._tare_sequence = 0
        self._decoder = PacketDecoder()
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
            missed = math.floor((now - self._next_power) * protocol.POWER_RATE)
            self._next_power += (missed + 1) / protocol.POWER_RATE
            self._queue(protocol.PacketType.POWER, now, protocol.encode_power(self._power.report()))
        for data in self.servos.take_bytes(now):
            self._queue(protocol.PacketType.SERVO, now, data)
        return True

    def _finish(self, now: float) -> None:
        """Answer the probe and the tare if they have ended."""
        if self._power.probe_aborted:
            self._power.probe_aborted = False
            self._acknowledge(protocol.PacketType.PROBE, self._probe_sequence, protocol.AckError.NOT_NOW, now)
        result = self._power.poll_probe(now)
        if result is not None:
            data = protocol.encode_probe(*result)
            self._acknowledge(protocol.PacketType.PROBE, self._probe_sequence, protocol.AckError.DONE, now, data)
        tare = self._pads.poll_tare(now)
        if tare is not None:
            self._acknowledge(protocol.PacketType.TARE, self._tare_sequence, tare, now)

    def _stream(self, now: float) -> None:
        """Send every due sampling; sampling continues even if the host polls slowly."""
        period = 1.0 / self._rate
        behind = math.floor((now - self._next_sample) / period) if now >= self._next_sample else -1
        if behind >= _BACKLOG:
            lost = behind - _BACKLOG + 1
            self._next_sample += lost * period
            self._sequences[protocol.PacketType.TACTILE] = (self._sequences[protocol.PacketType.TACTILE] + lost) % 65536
            self._overrun = True
        while now >= self._next_sample:
            left, right = self._pads.sample()
            flags = protocol.FLAG_TARED * self._pads.tared | protocol.FLAG_OVERRUN * self._overrun
            payload = protocol.encode_samples(left, right)
            self._queue(protocol.PacketType.TACTILE, self._next_sample, payload, flags, protocol.U12)
            self._overrun = False
            self._next_sample += period

    def _queue(self, type: protocol.PacketType, time: float, payload: bytes, flags: int = 0, format: int = 0) -> None:
        sequence = self._sequences[type]
        self._sequences[type] = (sequence + 1) % 65536
        device_time = max(round((time - self._booted_at) * 1e6), 0)
        wire = encode_packet(Packet(type, payload, sequence, device_time, flags, format))
        self._out.append(self.faults.apply(wire, type))

    def _acknowledge(self, type: int, sequence: int, error: protocol.AckError, now: float, data: bytes = b"") -> None:
        self._queue(protocol.PacketType.ACK, now, protocol.encode_ack(protocol.Ack(type, error, sequence, data)))

    def _send_hello(self, now: float) -> None:
        stage = self._power.parameters
        known = VERSION, self.servos.minor, ROWS, COLUMNS, self._boot_id, self._rate
        hello = protocol.Hello(*known, stage.steps_up, stage.stage_voltage or math.nan)
        self._queue(protocol.PacketType.HELLO, now, protocol.encode_hello(hello))

    def _execute(self, packet: Packet, now: float) -> None:
        command = _COMMANDS.get(packet.type)
        if command is None or (packet.type in _OF_SERVOS and not self.servos):
            self._acknowledge(packet.type, packet.sequence, protocol.AckError.UNKNOWN, now)
            return
        try:
            protocol.check_header(packet)
            if packet.payload and packet.type not in _WITH_PAYLOAD:
                raise protocol.PacketError(packet.type, f"{len(packet.payload)} bytes instead of none")
            error: protocol.AckError | None = getattr(self, command)(packet, now)
        except protocol.PacketError:
            error = protocol.AckError.BAD_PAYLOAD
        if error is not None and packet.type not in _UNACKNOWLEDGED:
            self._acknowledge(packet.type, packet.sequence, error, now)

    def _heartbeat(self, packet: Packet, now: float) -> None:
        self._power.heartbeat(now)

    def _ping(self, packet: Packet, now: float) -> None:
        self._queue(protocol.PacketType.PING, now, protocol.decode_ping(packet.payload))

    def _hello(self, packet: Packet, now: float) -> protocol.AckError:
        self._send_hello(now)
        return protocol.AckError.DONE

    def _start(self, packet: Packet, now: float) -> protocol.AckError:
        if self._next_sample == math.inf:
            self._next_sample = now
        return protocol.AckError.DONE

    def _stop(self, packet: Packet, now: float) -> protocol.AckError:
        self._next_sample = math.inf
        return protocol.AckError.DONE

    def _tare(self, packet: Packet, now: float) -> protocol.AckError | None:
        error = self._pads.start_tare(now)
        if error is protocol.AckError.DONE:
            self._tare_sequence = packet.sequence
            return None
        return error

    def _set_rate(self, packet: Packet, now: float) -> protocol.AckError:
        rate = protocol.decode_rate(packet.payload)
        if not SLOWEST <= rate <= FASTEST:  # also refuses NaN
            return protocol.AckError.BAD_PAYLOAD
        self._rate = rate
        if self._next_sample < math.inf:
            self._next_sample = now + 1.0 / rate
        return protocol.AckError.DONE

    def _contactor(self, packet: Packet, now: float) -> protocol.AckError:
        if packet.payload[:1] == bytes([protocol.CLOSE]):
            return self._power.close(protocol.decode_close(packet.payload), now)
        if packet.payload[:1] == bytes([protocol.LIMIT]):
            return self._power.limit(protocol.decode_limit(packet.payload))
        if packet.payload == bytes([protocol.CLEAR_WELD]):
            return self._power.clear_weld()
        if packet.payload != bytes([protocol.OPEN]):
            return protocol.AckError.BAD_PAYLOAD
        self._power.open(now)
        return protocol.AckError.DONE

    def _probe(self, packet: Packet, now: float) -> protocol.AckError | None:
        error = self._power.start_probe(now)
        if error is protocol.AckError.DONE:
            self._probe_sequence = packet.sequence
            return None
        return error

    def _send_to_servos(self, packet: Packet, now: float) -> None:
        self.servos.send(protocol.decode_servo(packet.payload), now)

    def _set_servo_speed(self, packet: Packet, now: float) -> protocol.AckError:
        return self.servos.set_speed(protocol.decode_servo_speed(packet.payload))


_COMMANDS: dict[int, str] = {
    protocol.PacketType.HELLO: "_hello",
    protocol.PacketType.START: "_start",
    protocol.PacketType.STOP: "_stop",
    protocol.PacketType.TARE: "_tare",
    protocol.PacketType.RATE: "_set_rate",
    protocol.PacketType.CONTACTOR: "_contactor",
    protocol.PacketType.PROBE: "_probe",
    protocol.PacketType.SERVO: "_send_to_servos",
    protocol.PacketType.SERVO_SPEED: "_set_servo_speed",
    protocol.PacketType.HEARTBEAT: "_heartbeat",
    protocol.PacketType.PING: "_ping",
}
