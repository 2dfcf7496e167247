# SPDX-License-Identifier: Apache-2.0
"""Chargers of mocks, fast enough for tests, each in its own namespace and only on this computer."""

import contextlib
import functools
import itertools
import os
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from deltacharger_bringup.scenes.scene import Scene, load_scene
from deltacharger_core import environment
from deltacharger_core.machine import LONGEST_LEASE

from .waiting import DEADLINE, host, wait_until
from .workers import stay_apart

stay_apart()
environment.prepare()

ENDS = 100.0  # s for a program to end: on a busy computer a command's pictures take more than a minute
_numbers = itertools.count()
Spin = Callable[[Any], Any]


def hear_hangups() -> None:
    """Enable SIGHUP in a child, because nohup may have started these tests."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


class Process:
    """A program under test, with its output read continuously."""

    def __init__(self, *words: str, stdin: int | None = None) -> None:
        self.process = subprocess.Popen(
            words,
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=hear_hangups,
            env={**os.environ, "PYTHONFAULTHANDLER": "1"},
        )
        self.out: list[str] = []
        self.err: list[str] = []
        self._readers = [
            threading.Thread(target=self._read, args=(stream, lines), daemon=True)
            for stream, lines in ((self.process.stdout, self.out), (self.process.stderr, self.err))
        ]
        for reader in self._readers:
            reader.start()

    def _read(self, stream: Any, lines: list[str]) -> None:
        for line in stream:
            lines.append(line.rstrip("\n"))

    def wait_for_line(self, text: str, lines: list[str]) -> None:
        self.wait_until(lambda: any(text in line for line in list(lines)), f"'{text}'")

    def wait_until(self, condition: Callable[[], object], what: str) -> None:
        """Wait for what the program is to do; fail at once if it has ended, and tell its output in any case."""
        try:
            wait_until(lambda: condition() or self.process.poll() is not None, what)
        except AssertionError as error:
            self._abort()
            raise AssertionError(f"{error}\n{self}") from None
        if not condition():
            self._read_all()
            assert condition(), f"ended with {self.process.poll()} before: {what}\n{self}"

    def end(self, number: int | None = None) -> int:
        """Send a signal and return the exit code; a hanging process prints its stack to standard error."""
        if number is not None:
            self.process.send_signal(number)
        try:
            code = self.process.wait(ENDS)
        except subprocess.TimeoutExpired:
            self._abort()
            raise AssertionError(f"waited {ENDS:g} s for its end\n{self}") from None
        self._read_all()
        return code

    def __str__(self) -> str:
        """Return the command line and all output."""
        return "\n".join((shlex.join(self.process.args), *self.out, *self.err))

    def _abort(self) -> None:
        """End the program; Python prints the stack of each thread."""
        self.process.send_signal(signal.SIGABRT)
        self.process.wait(DEADLINE)
        self._read_all()

    def _read_all(self) -> None:
        for reader in self._readers:
            reader.join(DEADLINE)


@pytest.fixture
def start() -> Iterator[Callable[..., Process]]:
    """Start programs; at the end of the test running ones are killed."""
    running: list[Process] = []

    def run(*words: str) -> Process:
        running.append(Process(*words))
        return running[-1]

    yield run
    for each in running:
        if each.process.poll() is None:
            each.process.kill()
            each.process.wait(DEADLINE)


@pytest.fixture
def deltacharger() -> tuple[str, ...]:
    """The command, run from the code under test."""
    return (sys.executable, "-m", "deltacharger_bringup.cli")


@pytest.fixture(scope="session")
def quick_file() -> Path:
    return Path(__file__).parent / "scenes" / "quick.yaml"


@pytest.fixture(scope="session")
def quick_scene(quick_file: Path) -> Scene:
    return load_scene(quick_file)


def new_namespace() -> str:
    """Return a unique namespace."""
    return f"test_{os.getpid()}_{next(_numbers)}"


@pytest.fixture
def namespace() -> str:
    return new_namespace()


@pytest.fixture(scope="module")
def context() -> Iterator[Any]:
    import rclpy
    from rclpy.context import Context
    from rclpy.signals import SignalHandlerOptions

    context = Context()
    rclpy.init(context=context, args=[], signal_handler_options=SignalHandlerOptions.NO)
    yield context
    rclpy.try_shutdown(context=context)


@functools.cache
def _limits() -> tuple[tuple[Any, str, float], ...]:
    from deltacharger_driver.board import contactor
    from deltacharger_sim.emulators import power, servo

    every = (
        (contactor, "STALE_FRAME"),
        (contactor, "LONGEST_LEASE"),
        (power, "HEARTBEAT_LIMIT"),
        (servo, "WATCHDOG_UNIT"),
    )
    return tuple((module, name, getattr(module, name)) for module, name in every)


@contextlib.contextmanager
def patience(*holders: ModuleType) -> Iterator[None]:
    """Widen, by the host's option, the times within which this process's nodes and emulators must hear its threads.

    Needs no ROS.

    Args:
        holders: modules that request the longest lease.
    """
    with pytest.MonkeyPatch.context() as patch:
        for module, name, seconds in (*_limits(), *((each, "LONGEST_LEASE", LONGEST_LEASE) for each in holders)):
            patch.setattr(module, name, host(seconds))
        yield


@pytest.fixture
def spin() -> Iterator[Spin]:
    """Serve nodes until the test ends; the last is closed first. Returns the given node."""
    from deltacharger_core.ros.executor import Spinner

    running: list[Spinner] = []

    def serve(node: Any) -> Any:
        running.append(Spinner(node))
        return node

    yield serve
    for spinner in reversed(running):
        spinner.close()
