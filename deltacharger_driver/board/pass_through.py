# SPDX-License-Identifier: Apache-2.0
"""The servos' bus behind the board as a serial port of this computer: one cable serves servos and pads.

Bytes are passed through, whatever they mean: who opens the port speaks to the servos as over an adapter of its own.
"""

from __future__ import annotations

import contextlib
import logging
import math
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from deltacharger_core import runtime
from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.errors import DriverError, NoServosBehindBoard, PortError
from deltacharger_driver.pseudo_terminal import PseudoTerminal

_log = logging.getLogger(__name__)
_QUIET = 0.1  # s without a byte, ten cycles of servo_node, after which nobody speaks to the servos any more
_LOOK = 0.01  # s


class PassThrough:
    """A port for the servos, there while a board that carries them is connected.

    Args:
        link: to the board.
        path: where the port appears, as a link to a pseudo-terminal.
    """

    def __init__(self, link: BoardLink, path: Path) -> None:
        self.path = path
        self._link = link
        self._terminal = PseudoTerminal(self, path)
        self._lock = threading.Lock()
        self._is_open = False
        self._came = b""
        self._speed = 0  # that the board was told, bit/s; 0 = none since its boot
        self._asked = -math.inf

    def open(self) -> None:
        """Let the port appear; where it is there already, tell the board, which has booted, the speed again.

        Raises:
            PortError: it cannot be made.
        """
        with self._lock:
            self._speed, self._came = 0, b""
            if self._is_open:
                return
            try:
                runtime.make(self.path.parent)
                self._terminal.start()
            except OSError as error:
                raise PortError(
                    str(self.path), f"the port of the servos behind the board cannot be made: {error}"
                ) from error
            self._is_open = True

    def close(self) -> None:
        """Take the port away: who has it open loses it, as if the cable were pulled. Safe to call twice."""
        with self._lock:
            was_open, self._is_open = self._is_open, False
        if was_open:
            self._terminal.stop()

    def wait_until_quiet(self, timeout: float) -> None:
        """Wait until nobody has spoken to the servos for a moment, at most `timeout` s: who makes them safe may end."""
        end = time.monotonic() + timeout
        while (now := time.monotonic()) < min(end, self._asked + _QUIET):
            time.sleep(min(_LOOK, end - now))

    def take(self, data: bytes) -> None:
        """Take bytes that came from the servos' bus; for the link's reader."""
        with self._lock:
            if self._is_open:
                self._came += data
                self._terminal.wake()

    def receive(self, data: bytes, now: float) -> bytes:
        """Send what was written to the port, the port's speed first where it is another."""
        self._asked = now
        speed = self._terminal.speed()
        try:
            if speed not in (0, self._speed):
                self._link.set_servo_speed(speed)
                self._speed = speed
            self._link.send_to_servos(data)
        except DriverError as error:  # to who asks, the servos are silent; the keeper looks after the link
            _log.debug("not passed through: %s", error)
        return b""

    def poll(self, now: float) -> bytes:
        """Return what has come from the servos' bus."""
        with self._lock:
            came, self._came = self._came, b""
        return came

    def next_event(self, now: float) -> float:
        """Return inf: `take` wakes."""
        return math.inf


@contextlib.contextmanager
def servos_behind(port: str, baud_rate: int) -> Iterator[str]:
    """Yield the path of a port for the servos that hang on a board, for a while in which no tactile_node runs.

    Args:
        port: of the board; nobody else may have it open.
        baud_rate: of the link to it, bit/s.

    Raises:
        PortError, NoAnswer, BoardMismatch, WrongDevice: as of `BoardLink.open`.
        NoServosBehindBoard: no servos hang on this board.
    """
    with contextlib.ExitStack() as stack:
        link = BoardLink(port, baud_rate, on_servo=lambda data: servos.take(data))
        stack.callback(link.close)
        if not link.open().carries_servos:
            raise NoServosBehindBoard(port)
        folder = stack.enter_context(tempfile.TemporaryDirectory("", "deltacharger-"))
        servos = PassThrough(link, Path(folder) / "servos")
        stack.callback(servos.close)
        servos.open()
        yield str(servos.path)
