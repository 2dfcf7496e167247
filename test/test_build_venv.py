# SPDX-License-Identifier: Apache-2.0
"""`make dock` on a bare machine: each thing that building lacks is one line that says what to install or to do."""

from __future__ import annotations

import ast
import importlib.util
import shutil
import sys
import sysconfig
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

FILE = Path(__file__).parents[1] / "cmake" / "build_venv.py"


@pytest.fixture
def builder(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(FILE.parent)
    return importlib.import_module("build_venv")


def test_what_is_missing_is_named_at_once_in_one_line_each(builder: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    assert list(builder.missing(".")) == []
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(sysconfig, "get_paths", lambda: {"include": "/nowhere"})
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=2**20))
    for line, remedy in zip(builder.missing("."), ("-venv", "-dev", "apt install g++", "MiB"), strict=True):
        assert remedy in line
        assert "\n" not in line
    ast.parse(FILE.read_text(encoding="utf-8"), feature_version=(3, 6))  # an old Python reads the file
    monkeypatch.setattr(sys, "version_info", (3, 8, 10))
    (line,) = builder.missing(".")
    assert "3.10" in line


@pytest.mark.parametrize(
    ("printed", "remedy"),
    [
        ("OSError: [Errno 28] No space left on device", "free about"),
        ("ERROR: Could not find a version that satisfies the requirement cmake", "connect to the network"),
        ("CMake Error: No CMAKE_CXX_COMPILER could be found.", "apt install g++"),
        ("lines\ndeltacharger: the ROS build tools are missing", "ROS build tools"),
        ("", "printed nothing"),
    ],
)
def test_what_a_failed_step_printed_becomes_one_line(builder: Any, printed: str, remedy: str) -> None:
    line = builder.cause(printed)
    assert remedy in line
    assert "\n" not in line
