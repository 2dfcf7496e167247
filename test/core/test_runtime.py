# SPDX-License-Identifier: Apache-2.0
"""One charger a computer by a lock that only a living holder has, and the time limit for a process's end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from deltacharger_core import runtime

from ..marks import rest
from ..waiting import DEADLINE, host

HOLDER = """
import sys
from deltacharger_core import runtime

sys.stdin.readline()
try:
    with runtime.only_one(7, sys.argv[1]):
        print("won", flush=True)
        sys.stdin.readline()
except runtime.Taken as taken:
    print("refused:", taken.process, flush=True)
"""


class Holder:
    """A process that takes the lock of domain 7 on command, and keeps it until the next command or until killed."""

    def __init__(self, namespace: str) -> None:
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "bufsize": 1}
        self.process = subprocess.Popen((sys.executable, "-c", HOLDER, namespace), **pipes)

    def go_on(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write("\n")

    def answer(self) -> str:
        self.go_on()
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()


@pytest.fixture(autouse=True)
def private(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


@pytest.fixture
def holder() -> Iterator[Callable[[str], Holder]]:
    holders: list[Holder] = []

    def start(namespace: str) -> Holder:
        holders.append(Holder(namespace))
        return holders[-1]

    yield start
    for each in holders:
        each.process.kill()
        each.process.communicate(timeout=DEADLINE)


def test_each_domain_and_namespace_has_a_lock_that_a_killed_holder_does_not_keep(
    holder: Callable[[str], Holder],
) -> None:
    left = holder("left")
    assert left.answer() == "won"
    with pytest.raises(runtime.Taken, match=f"process {left.process.pid}"), runtime.only_one(7, "left"):
        pass
    with runtime.only_one(7, "/a/left"), runtime.only_one(7, ""), runtime.only_one(8, "left"):
        pass
    left.process.send_signal(signal.SIGKILL)
    left.process.wait(DEADLINE)
    file = next(path for path in runtime.folder().glob("*.lock") if path.read_text() == f"{left.process.pid}\n")
    with runtime.only_one(7, "left"):
        assert file.read_text() == f"{os.getpid()}\n"
        assert holder("left").answer() == f"refused: {os.getpid()}"
    second = holder("left")
    assert second.answer() == "won"
    second.go_on()
    assert second.process.wait(DEADLINE) == 0
    with runtime.only_one(7, "left"):
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
