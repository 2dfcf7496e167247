# SPDX-License-Identifier: Apache-2.0
"""The time limit for the end of a process."""

from __future__ import annotations

import subprocess
import sys

import pytest

from ..marks import rest

_HANGS = "import ctypes; ctypes.PyDLL(None).pause()"  # blocks for ever with Python's lock


def _run(limit: float, code: int, then: str) -> int:
    program = f"from deltacharger_core.exit_timer import exit_within; exit_within({limit}, {code}); {then}"
    return subprocess.run([sys.executable, "-c", program], timeout=20.0, check=False).returncode


@pytest.mark.parametrize(("limit", "code"), [(0.2, 0), rest(1.2, 7)])
def test_a_process_that_hangs_ends_within_its_limit(limit: float, code: int) -> None:
    assert _run(limit, code, _HANGS) == code


def test_a_process_that_ends_in_time_keeps_its_exit_code() -> None:
    assert _run(30.0, 0, "raise SystemExit(3)") == 3
