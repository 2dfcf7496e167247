# SPDX-License-Identifier: Apache-2.0
"""Emulated servos connected to a board; their port reaches them through tactile_node's end of the link."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

from deltacharger_driver.board.keeper import BoardKeeper
from deltacharger_driver.ports import ByteDevice, PseudoTerminal
from deltacharger_sim.emulators.board import BoardEmulator

from .firmware.build import host_programs
from .plants import BenchPlant
from .waiting import wait_until


class BehindEmulator:
    """Servos behind the emulated board, in place of their own `PseudoTerminal`."""

    def __init__(self, device: ByteDevice) -> None:
        self._folder = tempfile.TemporaryDirectory("", "deltacharger-")
        self._board_port = Path(self._folder.name) / "board"
        self.path = str(self._board_port.with_name("servos"))
        self._keeper: BoardKeeper | None = None
        self._serve(device)

    def _serve(self, device: ByteDevice) -> None:
        self.plant = BenchPlant()
        self.board = BoardEmulator(self.plant, servos=device)
        self._cable = PseudoTerminal(self.board, self._board_port)

    def speed(self) -> int:
        """Return the speed of the servos' bus, bit/s."""
        return self.board.servos.speed

    def start(self) -> BehindEmulator:
        """Plug the board in, and wait for the servos' port."""
        self._plug()
        nothing = [lambda *_: None] * 3
        self._keeper = BoardKeeper(str(self._board_port), 120.0, *nothing, Path(self.path))
        self._keeper.start()
        wait_until(Path(self.path).exists)
        return self

    def _plug(self) -> None:
        self._cable.start()

    def _unplug(self) -> None:
        self._cable.stop()

    def stop(self) -> None:
        """Unplug the board, and with it the servos' port. Safe to call twice."""
        if self._keeper is not None:
            self._unplug()
            self._keeper.close()
            self._keeper = None

    def __enter__(self) -> BehindEmulator:
        return self.start()

    def __exit__(self, *exception: object) -> None:
        self.stop()


class BehindFirmware(BehindEmulator):
    """Servos behind the firmware's host program."""

    def _serve(self, device: ByteDevice) -> None:
        self._bus = PseudoTerminal(device, Path(self._folder.name) / "bus")

    def speed(self) -> int:
        """Return the speed of the servos' bus, bit/s."""
        return self._bus.speed()

    def _plug(self) -> None:
        self._bus.start()
        self._process = subprocess.Popen(
            [host_programs() / "board_host", "--servos", self._bus.path, "--pty", str(self._board_port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == f"ready {self._board_port}\n"

    def _unplug(self) -> None:
        _, errors = self._process.communicate("quit\n", timeout=10.0)
        assert self._process.returncode == 0, errors
        assert not errors, errors
        self._bus.stop()
