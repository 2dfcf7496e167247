# SPDX-License-Identifier: Apache-2.0
"""One charger a computer by a lock that only a living holder has, and the time limit for a process's end."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from deltacharger_core import runtime

from ..marks import rest
from ..waiting import host


@pytest.fixture(autouse=True)
def private(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def test_each_domain_and_namespace_has_a_lock_of_its_own() -> None:
    """The kernel releases it however its holder ends; the file stays and means nothing."""
    for _ in range(2):
        with runtime.only_one(7, "left"):
            with pytest.raises(runtime.Taken, match=f"process {os.getpid()}"), runtime.only_one(7, "left"):
                pass
            with runtime.only_one(7, "/a/left"), runtime.only_one(7, ""), runtime.only_one(8, "left"):
                pass


def test_the_folder_is_private_and_another_users_folder_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert runtime.folder().parent == tmp_path
    runtime.folder().symlink_to(tmp_path)
    with pytest.raises(PermissionError, match="not a folder of this user"), runtime.only_one(7, ""):
        pass
    runtime.folder().unlink()
    with runtime.only_one(7, ""):
        assert runtime.folder().stat().st_mode & 0o077 == 0
    for unusable in ("missing", ""):
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / unusable) if unusable else "")
        assert runtime.folder().parent == Path("/tmp")


HANGS = "import ctypes; ctypes.PyDLL(None).pause()"  # blocks for ever with Python's lock


def ended(limit: float, code: int, then: str) -> int:
    program = f"from deltacharger_core.real_time import exit_within; exit_within({limit}, {code}); {then}"
    return subprocess.run([sys.executable, "-c", program], timeout=host(5.0), check=False).returncode


@pytest.mark.parametrize(("limit", "code"), [(0.2, 0), rest(1.2, 7)])
def test_a_process_that_hangs_ends_within_its_limit(limit: float, code: int) -> None:
    assert ended(limit, code, HANGS) == code


def test_a_process_that_ends_in_time_keeps_its_exit_code() -> None:
    assert ended(30.0, 0, "raise SystemExit(3)") == 3
