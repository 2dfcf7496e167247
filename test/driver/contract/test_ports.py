# SPDX-License-Identifier: Apache-2.0
"""Options that select the contract's devices, in separate runs with emulators on given ports."""

from __future__ import annotations

import pytest

from .conftest import open_servos, opened


def test_a_device_that_cannot_be_opened_fails_and_one_that_was_not_given_is_skipped() -> None:
    with pytest.raises(pytest.fail.Exception, match="nothing_here"):
        opened("servo", {"servo": "/dev/nothing_here"}, open_servos)
    with pytest.raises(pytest.skip.Exception, match="--port board"):
        opened("board", {"servo": "/dev/nothing_here"}, open_servos)
