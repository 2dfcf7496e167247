# SPDX-License-Identifier: Apache-2.0
"""Interprets packets from the board: times on the host's clock, rising numbers, answers to commands, reboots."""

import logging
import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

from deltacharger_driver.board import protocol
from deltacharger_driver.packets import Packet

_WINDOW, _BUCKET = 5.0, 0.5  # s of history, in which two poor crystals drift by 1 ms; of one minimum
_log = logging.getLogger(__name__)
_CLOCK_STEP_BACK = 0.5  # s; if the device clock falls further, it has restarted


class DeviceClock:
    """Maps a device's clock to the host's by the packets with the least delay.

    Every packet gives `received - device_time`: the true offset plus a delay that is never negative. The minimum over
    the last seconds is the offset plus the shortest delay (Cristian, 1989; the one-way form of NTP's clock filter).

    The shortest delay itself (wire time, 3.2 ms for a u12 packet at 1 Mbaud) cannot be measured one-way and remains in
    the result.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything; the device's clock restarted."""
        self._minima: dict[int, float] = {}  # smallest received - device time, s, of each bucket of device time

    def update(self, device_time: float, received: float) -> float:
        """Add one packet and return its device time on the host's clock.

        Args:
            device_time: s, the device's clock.
            received: s, the host's monotonic clock at reception.

        Returns:
            s on the host's clock, never later than `received`.
        """
        delay, bucket = received - device_time, math.floor(device_time / _BUCKET)
        if bucket not in self._minima:
            oldest = bucket - _WINDOW / _BUCKET
            self._minima = {time: least for time, least in self._minima.items() if time >= oldest}
        self._minima[bucket] = min(self._minima.get(bucket, delay), delay)
        return device_time + min(self._minima.values())


class SequenceUnwrapper:
    """Turns sequence numbers modulo 65536 into numbers that only rise, also across a reboot of the device.

    Attributes:
        lost: packets missed so far: every gap, modulo 65536.
        duplicates: packets that repeated the number before.
    """

    def __init__(self) -> None:
        self.lost = 0
        self.duplicates = 0
        self._base = 0
        self._last: int | None = None  # None until the first packet: a host may join a running stream

    def reboot(self) -> None:
        """Expect numbers from 0 again and continue above everything returned so far."""
        self._base += 0 if self._last is None else self._last + 1
        self._last = -1

    def update(self, sequence: int) -> int | None:
        """Return the unwrapped number of a packet, or None for a repeated packet."""
        if self._last is None:
            self._last = sequence
            return self._base + sequence
        missed = (sequence - self._last - 1) % 65536
        if missed == 65535 and self._last >= 0:
            self.duplicates += 1
            return None
        self.lost += missed
        self._last += missed + 1
        return self._base + self._last


@dataclass
class BoardRequest:
    """One command. Every attempt has its own sequence number; an answer to any of them counts.

    Attributes:
        type: of the command.
        payload: of the command; identifies a PING.
        sequences: of the attempts so far.
        done: set when `ack`, `error` or a returned PING has arrived.
        received: s, arrival of the answer.
    """

    type: protocol.PacketType
    payload: bytes
    sequences: set[int] = field(default_factory=set)
    done: threading.Event = field(default_factory=threading.Event)
    ack: protocol.Ack | None = None
    received: float = 0.0
    error: Exception | None = None


class BoardRequests:
    """All waiting commands; any thread may add one, one thread delivers answers."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: list[BoardRequest] = []

    @contextmanager
    def waiting(self, request: BoardRequest) -> Iterator[BoardRequest]:
        """Accept answers to `request` inside the block."""
        with self._lock:
            self._waiting.append(request)
        try:
            yield request
        finally:
            with self._lock:
                self._waiting.remove(request)

    def attempt(self, request: BoardRequest, sequence: int) -> None:
        """Record an attempt before it is sent."""
        with self._lock:
            request.sequences.add(sequence)

    def acknowledge(self, ack: protocol.Ack, received: float) -> None:
        """Deliver an ACK to its command; a late one is dropped."""
        self._end(lambda request: request.type == ack.type and ack.sequence in request.sequences, received, ack)

    def ping_returned(self, payload: bytes, received: float) -> None:
        """Deliver a returned PING to its sender."""
        self._end(lambda request: request.type is protocol.PacketType.PING and request.payload == payload, received)

    def _end(self, is_its: Callable[[BoardRequest], bool], received: float, ack: protocol.Ack | None = None) -> None:
        with self._lock:
            for request in filter(is_its, self._waiting):
                request.ack, request.received = ack, received
                request.done.set()

    def fail(self, error: Exception) -> None:
        """End all waiting commands with `error`."""
        with self._lock:
            for request in self._waiting:
                request.error = error
                request.done.set()

    def rebooted(self) -> None:
        """End all waiting commands except HELLO, whose answer may have revealed the reboot."""
        with self._lock:
            for request in self._waiting:
                if request.type is not protocol.PacketType.HELLO and not request.done.is_set():
                    request.error = protocol.BoardRebooted(request.type.name)
                    request.done.set()


class BoardReceiver:
    """State of the receiving side, over all connections of one link. Used by one thread at a time.

    Attributes:
        hello: the board's last HELLO.
        counters: of the whole link; its owner adds the sent packets.

    Args:
        requests: commands that wait for answers.
        on_tactile: called with every frame.
        on_power: called with every reading of the power stage.
        on_boot: called when the board has rebooted.
        on_servo: called with bytes from the servos' bus.
    """

    def __init__(
        self,
        requests: BoardRequests,
        on_tactile: Callable[[protocol.TactileSample], None] | None,
        on_power: Callable[[protocol.PowerSample], None] | None,
        on_boot: Callable[[], None],
        on_servo: Callable[[bytes], None] | None = None,
    ) -> None:
        self._requests = requests
        self._on_tactile = on_tactile
        self._on_power = on_power
        self._on_boot = on_boot
        self._on_servo = on_servo
        self._device_clock = DeviceClock()
        self._tactile_sequence = SequenceUnwrapper()
        self._power_sequence = SequenceUnwrapper()
        self._latest_device_time = 0.0
        self._boot_id: int | None = None
        self.hello: protocol.Hello | None = None
        self.counters = protocol.BoardLinkCounters()

    def snapshot(self) -> protocol.BoardLinkCounters:
        """Return a copy of the counters."""
        return replace(
            self.counters,
            lost_tactile=self._tactile_sequence.lost,
            lost_power=self._power_sequence.lost,
            duplicates=self._tactile_sequence.duplicates + self._power_sequence.duplicates,
        )

    def take_packet(self, packet: Packet, received: float) -> None:
        """Interpret one packet that arrived at `received` (s, monotonic)."""
        if packet.type not in _DECODERS:
            self.counters.unknown_types += 1
            _log.debug("dropped a packet of type %d", packet.type)
            return
        try:
            protocol.check_header(packet)
            value = _DECODERS[packet.type](packet.payload)
        except protocol.PacketError as error:
            self.counters.bad_payloads += 1
            _log.debug("dropped: %s", error)
            return
        device_time = packet.device_time_us * 1e-6
        if isinstance(value, protocol.Hello):
            self._notice_boot_id(value, device_time)
        if device_time < self._latest_device_time - _CLOCK_STEP_BACK:
            self._boot_id = None  # its HELLO was lost; the next one has the new number
            self._reboot()
        self._latest_device_time = max(self._latest_device_time, device_time)
        when = self._device_clock.update(device_time, received)
        if packet.type == protocol.PacketType.TACTILE:
            self._take_tactile(packet, value, when)
        elif isinstance(value, protocol.Power) and self._power_sequence.update(packet.sequence) is not None:
            self.counters.power += 1
            self._call(self._on_power, protocol.PowerSample(when, value))
        elif isinstance(value, protocol.Hello):
            self.hello = value
        elif isinstance(value, protocol.Ack):
            self._requests.acknowledge(value, received)
        elif packet.type == protocol.PacketType.PING:
            self._requests.ping_returned(value, received)
        elif packet.type == protocol.PacketType.SERVO:
            self._call(self._on_servo, value)

    def _notice_boot_id(self, hello: protocol.Hello, device_time: float) -> None:
        known, self._boot_id = self._boot_id, hello.boot_id
        if known is None and device_time >= self._latest_device_time:
            self._device_clock.reset()  # earlier packets may be of a boot before: many boards boot when a port opens
        elif known != hello.boot_id:
            self._reboot()

    def _reboot(self) -> None:
        self.counters.reboots += 1
        self._latest_device_time = 0.0
        self._device_clock.reset()
        self._tactile_sequence.reboot()
        self._power_sequence.reboot()
        self._requests.rebooted()
        self._call(self._on_boot)

    def _take_tactile(self, packet: Packet, pads: protocol.Taxels, when: float) -> None:
        sequence = self._tactile_sequence.update(packet.sequence)
        if sequence is None:
            return
        self.counters.tactile += 1
        tared, overrun = bool(packet.flags & protocol.FLAG_TARED), bool(packet.flags & protocol.FLAG_OVERRUN)
        sample = protocol.TactileSample(when, sequence, packet.device_time_us, pads, tared, overrun)
        self._call(self._on_tactile, sample)

    def _call(self, callback: Callable[..., None] | None, *arguments: object) -> None:
        """Run a callback; a failure must not end the link, so it is counted and logged once."""
        if callback is None:
            return
        try:
            callback(*arguments)
        except Exception:
            self.counters.callback_errors += 1
            if self.counters.callback_errors == 1:
                _log.exception("a callback of the board link failed; further failures are only counted")


_DECODERS: dict[int, Callable[[bytes], Any]] = {
    protocol.PacketType.TACTILE: protocol.decode_samples,
    protocol.PacketType.POWER: protocol.decode_power,
    protocol.PacketType.HELLO: protocol.decode_hello,
    protocol.PacketType.ACK: protocol.decode_ack,
    protocol.PacketType.PING: protocol.decode_ping,
    protocol.PacketType.SERVO: protocol.decode_servo,
}
"""Decoder per packet type. A packet is decoded completely before it changes clock or counters."""
