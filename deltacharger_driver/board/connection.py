# SPDX-License-Identifier: Apache-2.0
"""A connection to the board over one serial port: HELLO, requests and their answers, heartbeat.

Two threads: the reader decodes packets and calls the callbacks; the heartbeat thread sends heartbeats until the
deadline set by `keep_alive`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace

from deltacharger_core.machine import BAUD_RATE
from deltacharger_driver.board.errors import BoardMismatch, CommandRefused
from deltacharger_driver.board.greeting import check_hello, explain_silence, refuse_servos
from deltacharger_driver.board.heartbeat import Heartbeat
from deltacharger_driver.board.payloads import Hello
from deltacharger_driver.board.port import BoardPort
from deltacharger_driver.board.protocol import (
    AckError,
    DecoderCounters,
    Packet,
    PacketDecoder,
    PacketType,
    encode_packet,
)
from deltacharger_driver.board.receiver import BoardReceiver
from deltacharger_driver.board.requests import BoardRequest, BoardRequests
from deltacharger_driver.board.samples import BoardLinkCounters, PowerSample, TactileSample
from deltacharger_driver.errors import NoAnswer, PortGone
from deltacharger_driver.rate_meter import Lateness


class BoardConnection:
    """One board on one serial port; can be opened repeatedly. `link.BoardLink` has the commands.

    Any thread except a callback may send commands, several at a time. After `PortGone` the link is down until `close`
    and `open` are called again. Sequence numbers, clock and counters continue.

    Attributes:
        greeting: HELLO of the last board that was accepted; it declares the power stage.

    Args:
        port: path of the port.
        baud_rate: speed on a UART; any on USB.
        on_tactile: called in the reader's thread with every `TactileSample`.
        on_power: called in the reader's thread with every `PowerSample`.
        on_boot: called in the reader's thread when the board has rebooted: it does not stream, is not tared, and its
            contactor is open. Must not wait for a command.
        on_gone: called once, in any thread, when the port has vanished.
        on_servo: called in the reader's thread with bytes from the servos' bus, if it is connected to the board.
    """

    def __init__(
        self,
        port: str,
        baud_rate: int = BAUD_RATE,
        on_tactile: Callable[[TactileSample], None] | None = None,
        on_power: Callable[[PowerSample], None] | None = None,
        on_boot: Callable[[], None] | None = None,
        on_gone: Callable[[PortGone], None] | None = None,
        on_servo: Callable[[bytes], None] | None = None,
    ) -> None:
        self.port = port
        self.baud_rate = baud_rate
        self._on_boot = on_boot
        self._on_gone = on_gone
        self._decoder = PacketDecoder()
        self._requests = BoardRequests()
        self._receiver = BoardReceiver(self._requests, on_tactile, on_power, self._rebooted, on_servo)
        self._sequences: dict[PacketType, int] = {}
        self._gone_lock = threading.Lock()
        self._write_lock = threading.Lock()  # port writes and outgoing sequences
        self._port: BoardPort | None = None
        self._reader: threading.Thread | None = None
        self._heartbeat: Heartbeat | None = None
        self._closing = threading.Event()
        self.gone: PortGone | None = None
        self.greeting: Hello | None = None

    def open(self) -> Hello:
        """Open the port and exchange HELLO with the board.

        Returns:
            The board's HELLO.

        Raises:
            PortError: the port cannot be opened (missing, not serial, busy, denied) or vanished again.
            NoAnswer: no intelligible answer; the message describes the bytes received.
            BoardMismatch: the board speaks another version or has other array sizes.
            WrongDevice: the servos are connected to this port.
        """
        if self._port is not None:
            raise RuntimeError(f"{self.port} is already open; close the link first")
        self._port = BoardPort(self.port, self.baud_rate)
        self.gone = None
        self._closing.clear()
        counters = self._decoder.counters
        self._decoder = PacketDecoder()
        self._decoder.counters = counters
        before = replace(counters)
        self._heartbeat = Heartbeat(self._send_heartbeat, f"board heartbeat {self.port}")
        self._reader = threading.Thread(target=self._read, name=f"board reader {self.port}", daemon=True)
        self._heartbeat.start()
        self._reader.start()
        try:
            return self._greet(before)
        except BaseException as error:
            self.close()
            if isinstance(error, NoAnswer | BoardMismatch) and self._decoder.counters.packets == before.packets:
                refuse_servos(self.port, self.baud_rate)
            raise

    def _greet(self, before: DecoderCounters) -> Hello:
        try:
            hello = self.hello()
        except NoAnswer as error:
            raise explain_silence(self.port, before, self._decoder.counters, error) from error
        check_hello(self.port, hello)
        self.greeting = hello
        return hello

    def close(self) -> None:
        """Stop both threads and release the port; without heartbeat, a closed contactor then opens.

        Idempotent. Pending commands end with `PortGone`. Must not be called from a callback.
        """
        self._closing.set()
        if self._heartbeat is not None:
            self._heartbeat.close()
            self._heartbeat = None
        if self._port is not None:
            self._port.wake()
        if self._reader is not None:
            self._reader.join()
            self._reader = None
        self._requests.fail(PortGone(self.port, "the link was closed"))
        with self._write_lock:
            port, self._port = self._port, None
        if port is not None:
            port.close()

    @property
    def counters(self) -> BoardLinkCounters:
        """A copy of the link's counters."""
        return self._receiver.snapshot()

    @property
    def decoder_counters(self) -> DecoderCounters:
        """A copy of the decoder's counters: bytes, packets and damage."""
        return replace(self._decoder.counters)

    @property
    def drift(self) -> float:
        """Estimated drift of the board's clock against the host's, s/s."""
        return self._receiver.drift

    @property
    def heartbeat_lateness(self) -> Lateness | None:
        """Lateness of the heartbeats of this connection; None without a connection."""
        heartbeat = self._heartbeat
        return None if heartbeat is None else heartbeat.lateness

    def hello(self) -> Hello:
        """Request the board's HELLO.

        Raises:
            NoAnswer, PortGone: as for every command.
        """
        self._receiver.hello = None
        for _ in range(2):  # HELLO may be lost although its ACK arrives
            self._ask(PacketType.HELLO, attempt_timeout=0.15, attempts=3)
            if self._receiver.hello is not None:
                return self._receiver.hello
        raise NoAnswer(self.port, "HELLO (acknowledged, but no HELLO received)", 0.3)

    def keep_alive(self, until: float) -> None:
        """Send heartbeats until `until` (s, monotonic); each call replaces that deadline.

        The first is sent before this returns, so the contactor may be closed at once.
        """
        if self._heartbeat is None:
            raise PortGone(self.port, "the link is closed")
        self._heartbeat.keep_alive(until)

    def stop_heartbeat(self) -> None:
        """Send no further heartbeat; a closed contactor opens within 100 ms."""
        heartbeat = self._heartbeat
        if heartbeat is not None:
            heartbeat.stop()

    def _ask(
        self,
        type: PacketType,
        payload: bytes = b"",
        attempt_timeout: float = 0.1,
        attempts: int = 5,
        advice: dict[int, str] | None = None,
    ) -> BoardRequest:
        if threading.current_thread() is self._reader:
            raise RuntimeError(f"{type.name} from a callback would block forever; call it from another thread")
        with self._requests.waiting(BoardRequest(type, payload)) as request:
            for attempt in range(attempts):
                self._receiver.counters.retries += attempt > 0
                self._send(type, payload, request)
                if request.done.wait(attempt_timeout):
                    break
            else:
                self._receiver.counters.unanswered += 1
                raise NoAnswer(self.port, type.name, attempt_timeout * attempts)
        if request.error is not None:
            raise request.error
        if request.ack is not None and request.ack.error != AckError.DONE:
            error = request.ack.error
            raise CommandRefused(type, error, (advice or {}).get(error, ""), len(request.sequences))
        return request

    def _send(self, type: PacketType, payload: bytes = b"", request: BoardRequest | None = None) -> None:
        if self.gone is not None:
            raise self.gone
        try:
            with self._write_lock:
                if self._port is None:
                    raise PortGone(self.port, "the link is closed")
                sequence = self._sequences.get(type, 0)
                self._sequences[type] = (sequence + 1) % 65536
                if request is not None:
                    self._requests.attempt(request, sequence)
                self._port.write(encode_packet(Packet(type, payload, sequence)))
        except PortGone as error:
            self._vanish(error)
            raise

    def _send_heartbeat(self) -> None:
        self._send(PacketType.HEARTBEAT)
        self._receiver.counters.heartbeats += 1

    def _vanish(self, error: PortGone) -> None:
        with self._gone_lock:
            if self.gone is not None or self._closing.is_set():
                return
            self.gone = error
        self.stop_heartbeat()
        self._requests.fail(error)
        if self._on_gone is not None:
            self._on_gone(error)

    def _rebooted(self) -> None:
        self.stop_heartbeat()
        if self._on_boot is not None:
            self._on_boot()

    def _read(self) -> None:
        port = self._port
        assert port is not None
        try:
            while not self._closing.is_set():
                data = port.read(0.5)
                received = time.monotonic()
                for packet in self._decoder.feed(data):
                    self._receiver.take(packet, received)
        except PortGone as error:
            self._vanish(error)
