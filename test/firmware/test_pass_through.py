# SPDX-License-Identifier: Apache-2.0
"""The tests of servos behind the emulated board, run on the firmware."""

from __future__ import annotations

import pytest

from .board_host import on_firmware

NOT_OF_THE_BOARD = {
    # A boot of the firmware takes no time here, so few boots interrupt a packet; in steps: test_servo_bus.py.
    "test_a_board_reset_during_a_packet_loses_some_cycles",
    "test_the_contactor_keeps_its_limits_under_continuous_servo_traffic",  # by hooks of the emulator
}

pytestmark = [pytest.mark.ros, pytest.mark.night, pytest.mark.usefixtures("firmware_boards")]

globals().update(on_firmware("test_pass_through", NOT_OF_THE_BOARD))
