# SPDX-License-Identifier: Apache-2.0
"""The tests of servos and servo_node, run on servos connected to the firmware's host program."""

from __future__ import annotations

from pathlib import Path

import pytest

from ..behind_board import SERVO_TESTS, BehindFirmware, behind
from ..borrowed import anew, borrowed_tests

pytestmark = [pytest.mark.ros, pytest.mark.night, pytest.mark.usefixtures("host_program")]

for _name in SERVO_TESTS:
    globals().update(borrowed_tests(anew(_name, "tests_behind_firmware", PseudoTerminal=behind(BehindFirmware)), set()))


@pytest.fixture
def host_program(programs: Path) -> None:
    BehindFirmware.program = programs / "board_host"
