# SPDX-License-Identifier: Apache-2.0
"""Simulated hardware: one world behind emulated servos and an emulated board, each on a pseudo-terminal.

It replaces the missing hardware: nodes, driver and bytes are the robot's, in real time. A program that opens the ports
cannot distinguish them from the robot's. A socket beside them accepts faults (fault_channel). No ROS is used here.
"""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import math
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from deltacharger_core import environment, machine, runtime
from deltacharger_driver.ports import ByteDevice, PseudoTerminal
from deltacharger_sim.charger.fault_channel import SOCKET, ControlServer, Registration, answer
from deltacharger_sim.charger.faults import Faults, Hardware
from deltacharger_sim.charger.simulation import Simulation
from deltacharger_sim.emulators.board import BoardEmulator
from deltacharger_sim.emulators.servo_bus import ServoBusEmulator
from deltacharger_sim.world import SharedWorld

_log = logging.getLogger(__name__)
_SERVO, _BOARD = "servo", "board"  # names of the ports


class SimulatedCharger:
    """Serves the emulated servo bus and board until stopped.

    Args:
        simulation: its parameters.
        directory: of the ports `servo` and `board`, and of the socket `control` for faults; None creates a
            temporary one and removes it at the end.
        namespace: of the charger; `deltacharger fault` finds the charger by it.

    Attributes:
        servo_port: path of the servo bus, or `board` if the servos are connected to the board.
        board_port: path of the board.
        faults: of the hardware; None before the start.
    """

    def __init__(self, simulation: Simulation, directory: Path | None = None, namespace: str = "") -> None:
        self._simulation = simulation
        self._directory = directory
        self._namespace = namespace
        self._terminals: list[PseudoTerminal] = []
        self._taps: dict[str, _Tap] = {}
        self._opened = contextlib.ExitStack()
        self.faults: Faults | None = None
        self.servo_port = ""
        self.board_port = ""
        self.world = simulation.build_world()

    def start(self) -> SimulatedCharger:
        """Open both ports."""
        plant = SharedWorld(self.world)
        servos = ServoBusEmulator(plant, seed=self._simulation.seed)
        on_board = self._simulation.servos == "board"
        board = BoardEmulator(
            plant,
            seed=self._simulation.seed,
            servos=servos if on_board else None,
            stage=self._simulation.world.stage,
        )
        with contextlib.ExitStack() as opened:
            folder = self._directory or Path(
                opened.enter_context(tempfile.TemporaryDirectory("", "deltacharger-", ignore_cleanup_errors=True))
            )
            board_terminal = self._serve(board, folder / _BOARD, opened)
            servo_terminal = board_terminal if on_board else self._serve(servos, folder / _SERVO, opened)
            servos.line_speed = (lambda: board.servos.speed) if on_board else servo_terminal.speed
            self.board_port = board_terminal.path
            self.servo_port = machine.BEHIND_BOARD if on_board else servo_terminal.path
            hardware = Hardware(servos, board, servo_terminal, board_terminal, plant)
            self.faults = Faults(self._simulation.faults, hardware, time.monotonic)
            opened.callback(self.faults.close)
            self._listen(self.faults, folder / SOCKET, opened)
            self._opened = opened.pop_all()
        return self

    def stop(self) -> None:
        """Close both ports, as if unplugged. Safe to call twice."""
        self._opened.close()
        self._terminals.clear()

    def __enter__(self) -> SimulatedCharger:
        return self.start()

    def __exit__(self, *exception: object) -> None:
        self.stop()

    def errors(self) -> list[BaseException]:
        """Return the errors that ended an emulator's thread; empty while both serve."""
        return [terminal.error for terminal in self._terminals if terminal.error is not None]

    def record(self) -> dict[str, Any]:
        """Return the true events in the world; for reports and tests, never for docking."""
        return dataclasses.asdict(self.world.record)

    def wait_until_quiet(self, quiet: float, timeout: float, hurry: threading.Event) -> bool:
        """Wait until no host has sent a byte for `quiet` (s), at most `timeout` (s) or until `hurry` is set."""
        deadline = time.monotonic() + timeout
        while True:
            silence = time.monotonic() - max((tap.last for tap in self._taps.values()), default=-math.inf)
            if silence >= quiet:
                return True
            left = min(quiet - silence, deadline - time.monotonic())
            if left <= 0.0 or hurry.wait(left):
                return False

    def _listen(self, faults: Faults, path: Path, opened: contextlib.ExitStack) -> None:
        control = ControlServer(path, lambda request: answer(faults, request))
        opened.callback(control.close)
        name = runtime.charger(environment.domain(), self._namespace)
        try:
            opened.callback(Registration(name, path).remove)
        except OSError as error:  # the charger works even if it cannot be found by its domain
            level = logging.INFO if self._directory is None else logging.WARNING
            _log.log(level, "'deltacharger fault' finds this charger only by --directory %s: %s", path.parent, error)

    def _serve(self, device: ByteDevice, link: Path, opened: contextlib.ExitStack) -> PseudoTerminal:
        tap = self._taps[link.name] = _Tap(device)
        terminal = opened.enter_context(PseudoTerminal(tap, link))
        self._terminals.append(terminal)
        return terminal


class _Tap:
    """A device that remembers when its host last sent bytes."""

    def __init__(self, device: ByteDevice) -> None:
        self._device = device
        self.last = -math.inf

    def receive(self, data: bytes, now: float) -> bytes:
        self.last = now
        return self._device.receive(data, now)

    def poll(self, now: float) -> bytes:
        return self._device.poll(now)

    def next_event(self, now: float) -> float:
        return self._device.next_event(now)
