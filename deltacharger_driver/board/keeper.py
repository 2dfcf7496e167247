# SPDX-License-Identifier: Apache-2.0
"""Keeps the board link up: connects, configures, watches, reconnects, and offers the servos behind it. No ROS."""

import contextlib
import logging
import math
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from deltacharger_core import runtime
from deltacharger_driver import errors, ports
from deltacharger_driver.board import contactor, protocol
from deltacharger_driver.board.link import BoardLink

_log = logging.getLogger(__name__)
_QUIET = 0.1  # s without a byte (ten cycles of servo_node) after which the port counts as unused
_LOOK = 0.01  # s
_SHORTEST_BACKOFF, _LONGEST_BACKOFF = 0.1, 0.5  # s
_SILENCE = 1.0  # s without any packet: the cable is broken or the board hangs
_STREAM_SILENCE = 0.5  # s without a frame although other packets arrive: the board did not get START
_LONGEST_WAIT = 0.1  # s between checks
_SERVOS_SAFE = 1.0  # s at the end for servo_node to make the servos safe through the board
# s of power samples after the last report of a closed contactor: four periods. Clients that are closing, one of which
# may have opened it, see that it is open and that no current flows.
_FINAL_REPORTS = 0.2


class PassThrough:
    """The servos' bus behind the board as a serial port of this computer: one cable serves servos and pads.

    All bytes are passed through unchanged: a program uses the port like a servo adapter. It exists while a board that
    carries the servos is connected.

    Args:
        link: to the board.
        path: of the port, a link to a pseudo-terminal.
    """

    def __init__(self, link: BoardLink, path: Path) -> None:
        self.path = path
        self._link = link
        self._terminal = ports.PseudoTerminal(self, path)
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
                raise errors.PortError(str(self.path), f"it cannot be created for the servos: {error}") from error
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

    def take_bytes(self, data: bytes) -> None:
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
        except errors.DriverError as error:  # the program sees silent servos; the keeper reconnects the link
            _log.debug("not passed through: %s", error)
        return b""

    def poll(self, now: float) -> bytes:
        """Return bytes received from the servos' bus."""
        with self._lock:
            received, self._received = self._received, b""
        return received

    def next_event(self, now: float) -> float:
        """Return inf: `take_bytes` wakes the terminal."""
        return math.inf


@contextlib.contextmanager
def servos_behind(port: str) -> Iterator[str]:
    """Yield the path of a port for the servos connected to a board; only while no tactile_node runs.

    Args:
        port: of the board; no other program may have it open.

    Raises:
        PortError, NoAnswer, BoardMismatch: as for `BoardLink.open`.
        NoServosBehindBoard: no servos are connected to this board.
    """
    with contextlib.ExitStack() as stack:
        link = BoardLink(port, on_servo=lambda data: servos.take_bytes(data))
        stack.callback(link.close)
        if not link.open().carries_servos:
            raise errors.NoServosBehindBoard(port)
        folder = stack.enter_context(tempfile.TemporaryDirectory("", "deltacharger-"))
        servos = PassThrough(link, Path(folder) / "servos")
        stack.callback(servos.close)
        servos.open()
        yield str(servos.path)


class BoardKeeper:
    """Connects to one board and reconnects as often as necessary.

    After every connection and every reboot of the board it sets the rate and starts the stream. The contactor stays
    open and the pads are not tared until a client requests it.

    Attributes:
        link: to the board.
        carries_servos: whether the servos' bus is connected to the last board.
        guard: of its contactor.
        servos: the servo port, if the board carries the bus.
        problem: why there is no connection; '' while connected.

    Args:
        port: path of the port.
        rate: tactile frames per second, Hz.
        on_tactile: called in the reader's thread.
        on_power: called in the reader's thread.
        on_change: called in the keeper's thread with `problem` whenever it changes.
        servo_port: path of the servo port, if the board carries the bus.
    """

    def __init__(
        self,
        port: str,
        rate: float,
        on_tactile: Callable[[protocol.TactileSample], None],
        on_power: Callable[[protocol.PowerSample], None],
        on_change: Callable[[str], None],
        servo_port: Path,
    ) -> None:
        self._rate = rate
        self._on_tactile = on_tactile
        self._on_power = on_power
        self._on_change = on_change
        self._wake = threading.Event()
        self._stop = threading.Event()
        self._rebooted = False
        self._last_packet = self._last_frame = 0.0
        self._last_closed = -math.inf
        self.carries_servos = False
        self.problem = f"{port}: not connected yet"
        self.link = BoardLink(
            port,
            on_tactile=self._take_tactile,
            on_power=self._take_power,
            on_boot=self._take_boot,
            on_servo=self._take_servo,
        )
        self.servos = PassThrough(self.link, servo_port)
        self.guard = contactor.ContactorGuard(self.link, on_lease=self._wake.set)
        self._thread = threading.Thread(target=self._run, name=f"board keeper {port}", daemon=True)

    def start(self) -> None:
        """Begin to connect."""
        self._thread.start()

    def close(self) -> None:
        """Open the contactor and confirm it, stop the stream, release the port, join the threads. Idempotent."""
        self._stop.set()
        self._wake.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        backoff = _SHORTEST_BACKOFF
        while not self._stop.is_set():
            try:
                self.carries_servos = self.link.open().carries_servos
                self._configure()
                backoff = _SHORTEST_BACKOFF
                self._watch()
                self._shut_down()
            except errors.DriverError as error:
                self._report(str(error))
            finally:
                self.guard.interrupted()
                self.servos.close()
                self.link.close()
            self._stop.wait(backoff)
            backoff = min(backoff * 2.0, _LONGEST_BACKOFF)

    def _configure(self) -> None:
        self._rebooted = False
        self._last_packet = self._last_frame = time.monotonic()
        self.link.set_rate(self._rate)
        self.link.start()
        if self.carries_servos:
            self.servos.open()
        self._report("")

    def _watch(self) -> None:
        while not self._stop.is_set():
            self._wake.wait(min(self.guard.remaining(), _LONGEST_WAIT))
            self._wake.clear()
            if self.link.gone is not None:
                raise self.link.gone
            self.guard.tick()
            now = time.monotonic()
            if now - self._last_packet > _SILENCE:
                raise errors.PortError(self.link.port, f"the board has sent no packet for {_SILENCE:g} s")
            if self._rebooted or now - self._last_frame > _STREAM_SILENCE:
                self._configure()

    def _shut_down(self) -> None:
        with contextlib.suppress(errors.DriverError):
            self.guard.shut_down()
        time.sleep(max(0.0, self._last_closed + _FINAL_REPORTS - time.monotonic()))  # the reader continues
        self.servos.wait_until_quiet(_SERVOS_SAFE)
        with contextlib.suppress(errors.DriverError):
            self.link.stop()

    def _report(self, problem: str) -> None:
        if problem != self.problem:
            self.problem = problem
            self._on_change(problem)

    def _take_tactile(self, sample: protocol.TactileSample) -> None:
        self._last_frame = self._last_packet = time.monotonic()
        self.guard.observe_tactile(sample)
        self._on_tactile(sample)

    def _take_power(self, sample: protocol.PowerSample) -> None:
        self._last_packet = time.monotonic()
        if sample.power.contactor_closed:
            self._last_closed = self._last_packet
        self.guard.observe_power(sample)
        self._on_power(sample)

    def _take_servo(self, data: bytes) -> None:
        self._last_packet = time.monotonic()
        self.servos.take_bytes(data)

    def _take_boot(self) -> None:
        self.guard.interrupted()
        self._rebooted = True
        self._wake.set()
