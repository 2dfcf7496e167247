# SPDX-License-Identifier: Apache-2.0
"""Commands in every kind of shell, as processes: a line with the problem and the right exit code, never a traceback."""

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from ..marks import rest

ROOT = Path(__file__).resolve().parents[2]
CLI = ("-m", "deltacharger_bringup.cli")
# Arguments of Python, and their exit code in a normal shell.
COMMAND_LINES: dict[str, tuple[tuple[str, ...], int]] = {
    "list": ((*CLI, "scene", "level"), 0),
    "json": ((*CLI, "scene", "level", "--json"), 0),
    "wrong": ((*CLI, "dock", "--x-mm", "left", "--json"), 2),
    "missing": ((*CLI, "vision", "detect", "nothing.png"), 2),
    "folder": ((*CLI, "calibrate", "camera", "--print", "/proc/self/board.svg"), 2),
    "node": (("-m", "deltacharger_driver.servos.servo_node"), 2),
}
PLAIN_C = "LC_ALL=C PYTHONUTF8=0 PYTHONCOERCECLOCALE=0"
SHELLS = {
    "full": "{} >/dev/full",
    "full errors": "{} 2>/dev/full",
    "all closed": "{} <&- >&- 2>&-",
    "both full": "{} >/dev/full 2>/dev/full",
    "a reader that leaves": "{} | head -1; exit ${{PIPESTATUS[0]}}",
    "ASCII": f"{PLAIN_C} PYTHONIOENCODING=ascii {{}}",
    "a home that cannot be": "env -u ROS_LOG_DIR HOME=/proc/nowhere {}",
    "no folder for what is temporary": "TMPDIR=/nowhere {}",
    "removed folder": "mkdir gone && cd gone && rmdir ../gone && {}",
}
FULL_OUT = ("full", "both full", "all closed")
NO_ERRORS = ("full errors", "all closed", "both full")
CASES = [
    *(("list", "a reader that leaves"), ("json", "ASCII"), ("json", "all closed")),
    ("wrong", "both full"),
    *(("missing", "removed folder"), ("folder", "no folder for what is temporary")),
    *(("node", "a home that cannot be"), ("node", "full errors")),
]
WITNESS = pytest.param("list", "full", marks=pytest.mark.witness)


def ended(words: Sequence[str], shell: str, folder: Path) -> tuple[int, bytes, str]:
    """Return exit code and both outputs of Python in a shell; nothing may be left in the folder."""
    line = SHELLS[shell].format(shlex.join((sys.executable, *words)))
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.run(
        ["bash", "-c", line], cwd=folder, env=environment, capture_output=True, check=False, timeout=60
    )
    text = process.stderr.decode()
    assert "Traceback" not in text
    assert "Exception ignored" not in text
    if shell in NO_ERRORS:
        assert text == ""
    elif process.returncode:
        assert text.strip(), "no line names the problem"
    assert list(folder.iterdir()) == []
    return process.returncode, process.stdout, text


@pytest.mark.parametrize(("command", "shell"), [WITNESS, *(rest(*each) for each in CASES)])
def test_a_hostile_shell_costs_a_command_only_its_output(command: str, shell: str, tmp_path: Path) -> None:
    words, code = COMMAND_LINES[command]
    found, out, text = ended(words, shell, tmp_path)
    if shell in FULL_OUT and command not in ("missing", "folder", "node"):
        code = code or 1
    assert found == code, text
    if shell in FULL_OUT:
        assert out == b""
    elif command in ("json", "wrong") and shell != "a reader that leaves":
        assert isinstance(json.loads(out), dict)
