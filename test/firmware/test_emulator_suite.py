# SPDX-License-Identifier: Apache-2.0
"""The tests of the emulated board, run on the firmware: both must do the same."""

import pytest

from .board_host import on_firmware

pytestmark = pytest.mark.usefixtures("firmware_boards")

globals().update(on_firmware("test_board_emulator"))
