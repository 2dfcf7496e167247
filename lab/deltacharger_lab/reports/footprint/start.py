# SPDX-License-Identifier: Apache-2.0
"""Starts a scene as users do, in its own processes, and ends it."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from deltacharger_lab.reports.footprint.process import LIBRARIES
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.scene import Scene

ONE, SEPARATE = "one process", "separate processes"
WAYS = (ONE, SEPARATE)
_PORTS_WITHIN = 30.0  # s until emulated hardware has its ports
_END_WITHIN = 15.0  # s that a process may take to reach a safe state
_HARDWARE = "simulated hardware"
COMMAND = "deltacharger up"

# A process writes at its end the names of all imported modules.
_LIST_MODULES = "import atexit, sys; atexit.register(lambda: open({file!r}, 'w').write('\\n'.join(sys.modules)))\n"
_CLI = "from deltacharger_bringup.cli.main import main; sys.exit(main())"
_NODE = "from {module} import main; sys.exit(main())"


class CannotRun(Exception):
    """A scene does not run here; the message states why."""


@dataclass
class Started:
    """A scene's processes.

    Attributes:
        began: start of the first, s, monotonic.
        processes: by name, in the order of starting.
        modules: names of all imported modules; known after their end.
        folder: with their output.
    """

    folder: Path
    began: float = 0.0
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    modules: set[str] = field(default_factory=set)

    @property
    def pids(self) -> list[int]:
        """The process ids."""
        return [process.pid for process in self.processes.values()]

    def start(self, name: str, code: str, *words: str) -> None:
        """Start a process that runs `code` with a command line."""
        code = _LIST_MODULES.format(file=str(self._modules_file(name))) + code
        with (self.folder / f"{name}.log").open("wb") as log:
            command = [sys.executable, "-c", code, *words]
            self.processes[name] = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)

    def check(self) -> None:
        """Raise CannotRun if a process has ended."""
        for name, process in self.processes.items():
            if process.poll() is not None:
                raise CannotRun(f"{name} ended with {process.returncode}: {self.last_line(name)}")

    def last_line(self, name: str) -> str:
        """Return the last line that a process wrote, with paths relative to its folder: pages quote it."""
        last = next((line for line in reversed(self.lines(name)) if line), "it printed nothing")
        return last.replace(f"{self.folder}/", "")

    def is_ready(self, name: str) -> bool:
        """Return whether a process has printed that it is ready."""
        return "ready" in self.lines(name)

    def end(self) -> None:
        """End all, commanding processes first, and read their modules."""
        for name, process in reversed(self.processes.items()):
            if process.poll() is None:
                process.terminate()
                try:
                    process.wait(_END_WITHIN)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
            with contextlib.suppress(OSError):  # a killed process writes nothing
                self.modules |= set(self._modules_file(name).read_text("utf-8").split("\n"))

    @property
    def libraries(self) -> set[str]:
        """Heavy libraries among the modules."""
        return {module.partition(".")[0] for module in self.modules} & set(LIBRARIES)

    def lines(self, name: str) -> list[str]:
        """Return the lines that a process wrote."""
        text = (self.folder / f"{name}.log").read_text("utf-8", "replace")
        return [line.strip() for line in text.split("\n")]

    def _modules_file(self, name: str) -> Path:
        return self.folder / f"{name}.modules"


@contextlib.contextmanager
def hardware(scene: Scene, folder: Path) -> Iterator[dict[str, str]]:
    """Serve emulated hardware for a scene on separate ports, and return them; the scene's figures exclude it.

    Raises:
        CannotRun: it does not start.
    """
    with _processes(folder) as started:
        yield _simulate(started, "simulated", folder)


@contextlib.contextmanager
def _processes(folder: Path) -> Iterator[Started]:
    """Yield processes that log into a folder, created here; they end with the context."""
    folder.mkdir()
    started = Started(folder, began=time.monotonic())
    try:
        yield started
    finally:
        started.end()


def _simulate(started: Started, scene: str, folder: Path) -> dict[str, str]:
    """Start `deltacharger simulate`, wait for its ports, and return them as it prints them."""
    started.start(_HARDWARE, _CLI, "simulate", "--scene", scene, "--directory", str(folder))
    deadline = time.monotonic() + _PORTS_WITHIN
    while not started.is_ready(_HARDWARE):
        started.check()
        if time.monotonic() > deadline:
            raise CannotRun(f"no emulated ports within {_PORTS_WITHIN:.0f} s")
        time.sleep(0.01)
    printed = dict(line.split(" ", 1) for line in started.lines(_HARDWARE) if " " in line)
    return {name: printed[name] for name in ("servo", "board")}


@contextlib.contextmanager
def charger(scene: Scene, way: str, ports: dict[str, str], folder: Path) -> Iterator[Started]:
    """Start a scene.

    Args:
        scene: to start.
        way: `ONE`, by `deltacharger up`, or `SEPARATE`, each node and the simulated hardware, as launch does.
        ports: emulated ones of a scene on hardware; empty for another.
        folder: for logs, created here.

    Raises:
        CannotRun: it does not start.
    """
    with _processes(folder) as started:
        if way == ONE:
            used = sorted({NODES[name].port for name in scene.nodes} & set(ports))
            words = [word for name in used for word in (f"--{name}-port", ports[name])]
            started.start(COMMAND, _CLI, "up", "--scene", scene.file, *words)
        else:
            _start_nodes(started, scene, ports)
        yield started


def _start_nodes(started: Started, scene: Scene, ports: dict[str, str]) -> None:
    if scene.simulation is not None:
        ports = _simulate(started, scene.file, started.folder)
    for name in scene.start_order():
        file = started.folder / f"{name}.yaml"
        file.write_text(json.dumps({"/**": {"ros__parameters": scene.node_parameters(name, ports)}}), "utf-8")
        words = ("--ros-args", "--params-file", str(file)) if scene.node_parameters(name, ports) else ()
        started.start(name, _NODE.format(module=NODES[name].module), *words)
