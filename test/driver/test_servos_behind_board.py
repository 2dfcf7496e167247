# SPDX-License-Identifier: Apache-2.0
"""The tests of servos and servo_node, run in real time on servos connected to the emulated board."""

from __future__ import annotations

import pytest

from ..behind_board import SOME, BehindEmulator, servo_tests

pytestmark = pytest.mark.ros

_tests = servo_tests("tests_behind_board", BehindEmulator)
for _name, _test in _tests.items():
    if _name.startswith("test_"):
        (pytest.mark.rest if _name in SOME else pytest.mark.night)(_test)
globals().update(_tests)
assert _tests.keys() >= SOME
