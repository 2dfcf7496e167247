# SPDX-License-Identifier: Apache-2.0
"""The lock that allows one charger: only a living holder counts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from deltacharger_core import runtime

from ..chargers import DEADLINE, wait_until

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
        self.process = subprocess.Popen(
            (sys.executable, "-c", HOLDER, namespace), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def go_on(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()

    def answer(self) -> str:
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


def test_exactly_one_of_simultaneous_processes_gets_the_lock(holder: Callable[[str], Holder]) -> None:
    asking = [holder("left") for _ in range(6)]
    for each in asking:
        each.go_on()
    answers = [each.answer() for each in asking]
    winner = asking[answers.index("won")]
    assert answers.count("won") == 1
    assert set(answers) <= {"won", f"refused: {winner.process.pid}", "refused:"}  # it may not have written its id yet


def test_each_domain_and_namespace_has_its_own_lock(holder: Callable[[str], Holder]) -> None:
    left = holder("left")
    left.go_on()
    assert left.answer() == "won"
    with pytest.raises(runtime.Taken, match=f"process {left.process.pid}"), runtime.only_one(7, "left"):
        pass
    with runtime.only_one(7, "/a/left"), runtime.only_one(7, ""), runtime.only_one(8, "left"):
        pass


def test_the_file_of_a_killed_holder_blocks_no_process(holder: Callable[[str], Holder]) -> None:
    killed = holder("left")
    killed.go_on()
    assert killed.answer() == "won"
    killed.process.send_signal(signal.SIGKILL)
    killed.process.wait(DEADLINE)
    [file] = runtime.folder().glob("*.lock")
    assert file.read_text() == f"{killed.process.pid}\n"
    with runtime.only_one(7, "left"):
        assert file.read_text() == f"{os.getpid()}\n"


def test_another_process_can_take_a_released_lock(holder: Callable[[str], Holder]) -> None:
    with runtime.only_one(7, ""):
        refused = holder("")
        refused.go_on()
        assert refused.answer() == f"refused: {os.getpid()}"
    second = holder("")
    second.go_on()
    assert second.answer() == "won"
    second.go_on()
    wait_until(lambda: second.process.poll() is not None, "its end")
    with runtime.only_one(7, ""):
        pass


def test_the_folder_is_private_and_another_users_folder_is_refused(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    runtime.folder().symlink_to(elsewhere)
    with pytest.raises(PermissionError, match="not a folder of this user"), runtime.only_one(7, ""):
        pass
    runtime.folder().unlink()
    with runtime.only_one(7, ""):
        assert runtime.folder().stat().st_mode & 0o077 == 0


def test_without_a_usable_runtime_folder_it_is_below_tmp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert runtime.folder().parent == tmp_path
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "missing"))
    assert runtime.folder().parent == Path("/tmp")
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert runtime.folder().parent == Path("/tmp")
