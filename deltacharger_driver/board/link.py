# SPDX-License-Identifier: Apache-2.0
"""The host's end of the board link (docs/board-link.md): commands and heartbeats out, tactile frames and power in."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from deltacharger_core.machine import BAUD_RATE, COLUMNS, ROWS, ChargeLimits
from deltacharger_driver import errors, packets, ports
from deltacharger_driver.board import protocol, receiver

_NEVER = float("-inf")


class Heartbeat:
    """A thread that sends every 20 ms until a deadline.

    It never extends the deadline itself: if the client dies or hangs, the heartbeat stops and the board opens the
    contactor.

    Args:
        send: sends one heartbeat; may raise `PortGone`, which ends the thread.
        name: of the thread.
    """

    def __init__(self, send: Callable[[], None], name: str) -> None:
        self._send = send
        self._changed = threading.Condition()
        self._until = _NEVER
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread; nothing is sent yet."""
        self._thread.start()

    def close(self) -> None:
        """Stop and join the thread."""
        with self._changed:
            self._closing = True
            self._until = _NEVER
            self._changed.notify_all()
        self._thread.join()

    def keep_alive(self, until: float) -> None:
        """Send until `until` (s). If none are being sent, the first is sent before this returns.

        Raises:
            PortGone: the port vanished.
        """
        with self._changed:
            idle = time.monotonic() >= self._until
            self._until = until
            self._changed.notify_all()
        if idle and time.monotonic() < until:
            self._send()

    def stop(self) -> None:
        """Send no more."""
        with self._changed:
            self._until = _NEVER

    def _run(self) -> None:
        due = time.monotonic()
        while True:
            with self._changed:
                if self._closing:
                    return
                now = time.monotonic()
                if now >= self._until:
                    self._changed.wait()
                    due = time.monotonic()
                    continue
                if now < due:
                    self._changed.wait(due - now)
                    continue
            due = max(due + protocol.HEARTBEAT_PERIOD, now)
            try:
                self._send()
            except errors.PortGone:
                return


def refuse_incompatible(port: str, hello: protocol.Hello) -> None:
    """Refuse a board of another version or with other array sizes by `BoardMismatch`."""
    if hello.major != packets.VERSION or hello.minor < protocol.MINOR:
        raise protocol.BoardMismatch(port, f"the board speaks version {hello.major}.{hello.minor}")
    if (hello.rows, hello.columns) != (ROWS, COLUMNS):
        raise protocol.BoardMismatch(port, f"the board has {hello.rows} x {hello.columns} taxels per pad")


def explain_silence(
    port: str, before: packets.DecoderCounters, now: packets.DecoderCounters, error: errors.NoAnswer
) -> Exception:
    """Return the error for a board that did not answer, from the bytes received since `before`."""
    if now.version_errors > before.version_errors:
        return protocol.BoardMismatch(port, f"the board speaks version {now.refused_version}")
    if now.packets == before.packets and now.bytes > before.bytes:
        count = now.bytes - before.bytes
        return protocol.BoardMismatch(
            port, f"received {count} bytes, but no intact packet", f"check the line, and {errors.MAYBE_SWAPPED}"
        )
    return error


class BoardLink:
    """The tactile arrays and the power stage behind one serial port; can be opened repeatedly.

    Two threads: the reader decodes packets and calls the callbacks; the heartbeat thread sends heartbeats until the
    deadline set by `keep_alive`.

    Any thread except a callback may send commands, several at a time. After `PortGone` the link is down until `close`
    and `open` are called again. Sequence numbers, clock and counters continue. Every command raises `NoAnswer` if the
    board does not answer, and `PortGone` if the port vanished.

    Attributes:
        greeting: HELLO of the last board that was accepted; it declares the power stage.

    Args:
        port: path of the port.
        on_tactile: called in the reader's thread with every `TactileSample`.
        on_power: called in the reader's thread with every `PowerSample`.
        on_boot: called in the reader's thread when the board has rebooted: it does not stream, is not tared, and its
            contactor is open. Must not wait for a command.
        on_servo: called in the reader's thread with bytes from the servos' bus, if it is connected to the board.
    """

    def __init__(
        self,
        port: str,
        on_tactile: Callable[[protocol.TactileSample], None] | None = None,
        on_power: Callable[[protocol.PowerSample], None] | None = None,
        on_boot: Callable[[], None] | None = None,
        on_servo: Callable[[bytes], None] | None = None,
    ) -> None:
        self.port = port
        self._on_boot = on_boot
        self._decoder = packets.PacketDecoder()
        self._requests = receiver.BoardRequests()
        self._receiver = receiver.BoardReceiver(self._requests, on_tactile, on_power, self._rebooted, on_servo)
        self._sequences: dict[protocol.PacketType, int] = {}
        self._gone_lock = threading.Lock()
        self._write_lock = threading.Lock()  # port writes and outgoing sequences
        self._port: ports.RawPort | None = None
        self._reader: threading.Thread | None = None
        self._heartbeat: Heartbeat | None = None
        self._closing = threading.Event()
        self.gone: errors.PortGone | None = None
        self.greeting: protocol.Hello | None = None

    def __enter__(self) -> BoardLink:
        self.open()
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def open(self) -> protocol.Hello:
        """Open the port and exchange HELLO with the board.

        Returns:
            The board's HELLO.

        Raises:
            PortError: the port cannot be opened (missing, not serial, busy, denied) or vanished again.
            NoAnswer: no intelligible answer; the message describes the bytes received.
            BoardMismatch: the board speaks another version or has other array sizes.
        """
        if self._port is not None:
            raise RuntimeError(f"{self.port} is already open; close the link first")
        self._port = ports.RawPort(self.port, BAUD_RATE)
        self.gone = None
        self._closing.clear()
        counters = self._decoder.counters
        self._decoder = packets.PacketDecoder()
        self._decoder.counters = counters
        before = replace(counters)
        self._heartbeat = Heartbeat(self._send_heartbeat, f"board heartbeat {self.port}")
        self._reader = threading.Thread(target=self._read, name=f"board reader {self.port}", daemon=True)
        self._heartbeat.start()
        self._reader.start()
        try:
            return self._greet(before)
        except BaseException:
            self.close()
            raise

    def _greet(self, before: packets.DecoderCounters) -> protocol.Hello:
        try:
            hello = self.hello()
        except errors.NoAnswer as error:
            raise explain_silence(self.port, before, self._decoder.counters, error) from error
        refuse_incompatible(self.port, hello)
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
        self._requests.fail(errors.PortGone(self.port, "the link was closed"))
        with self._write_lock:
            port, self._port = self._port, None
        if port is not None:
            port.close()

    @property
    def counters(self) -> protocol.BoardLinkCounters:
        """A copy of the link's counters."""
        return self._receiver.snapshot()

    @property
    def decoder_counters(self) -> packets.DecoderCounters:
        """A copy of the decoder's counters: bytes, packets and damage."""
        return replace(self._decoder.counters)

    def hello(self) -> protocol.Hello:
        """Request the board's HELLO.

        Raises:
            NoAnswer, PortGone: as for every command.
        """
        self._receiver.hello = None
        for _ in range(2):  # HELLO may be lost although its ACK arrives
            self._ask(protocol.PacketType.HELLO, attempt_timeout=0.15, attempts=3)
            if self._receiver.hello is not None:
                return self._receiver.hello
        raise errors.NoAnswer(self.port, "HELLO (acknowledged, but no HELLO received)", 0.3)

    def keep_alive(self, until: float) -> None:
        """Send heartbeats until `until` (s, monotonic); each call replaces that deadline.

        The first is sent before this returns, so the contactor may be closed at once.
        """
        if self._heartbeat is None:
            raise errors.PortGone(self.port, "the link is closed")
        self._heartbeat.keep_alive(until)

    def stop_heartbeat(self) -> None:
        """Send no further heartbeat; a closed contactor opens within 100 ms."""
        heartbeat = self._heartbeat
        if heartbeat is not None:
            heartbeat.stop()

    def start(self) -> None:
        """Start the stream of tactile frames; harmless if it runs already."""
        self._ask(protocol.PacketType.START)

    def stop(self) -> None:
        """Stop the stream of tactile frames; POWER continues."""
        self._ask(protocol.PacketType.STOP)

    def set_rate(self, rate: float) -> None:
        """Set the rate of tactile frames, Hz.

        Raises:
            CommandRefused: the board does not support this rate.
        """
        advice: dict[int, str] = {
            protocol.AckError.BAD_PAYLOAD: f"it does not sample at {rate:g} Hz; it starts at 120 Hz"
        }
        self._ask(protocol.PacketType.RATE, protocol.encode_rate(rate), advice=advice)

    def tare(self) -> None:
        """Make the board take the present, unloaded reading as zero. The host subtracts nothing more.

        Raises:
            CommandRefused: something touches a pad.
        """
        advice: dict[int, str] = {
            protocol.AckError.NOT_NOW: "something presses on a pad (a taxel reads 1 N or more); retract first"
        }
        self._ask(protocol.PacketType.TARE, attempt_timeout=0.25, attempts=2, advice=advice)

    def contactor(self, close: bool, limits: ChargeLimits | None = None) -> None:
        """Close the contactor within limits, or open it. A close also needs `keep_alive` and a fresh `probe`.

        Raises:
            CommandRefused: an interlock; opening is never refused.
            ValueError: a close without limits.
        """
        if close and limits is None:
            raise ValueError("a close needs limits of current and voltage")
        payload = bytes([protocol.OPEN]) if limits is None or not close else protocol.encode_close(limits)
        advice: dict[int, str] = {
            protocol.AckError.BAD_PAYLOAD: "a limit of current, voltage or time is out of range",
            protocol.AckError.NOT_NOW: "the contactor is already closed",
        }
        try:
            self._ask(protocol.PacketType.CONTACTOR, payload, attempt_timeout=0.05, attempts=4, advice=advice)
        except protocol.CommandRefused as error:
            # If a repeated close finds the contactor closed, only the first answer was lost.
            if not (close and error.error == protocol.AckError.NOT_NOW and error.attempts > 1):
                raise

    def limit_current(self, current: float) -> None:
        """Change the largest current (A) of a closed contactor.

        Raises:
            CommandRefused: the contactor is open, or the current is out of range.
        """
        advice: dict[int, str] = {protocol.AckError.NOT_NOW: "the contactor is open"}
        self._ask(
            protocol.PacketType.CONTACTOR,
            protocol.encode_limit(current),
            attempt_timeout=0.05,
            attempts=4,
            advice=advice,
        )

    def clear_weld(self) -> None:
        """Clear a latched weld. Only a person who has replaced the contactor may order it.

        Raises:
            CommandRefused: something is still live, the contactor is closed, or another fault is latched.
        """
        advice: dict[int, str] = {
            protocol.AckError.BAD_PAYLOAD: "its firmware latches no welds; flash the current one",
            protocol.AckError.INTERLOCK: "contactor or electrodes are live, or their current is not measured",
            protocol.AckError.NOT_NOW: "the contactor is closed, or another fault is latched; open it first",
        }
        self._ask(
            protocol.PacketType.CONTACTOR, bytes([protocol.CLEAR_WELD]), attempt_timeout=0.05, attempts=4, advice=advice
        )

    def probe(self) -> protocol.ProbeResult:
        """Look at the port between the electrodes (≤ 5 V, ≤ 50 mA); the board takes up to `PROBE_TIMEOUT`.

        Raises:
            CommandRefused: the contactor is closed, a probe is running, an opening interrupted it, a fault is latched,
                or current flows.
        """
        advice: dict[int, str] = {
            protocol.AckError.INTERLOCK: "a fault is latched, or current flows; open the contactor, then probe",
            protocol.AckError.NOT_NOW: "the contactor is closed, another probe is running, or it was interrupted",
        }
        request = self._ask(
            protocol.PacketType.PROBE, attempt_timeout=protocol.PROBE_TIMEOUT + 0.1, attempts=2, advice=advice
        )
        assert request.ack is not None
        resistance, voltage = protocol.decode_probe(request.ack.data)
        return protocol.ProbeResult(resistance, voltage, request.received)

    def ping(self) -> float:
        """Have some bytes returned, and return the round-trip time, s."""
        data = os.urandom(8)
        sent = time.monotonic()
        return self._ask(protocol.PacketType.PING, data).received - sent

    def send_to_servos(self, data: bytes) -> None:
        """Send bytes on the servos' bus behind the board, without confirmation; replies arrive through on_servo.

        Raises:
            PortGone: the port vanished.
        """
        for at in range(0, len(data), protocol.LONGEST_SERVO):
            self._send(protocol.PacketType.SERVO, data[at : at + protocol.LONGEST_SERVO])

    def set_servo_speed(self, speed: int) -> None:
        """Set the speed of the servos' bus behind the board, bit/s.

        Raises:
            CommandRefused: the board does not support this speed.
        """
        advice: dict[int, str] = {protocol.AckError.BAD_PAYLOAD: f"the servos' bus does not support {speed} bit/s"}
        self._ask(protocol.PacketType.SERVO_SPEED, protocol.encode_servo_speed(speed), advice=advice)

    def _ask(
        self,
        type: protocol.PacketType,
        payload: bytes = b"",
        attempt_timeout: float = 0.1,
        attempts: int = 5,
        advice: dict[int, str] | None = None,
    ) -> receiver.BoardRequest:
        if threading.current_thread() is self._reader:
            raise RuntimeError(f"{type.name} from a callback would block forever; call it from another thread")
        with self._requests.waiting(receiver.BoardRequest(type, payload)) as request:
            for attempt in range(attempts):
                self._receiver.counters.retries += attempt > 0
                self._send(type, payload, request)
                if request.done.wait(attempt_timeout):
                    break
            else:
                self._receiver.counters.unanswered += 1
                raise errors.NoAnswer(self.port, type.name, attempt_timeout * attempts)
        if request.error is not None:
            raise request.error
        if request.ack is not None and request.ack.error != protocol.AckError.DONE:
            error = request.ack.error
            raise protocol.CommandRefused(type, error, (advice or {}).get(error, ""), len(request.sequences))
        return request

    def _send(
        self, type: protocol.PacketType, payload: bytes = b"", request: receiver.BoardRequest | None = None
    ) -> None:
        if self.gone is not None:
            raise self.gone
        try:
            with self._write_lock:
                if self._port is None:
                    raise errors.PortGone(self.port, "the link is closed")
                sequence = self._sequences.get(type, 0)
                self._sequences[type] = (sequence + 1) % 65536
                if request is not None:
                    self._requests.attempt(request, sequence)
                self._port.write(packets.encode_packet(packets.Packet(type, payload, sequence)))
        except errors.PortGone as error:
            self._vanish(error)
            raise

    def _send_heartbeat(self) -> None:
        self._send(protocol.PacketType.HEARTBEAT)
        self._receiver.counters.heartbeats += 1

    def _vanish(self, error: errors.PortGone) -> None:
        with self._gone_lock:
            if self.gone is not None or self._closing.is_set():
                return
            self.gone = error
        self.stop_heartbeat()
        self._requests.fail(error)

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
                    self._receiver.take_packet(packet, received)
        except errors.PortGone as error:
            self._vanish(error)
