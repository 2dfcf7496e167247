# SPDX-License-Identifier: Apache-2.0
"""Emulated servos connected to a board; their port reaches them through tactile_node's end of the link."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path
from typing import ClassVar

from deltacharger_driver.board.keeper import BoardKeeper
from deltacharger_driver.emulators.bench import BenchPlant
from deltacharger_driver.emulators.board import BoardEmulator
from deltacharger_driver.ports import ByteDevice, PseudoTerminal
from deltacharger_driver.servos.link import ServoPort

from .borrowed import anew, borrowed_tests
from .driver.virtual_line import RealClock
from .waiting import wait_until

SERVO_TESTS = ("conftest", "test_servo_node", "test_servo_bus", "test_servo_controller")
"""Driver test modules that also apply to servos behind a board, and their fixtures."""
SOME = {
    "test_torque_on_holds_and_off_releases",
    "test_a_single_lost_reply_does_not_stop_and_keeps_the_last_values",
    "test_a_vanished_port_opens_the_contactor_and_is_back_soon_after_its_return",
    "test_closing_opens_the_contactor_and_switches_torque_off_whatever_happens",
    "test_a_contactor_that_stays_closed_does_not_keep_the_torque_on",
    "test_a_line_sent_in_pieces_is_followed_like_one_message_and_its_end_is_held",
    "test_a_pause_after_the_end_does_not_move_the_arm",
    "test_torque_off_reaches_the_servos_that_answer",
    "test_servos_set_to_send_no_replies_are_set_to_reply",
    "test_torque_trajectory_hold_torque_off_and_reboot",
}
"""Those that CI runs behind the emulated board; the others run at night."""


class BehindEmulator:
    """Servos behind the emulated board, in place of their own `PseudoTerminal` or `Line`."""

    handler = ServoPort

    def __init__(self, device: ByteDevice, clock: object = None) -> None:
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
        self._keeper = BoardKeeper(str(self._board_port), 1_000_000, 120.0, *nothing, Path(self.path))
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

    program: ClassVar[Path]

    def _serve(self, device: ByteDevice) -> None:
        self._bus = PseudoTerminal(device, Path(self._folder.name) / "bus")

    def speed(self) -> int:
        """Return the speed of the servos' bus, bit/s."""
        return self._bus.speed()

    def _plug(self) -> None:
        self._bus.start()
        self._process = subprocess.Popen(
            [self.program, "--servos", self._bus.path, "--pty", str(self._board_port)],
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


def servo_tests(group: str, kind: type[BehindEmulator]) -> dict[str, object]:
    """Return the tests of servos by name, run in real time on servos behind a board."""
    others = {"PseudoTerminal": kind, "Line": kind, "Clock": RealClock}
    tests: dict[str, object] = {}
    for name in SERVO_TESTS:
        tests |= borrowed_tests(anew(name, group, **others), set())
    for test in tests.values():  # those that need more time than a test of `make test` are marked by the borrower
        if hasattr(test, "pytestmark"):
            test.pytestmark = [mark for mark in test.pytestmark if mark.name not in ("witness", "rest", "version")]
    return tests
