# SPDX-License-Identifier: Apache-2.0
"""The tests of the emulated board, run on the firmware: both must do the same."""

from __future__ import annotations

import pytest

from .board_host import on_firmware

NOT_OF_THE_BOARD = {
    "test_a_late_poll_sends_all_samples_and_a_very_late_one_flags_overrun",  # a real board cannot sample the past
    "test_wire_faults_affect_the_selected_packets",  # a hook of the emulator
}

pytestmark = pytest.mark.usefixtures("firmware_boards")

globals().update(on_firmware("test_board_emulator_contactor"))
globals().update(on_firmware("test_board_emulator", NOT_OF_THE_BOARD, pytest.mark.rest))
globals().update(on_firmware("test_board_emulator_pads", mark=pytest.mark.rest))
