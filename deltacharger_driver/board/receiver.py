# SPDX-License-Identifier: Apache-2.0
"""Interprets packets from the board: converts times to the host's clock, unwraps numbers, detects reboots."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from deltacharger_driver.board.device_clock import DeviceClock, SequenceUnwrapper
from deltacharger_driver.board.payloads import (
    Ack,
    Hello,
    Power,
    Taxels,
    decode_ack,
    decode_hello,
    decode_ping,
    decode_power,
    decode_samples,
    decode_servo,
)
from deltacharger_driver.board.protocol import FLAG_OVERRUN, FLAG_TARED, Packet, PacketError, PacketType, check_header
from deltacharger_driver.board.requests import BoardRequests
from deltacharger_driver.board.samples import BoardLinkCounters, PowerSample, TactileSample

_log = logging.getLogger(__name__)
_CLOCK_STEP_BACK = 0.5  # s; if the device clock falls further, it has restarted


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
        on_tactile: Callable[[TactileSample], None] | None,
        on_power: Callable[[PowerSample], None] | None,
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
        self.hello: Hello | None = None
        self.counters = BoardLinkCounters()

    @property
    def drift(self) -> float:
        """Drift of the board's clock against the host's, s/s."""
        return self._device_clock.drift

    def snapshot(self) -> BoardLinkCounters:
        """Return a copy of the counters."""
        return replace(
            self.counters,
            lost_tactile=self._tactile_sequence.lost,
            lost_power=self._power_sequence.lost,
            duplicates=self._tactile_sequence.duplicates + self._power_sequence.duplicates,
        )

    def take(self, packet: Packet, received: float) -> None:
        """Interpret one packet that arrived at `received` (s, monotonic)."""
        try:
            decode, handler = _HANDLERS[packet.type]
        except KeyError:
            self.counters.unknown_types += 1
            _log.debug("dropped a packet of type %d", packet.type)
            return
        try:
            check_header(packet)
            value = decode(packet)
        except PacketError as error:
            self.counters.bad_payloads += 1
            _log.debug("dropped: %s", error)
            return
        device_time = packet.device_time_us * 1e-6
        if isinstance(value, Hello):
            self._notice_boot_id(value, device_time)
        if device_time < self._latest_device_time - _CLOCK_STEP_BACK:
            self._boot_id = None  # its HELLO was lost; the next one has the new number
            self._reboot()
        self._latest_device_time = max(self._latest_device_time, device_time)
        when = self._device_clock.update(device_time, received)
        handler(self, packet, value, when, received)

    def _notice_boot_id(self, hello: Hello, device_time: float) -> None:
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

    def _take_tactile(self, packet: Packet, pads: Taxels, when: float, received: float) -> None:
        sequence = self._tactile_sequence.update(packet.sequence)
        if sequence is None:
            return
        self.counters.tactile += 1
        tared, overrun = bool(packet.flags & FLAG_TARED), bool(packet.flags & FLAG_OVERRUN)
        sample = TactileSample(when, sequence, packet.device_time_us, pads, tared, overrun)
        self._call(self._on_tactile, sample)

    def _take_power(self, packet: Packet, power: Power, when: float, received: float) -> None:
        if self._power_sequence.update(packet.sequence) is None:
            return
        self.counters.power += 1
        self._call(self._on_power, PowerSample(when, power))

    def _take_hello(self, packet: Packet, hello: Hello, when: float, received: float) -> None:
        self.hello = hello

    def _take_ack(self, packet: Packet, ack: Ack, when: float, received: float) -> None:
        self._requests.acknowledge(ack, received)

    def _take_ping(self, packet: Packet, data: bytes, when: float, received: float) -> None:
        self._requests.ping_returned(data, received)

    def _take_servo(self, packet: Packet, data: bytes, when: float, received: float) -> None:
        self._call(self._on_servo, data)

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


_HANDLERS: dict[int, tuple[Callable[[Packet], Any], Callable[[BoardReceiver, Packet, Any, float, float], None]]] = {
    PacketType.TACTILE: (lambda p: decode_samples(p.payload, p.format), BoardReceiver._take_tactile),
    PacketType.POWER: (lambda p: decode_power(p.payload), BoardReceiver._take_power),
    PacketType.HELLO: (lambda p: decode_hello(p.payload), BoardReceiver._take_hello),
    PacketType.ACK: (lambda p: decode_ack(p.payload), BoardReceiver._take_ack),
    PacketType.PING: (lambda p: decode_ping(p.payload), BoardReceiver._take_ping),
    PacketType.SERVO: (lambda p: decode_servo(p.payload), BoardReceiver._take_servo),
}
"""Decoder and handler per packet type. A packet is decoded completely before it changes clock or counters."""
