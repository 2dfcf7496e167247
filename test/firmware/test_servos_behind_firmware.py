# SPDX-License-Identifier: Apache-2.0
"""The tests of servos and servo_node, run on servos connected to the firmware's host program."""

from __future__ import annotations

from pathlib import Path

import pytest

from ..behind_board import BehindFirmware, servo_tests

pytestmark = [pytest.mark.ros, pytest.mark.night]

globals().update(servo_tests("tests_behind_firmware", BehindFirmware))


@pytest.fixture(scope="session", autouse=True)
def host_program(programs: Path) -> None:
    BehindFirmware.program = programs / "board_host"
