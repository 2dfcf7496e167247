# SPDX-License-Identifier: Apache-2.0
"""The host's end of the board link (docs/board-link.md): commands out, tactile frames and power in."""

from __future__ import annotations

import itertools
import struct
import time

from deltacharger_core.charge_port import ChargeLimits
from deltacharger_driver.board.connection import BoardConnection
from deltacharger_driver.board.errors import CommandRefused
from deltacharger_driver.board.payloads import (
    decode_probe,
    encode_close,
    encode_limit,
    encode_rate,
    encode_servo_speed,
)
from deltacharger_driver.board.protocol import (
    CLEAR_WELD,
    LONGEST_PING,
    LONGEST_SERVO,
    OPEN,
    PROBE_TIMEOUT,
    AckError,
    PacketType,
)
from deltacharger_driver.board.samples import ProbeResult

_PING_NUMBERS = itertools.count()


class BoardLink(BoardConnection):
    """The tactile arrays and the power stage behind one serial port; arguments and threads as for `BoardConnection`.

    Every command raises `NoAnswer` if the board does not answer, and `PortGone` if the port vanished.
    """

    def __enter__(self) -> BoardLink:
        self.open()
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def start(self) -> None:
        """Start the stream of tactile frames; harmless if it runs already."""
        self._ask(PacketType.START)

    def stop(self) -> None:
        """Stop the stream of tactile frames; POWER continues."""
        self._ask(PacketType.STOP)

    def set_rate(self, rate: float) -> None:
        """Set the rate of tactile frames, Hz.

        Raises:
            CommandRefused: the board does not support this rate.
        """
        advice: dict[int, str] = {AckError.BAD_PAYLOAD: f"it does not sample at {rate:g} Hz; it starts at 120 Hz"}
        self._ask(PacketType.RATE, encode_rate(rate), advice=advice)

    def tare(self) -> None:
        """Make the board take the present, unloaded reading as zero. The host subtracts nothing more.

        Raises:
            CommandRefused: something touches a pad.
        """
        advice: dict[int, str] = {
            AckError.NOT_NOW: "something presses on a pad (a taxel reads 1 N or more); retract first"
        }
        self._ask(PacketType.TARE, attempt_timeout=0.25, attempts=2, advice=advice)

    def contactor(self, close: bool, limits: ChargeLimits | None = None) -> None:
        """Close the contactor within limits, or open it. A close also needs `keep_alive` and a fresh `probe`.

        Raises:
            CommandRefused: an interlock; opening is never refused.
            ValueError: a close without limits.
        """
        if close and limits is None:
            raise ValueError("a close needs limits of current and voltage")
        payload = bytes([OPEN]) if limits is None or not close else encode_close(limits)
        advice: dict[int, str] = {
            AckError.BAD_PAYLOAD: "a limit of current, voltage or time is out of range",
            AckError.NOT_NOW: "the contactor is already closed",
        }
        try:
            self._ask(PacketType.CONTACTOR, payload, attempt_timeout=0.05, attempts=4, advice=advice)
        except CommandRefused as error:
            # If a repeated close finds the contactor closed, only the first answer was lost.
            if not (close and error.error == AckError.NOT_NOW and error.attempts > 1):
                raise

    def limit_current(self, current: float) -> None:
        """Change the largest current (A) of a closed contactor.

        Raises:
            CommandRefused: the contactor is open, or the current is out of range.
        """
        advice: dict[int, str] = {AckError.NOT_NOW: "the contactor is open"}
        self._ask(PacketType.CONTACTOR, encode_limit(current), attempt_timeout=0.05, attempts=4, advice=advice)

    def clear_weld(self) -> None:
        """Clear a latched weld. Only a person who has replaced the contactor may order it.

        Raises:
            CommandRefused: something is still live, the contactor is closed, or another fault is latched.
        """
        advice: dict[int, str] = {
            AckError.BAD_PAYLOAD: "its firmware latches no welds; flash the current one",
            AckError.INTERLOCK: "contactor or electrodes are live, or their current is not measured",
            AckError.NOT_NOW: "the contactor is closed, or another fault is latched; open it first",
        }
        self._ask(PacketType.CONTACTOR, bytes([CLEAR_WELD]), attempt_timeout=0.05, attempts=4, advice=advice)

    def probe(self) -> ProbeResult:
        """Look at the port between the electrodes (≤ 5 V, ≤ 50 mA); the board takes up to `PROBE_TIMEOUT`.

        Raises:
            CommandRefused: the contactor is closed, a probe is running, an opening interrupted it, a fault is latched,
                or current flows.
        """
        advice: dict[int, str] = {
            AckError.INTERLOCK: "a fault is latched, or current flows; open the contactor, then probe",
            AckError.NOT_NOW: "the contactor is closed, another probe is running, or an opening interrupted this one",
        }
        request = self._ask(PacketType.PROBE, attempt_timeout=PROBE_TIMEOUT + 0.1, attempts=2, advice=advice)
        assert request.ack is not None
        resistance, voltage = decode_probe(request.ack.data)
        return ProbeResult(resistance, voltage, request.received)

    def ping(self, data: bytes | None = None) -> float:
        """Send up to 64 bytes, have them returned, and return the round-trip time, s.

        Raises:
            ValueError: more than 64 bytes.
        """
        data = struct.pack("<Q", next(_PING_NUMBERS)) if data is None else data
        if len(data) > LONGEST_PING:
            raise ValueError(f"{len(data)} bytes; a PING carries at most {LONGEST_PING}")
        sent = time.monotonic()
        return self._ask(PacketType.PING, data).received - sent

    def send_to_servos(self, data: bytes) -> None:
        """Send bytes on the servos' bus behind the board, without confirmation; replies arrive through on_servo.

        Raises:
            PortGone: the port vanished.
        """
        for at in range(0, len(data), LONGEST_SERVO):
            self._send(PacketType.SERVO, data[at : at + LONGEST_SERVO])

    def set_servo_speed(self, speed: int) -> None:
        """Set the speed of the servos' bus behind the board, bit/s.

        Raises:
            CommandRefused: the board does not support this speed.
        """
        advice: dict[int, str] = {AckError.BAD_PAYLOAD: f"the servos' bus does not support {speed} bit/s"}
        self._ask(PacketType.SERVO_SPEED, encode_servo_speed(speed), advice=advice)
