# SPDX-License-Identifier: Apache-2.0
"""The servos' bus behind the board as a serial port of this computer: one cable serves servos and pads.

All bytes are passed through unchanged: a program uses the port like a servo adapter.
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
_QUIET = 0.1  # s without a byte (ten cycles of servo_node) after which the port counts as unused
_LOOK = 0.01  # s


class PassThrough:
    """The servos' serial port; exists while a board that carries them is connected.

    Args:
        link: to the board.
        path: of the port, a link to a pseudo-terminal.
    """

    def __init__(self, link: BoardLink, path: Path) -> None:
        self.path = path
        self._link = link
        self._terminal = PseudoTerminal(self, path)
        self._lock = threading.Lock()
        self._is_open = False
        self._received = b""
        self._speed = 0  # last speed sent to the board, bit/s; 0 = none since its boot
        self._asked = -math.inf

    def open(self) -> None:
        """Create the port. If it exists, the board has booted: its speed is set again before the next bytes.

        Raises:
            PortError: it cannot be created.
        """
        with self._lock:
            self._speed, self._received = 0, b""
            if self._is_open:
                return
            try:
                runtime.make(self.path.parent)
                self._terminal.start()
            except OSError as error:
                raise PortError(
                    str(self.path), f"the servo port behind the board cannot be created: {error}"
                ) from error
            self._is_open = True

    def close(self) -> None:
        """Remove the port; for a program that has it open, the cable is pulled. Idempotent."""
        with self._lock:
            was_open, self._is_open = self._is_open, False
        if was_open:
            self._terminal.stop()

    def wait_until_quiet(self, timeout: float) -> None:
        """Wait until the port is unused, at most `timeout` s, so that servo_node can make the servos safe."""
        end = time.monotonic() + timeout
        while (now := time.monotonic()) < min(end, self._asked + _QUIET):
            time.sleep(min(_LOOK, end - now))

    def take(self, data: bytes) -> None:
        """Take bytes from the servos' bus; called by the link's reader."""
        with self._lock:
            if self._is_open:
                self._received += data
                self._terminal.wake()

    def receive(self, data: bytes, now: float) -> bytes:
        """Send bytes written to the port; if its speed changed, set the bus speed first."""
        self._asked = now
        speed = self._terminal.speed()
        try:
            if speed not in (0, self._speed):
                self._link.set_servo_speed(speed)
                self._speed = speed
            self._link.send_to_servos(data)
        except DriverError as error:  # the program sees silent servos; the keeper reconnects the link
            _log.debug("not passed through: %s", error)
        return b""

    def poll(self, now: float) -> bytes:
        """Return bytes received from the servos' bus."""
        with self._lock:
            received, self._received = self._received, b""
        return received

    def next_event(self, now: float) -> float:
        """Return inf: `take` wakes the terminal."""
        return math.inf


@contextlib.contextmanager
def servos_behind(port: str, baud_rate: int) -> Iterator[str]:
    """Yield the path of a port for the servos connected to a board; only while no tactile_node runs.

    Args:
        port: of the board; no other program may have it open.
        baud_rate: of the link to it, bit/s.

    Raises:
        PortError, NoAnswer, BoardMismatch, WrongDevice: as for `BoardLink.open`.
        NoServosBehindBoard: no servos are connected to this board.
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
