# SPDX-License-Identifier: Apache-2.0
"""The tests of `BoardLink`, run over a real pseudo-terminal against the firmware."""

from __future__ import annotations

import pytest

from .board_host import on_firmware

NOT_OF_THE_BOARD = {
    "test_an_incompatible_device_is_refused_with_the_reason",  # a puppet answers
    "test_a_reboot_with_a_lost_hello_is_detected_by_the_clock",  # by a hook of the emulator
}

pytestmark = [pytest.mark.night, pytest.mark.usefixtures("firmware_boards")]

globals().update(on_firmware("test_board_link", NOT_OF_THE_BOARD))
