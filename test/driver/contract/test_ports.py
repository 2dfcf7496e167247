# SPDX-License-Identifier: Apache-2.0
"""Options that select the contract's devices, in separate runs with emulators on given ports."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from .conftest import open_servos, opened
from .sites import emulated_servos

HERE = Path(__file__).parent
REPOSITORY = HERE.parents[2]


def run(*words: str) -> tuple[int, str, dict[str, int]]:
    """Run the contract's shortest tests and return exit code, output, and the count of each outcome."""
    chosen = ["-k", "the_port_is_identified or torque_is_off or no_close_without_a_heartbeat"]
    command = [sys.executable, "-m", "pytest", str(HERE), *chosen, "-p", "no:cacheprovider", "--color=no", *words]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=100.0)
    output = done.stdout + done.stderr
    counts = re.findall(r"(\d+) (passed|failed|errors?|skipped)", output.splitlines()[-1] if output else "")
    return done.returncode, output, {outcome.rstrip("s"): int(number) for number, outcome in counts}


def test_a_device_that_cannot_be_opened_fails_and_one_that_was_not_given_is_skipped() -> None:
    with pytest.raises(pytest.fail.Exception, match="nothing_here"):
        opened("servo", {"servo": "/dev/nothing_here"}, open_servos)
    with pytest.raises(pytest.skip.Exception, match="--port board"):
        opened("board", {"servo": "/dev/nothing_here"}, open_servos)


@pytest.mark.rest
def test_missing_devices_and_moving_tests_are_skipped_with_the_reason() -> None:
    with emulated_servos() as site:
        code, output, counts = run(f"--port=servo={site.path}")
        assert (code, counts) == (0, {"passed": 1, "skipped": 3}), output
        assert "--move" in output
        assert "--port board" in output
