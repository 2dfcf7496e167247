# SPDX-License-Identifier: Apache-2.0
"""`make dock` on a bare machine: each thing that building lacks is one line that says what to install or to do."""

from __future__ import annotations

import ast
import importlib.util
import shutil
import subprocess
import sys
import sysconfig
from collections import namedtuple
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
FILE = ROOT / "cmake" / "build_venv.py"
Usage = namedtuple("Usage", "total used free")


@pytest.fixture
def builder() -> Any:
    spec = importlib.util.spec_from_file_location("build_venv", FILE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_nothing_is_missing_here(builder: Any) -> None:
    assert list(builder.missing(".")) == []


def test_an_old_python_reads_the_file_and_is_refused(builder: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    ast.parse(FILE.read_text(encoding="utf-8"), feature_version=(3, 6))
    monkeypatch.setattr(sys, "version_info", (3, 8, 10))
    assert list(builder.missing(".")) == ["Python is 3.8; 3.10 or newer is needed, first in PATH as python3"]


def test_all_that_is_missing_is_named_at_once(builder: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(sysconfig, "get_paths", lambda: {"include": "/nowhere"})
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: Usage(2**30, 2**30, 2**20))
    lines = list(builder.missing("."))
    for line, remedy in zip(lines, ("-venv", "-dev", "apt install g++", "1500 MiB are needed"), strict=True):
        assert remedy in line
        assert "\n" not in line


@pytest.mark.parametrize(
    ("printed", "remedy"),
    [
        ("OSError: [Errno 28] No space left on device", "free about"),
        ("WARNING: Retrying (...) NewConnectionError(...)\nERROR: No matching distribution", "connect to the network"),
        ("ERROR: Could not find a version that satisfies the requirement cmake", "connect to the network"),
        ("fatal error: Python.h: No such file or directory", "python3-dev"),
        ("CMake Error: No CMAKE_CXX_COMPILER could be found.", "apt install g++"),
        ("lines\nERROR: something else", "something else"),
        ("lines\ndeltacharger: the ROS build tools are missing", "ROS build tools"),
        ("", "printed nothing"),
    ],
)
def test_what_a_failed_step_printed_becomes_one_line(builder: Any, printed: str, remedy: str) -> None:
    line = builder.cause(printed)
    assert remedy in line
    assert "\n" not in line


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
