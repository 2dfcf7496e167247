# SPDX-License-Identifier: Apache-2.0
"""`make dock` on a bare machine: each thing that building lacks is one line that says what to install or to do."""

from __future__ import annotations

import ast
import importlib.util
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
FILE = ROOT / "cmake" / "build_venv.py"


@pytest.fixture
def builder() -> Any:
    spec = importlib.util.spec_from_file_location("build_venv", FILE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_what_is_missing_is_named_at_once_in_one_line_each(builder: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    assert list(builder.missing(".")) == []
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(sysconfig, "get_paths", lambda: {"include": "/nowhere"})
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=2**20))
    lines = list(builder.missing("."))
    assert not [
        line
        for line, remedy in zip(lines, ("-venv", "-dev", "apt install g++", "MiB"), strict=True)
        if remedy not in line or "\n" in line
    ]
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


@pytest.mark.night
def test_without_a_network_the_build_ends_in_one_line(tmp_path: Path) -> None:
    environment = {
        "PATH": "/usr/bin:/bin",
        "PIP_INDEX_URL": "http://127.0.0.1:9/",
        "PIP_RETRIES": "0",
        "PIP_CONFIG_FILE": "/dev/null",
    }
    words = [sys.executable, str(FILE), str(tmp_path / "venv")]
    run = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=100.0, check=False)
    assert run.returncode == 1
    assert run.stderr.startswith("cannot build: ")
    assert "connect to the network" in run.stderr
    assert run.stderr.count("\n") == 1
