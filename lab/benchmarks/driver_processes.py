# SPDX-License-Identifier: Apache-2.0
"""Common to the driver's benchmarks: nodes and emulated hardware as processes, figures with targets.

Call `environment.prepare()` and `environment.isolate()` before functions that use ROS.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

PATIENCE = 60.0  # s until a charger is ready
DOCKING_LIMIT = 180.0  # s
DRIVER_LIMIT = 5.0  # % of a core that servo_node, tactile_node or their libraries may use


class CannotMeasure(Exception):
    """A failure outside of the measurement."""


@dataclass(frozen=True)
class Figure:
    """A measured value, its target, and whether it is met; `met` is None without a target."""

    what: str
    value: float
    unit: str
    target: str = ""
    met: bool | None = None

    def __str__(self) -> str:
        verdict = "" if self.met is None else "met" if self.met else "NOT MET"
        number = f"{self.value:.0f}" if float(self.value).is_integer() else f"{self.value:.4g}"
        return f"{self.what:<68}{number:>9} {self.unit:<14}{self.target:<18}{verdict}".rstrip()


def at_most(what: str, value: float, unit: str, limit: float) -> Figure:
    """Return a figure that must not exceed `limit`; NaN does not meet it."""
    return Figure(what, value, unit, f"≤ {limit:g} {unit}", bool(value <= limit))


def print_figures(figures: Sequence[Figure], as_json: bool, **more: Any) -> None:
    """Print the figures as a table, or with `more` as one JSON object."""
    if as_json:
        rows = [{key: _finite(value) for key, value in asdict(figure).items()} for figure in figures]
        print(json.dumps({**more, "figures": rows}))
    else:
        print("\n".join(str(figure) for figure in figures), flush=True)


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def progress(sentence: str) -> None:
    """Print progress on stderr."""
    print(sentence, file=sys.stderr, flush=True)


@contextlib.contextmanager
def folder() -> Iterator[Path]:
    """Yield a folder for ports; it is removed at the end."""
    path = Path(tempfile.mkdtemp(prefix="deltacharger-"))
    try:
        yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)


def cpu_seconds(pid: int) -> float:
    """CPU time of a child process so far, s.

    Raises:
        CannotMeasure: it has ended.
    """
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    if fields[0] == "Z":
        raise CannotMeasure(f"process {pid} has ended; see its message above")
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class CpuMeter:
    """CPU time of processes since its construction."""

    def __init__(self, pids: Mapping[str, int]) -> None:
        self._pids = pids
        self._began = time.monotonic()
        self._before = {name: cpu_seconds(pid) for name, pid in pids.items()}

    def percent(self) -> dict[str, float]:
        """Return % of a core by name."""
        elapsed = time.monotonic() - self._began
        return {name: 100 * (cpu_seconds(pid) - self._before[name]) / elapsed for name, pid in self._pids.items()}


class Role:
    """A process that runs a script of this folder in another role; it reads orders as lines and answers in JSON.

    Args:
        script: path of the script, which calls `serve` in that role.
        arguments: its command line.
    """

    def __init__(self, script: str, *arguments: str) -> None:
        command = [sys.executable, script, *arguments]
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        # A BLAS thread would keep ordinary priority and delay the emulated hardware.
        self._process = subprocess.Popen(command, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}, **pipes)
        self.pid = self._process.pid
        self.end()  # of its start

    def ask(self, order: str) -> Any:
        """Give an order and return the answer."""
        self.begin(order)
        return self.end()

    def begin(self, order: str) -> None:
        """Give an order whose answer `end` returns."""
        assert self._process.stdin is not None
        self._process.stdin.write(order + "\n")
        self._process.stdin.flush()

    def end(self) -> Any:
        """Return the answer to `begin`."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise CannotMeasure(f"{' '.join(map(str, self._process.args))} ended; see its message above")  # type: ignore[arg-type]
        return json.loads(line)

    def __enter__(self) -> Role:
        return self

    def __exit__(self, *exception: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(10.0)
        end(self._process)


def serve(orders: Mapping[str, Callable[[], Any]]) -> None:
    """Report that this role is ready, and execute orders until stdin ends."""
    print(json.dumps("ready"), flush=True)
    for line in sys.stdin:
        print(json.dumps(orders[line.strip()]()), flush=True)


def take_priority() -> None:
    """Give this process, which replaces hardware, priority over the nodes: a real board never waits for them.

    Call it before threads start. Without permission it prints a note: delays then count against the nodes.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))  # before nodes with real-time priority
    except OSError:
        try:
            os.setpriority(os.PRIO_PROCESS, 0, -15)
        except OSError:
            progress("the emulated hardware runs at ordinary priority (no CAP_SYS_NICE); its delays count here")


def start_node(name: str, parameters: Mapping[str, Any]) -> subprocess.Popen[bytes]:
    """Start a node in a separate process."""
    from deltacharger_bringup.scenes.node_table import NODES

    command = [
        sys.executable,
        "-c",
        f"import sys; from {NODES[name].module} import main; sys.exit(main())",
        "--ros-args",
    ]
    for key, value in parameters.items():
        command += ["-p", f"{key}:={value}"]
    return subprocess.Popen([*command, "--log-level", "fatal"])


def end(process: subprocess.Popen[Any]) -> None:
    """End a process, also a stopped one."""
    if process.poll() is None:
        process.kill()
        process.wait()


@contextlib.contextmanager
def busy(niceness: int = 0) -> Iterator[None]:
    """Keep one core busy with a process of this niceness."""
    process = subprocess.Popen(["nice", "-n", str(niceness), sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        end(process)


@contextlib.contextmanager
def nodes_of(scene: Any, ports: Mapping[str, str]) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Start every node of a scene in a separate process."""
    nodes: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for name in scene.start_order():
            nodes[name] = start_node(name, scene.node_parameters(name, ports))
        yield nodes
    finally:
        for process in reversed(nodes.values()):
            end(process)


def charge() -> None:
    """Dock and charge.

    Raises:
        CannotMeasure: no charger is ready, or it did not charge.
    """
    from deltacharger_core.ros.client import ChargerClient, ClientError
    from deltacharger_core.ros.outcomes import DockRequest, Pose

    try:
        with ChargerClient() as client:
            if not client.wait_until_ready(PATIENCE):
                raise CannotMeasure("the charger is not ready")
            outcome = client.dock(DockRequest(Pose(0.0, 0.0, 0.080)), deadline=DOCKING_LIMIT)
    except ClientError as error:
        raise CannotMeasure(str(error)) from error
    if not outcome.success:
        raise CannotMeasure(f"docking failed: {outcome.error_message}")


@contextlib.contextmanager
def spinning(node: Any) -> Iterator[None]:
    """Serve a node's callbacks from one thread."""
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)

    def spin() -> None:
        with contextlib.suppress(ExternalShutdownException):
            executor.spin()

    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    try:
        yield
    finally:
        executor.shutdown()
        thread.join()
        node.destroy_node()
