# SPDX-License-Identifier: Apache-2.0
"""The tests of servos and servo_node, run on servos connected to the emulated board."""

from __future__ import annotations

import pytest

from ..behind_board import SERVO_TESTS, BehindEmulator, behind
from ..borrowed import anew, borrowed_tests

pytestmark = pytest.mark.ros

for _name in SERVO_TESTS:
    globals().update(borrowed_tests(anew(_name, "tests_behind_board", PseudoTerminal=behind(BehindEmulator)), set()))
