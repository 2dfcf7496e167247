# SPDX-License-Identifier: Apache-2.0
"""The tests of `BoardLink`, run over a real pseudo-terminal against the firmware."""

from __future__ import annotations

import pytest

from .board_host import on_firmware

NOT_OF_THE_BOARD = {
    "test_an_incompatible_device_is_refused_with_the_reason",  # a puppet answers
    "test_unknown_types_and_bad_payloads_are_counted_and_dropped",  # the host alone
    "test_a_missing_port_has_its_own_error",
    "test_a_busy_port_has_its_own_error",
    "test_a_forbidden_port_has_its_own_error",
    "test_every_kind_of_hang_up_is_one_error",
    "test_a_failing_callback_does_not_end_the_link",
    "test_a_command_from_a_callback_is_refused",
}

pytestmark = [pytest.mark.night, pytest.mark.usefixtures("firmware_boards")]

globals().update(on_firmware("test_board_link", NOT_OF_THE_BOARD))
