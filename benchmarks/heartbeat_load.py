# SPDX-License-Identifier: Apache-2.0
"""Robustness of the heartbeat against load: how often charging ends beside busy processes, by processes and priority.

The emulated hardware is a separate process with real-time priority, because a real board is not on this computer.
Beside it run the nodes of the simulated scene, charging, and 0, 1, 2 or 4 processes that spin at ordinary priority.

- process: all nodes in one, as with `deltacharger up`; processes: one per node, as with `ros2 launch`.
- ordinary: all at ordinary priority; heartbeat: as installed, only the heartbeat's thread has SCHED_FIFO; real time:
  all threads of the nodes have it, as with `chrt -f 1`.

It counts unrequested ends of charging; the charger then docks again without load. Each end has a cause: own = the
emulated hardware was late (its board, or a byte in a pseudo-terminal); lease = the lease was not renewed in time;
host = the heartbeat. Late is 20 ms, which is not rare under load: an end counted as own may have another cause.
Unsafe is a contactor that opens more than 100 ms after the last heartbeat although the emulated board was on time.

Run no other programs during the measurement: they are load. All cells take 4 hours with --seconds 600; choose some.

python benchmarks/heartbeat_load.py [--nodes processes] [--priority "real time"] [--loads 4] [--seconds 600] [--json]
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import driver_long
import driver_processes as processes
import numpy as np
from driver_processes import CannotMeasure, Figure

NODES = ("process", "processes")
PRIORITIES = ("ordinary", "heartbeat", "real time")
LOADS = (0, 1, 2, 4)  # busy processes
PERIOD = 0.1  # s between two checks of the contactor
LIMIT = 0.1  # s after the last heartbeat within which the board must open
LATE_BOARD = 0.02  # s; a real board polls more often, so a longer delay is caused by the emulator
STALE = 0.2  # s before the last heartbeat within which a late frame may have ended the lease
SETTLE = 1.2  # s until diagnostics report an end


@dataclass
class Cell:
    """Result of charging beside one load."""

    ends: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("own", "lease", "host"), 0))
    unsafe: int = 0
    charged: float = 0.0  # s
    gap: float = 0.0  # s, the longest between two heartbeats at the board while it was live
    reasons: list[str] = field(default_factory=list)


@contextlib.contextmanager
def charger(nodes: str, priority: str) -> Iterator[tuple[processes.Role, driver_long.Listener]]:
    """Run a charger, docked and charging."""
    import rclpy

    from deltacharger_scenes.scene import load_scene

    scene = load_scene("simulated")
    board = {**scene.parameters.get("tactile_node", {}), "heartbeat_priority": int(priority == "heartbeat")}
    scene = replace(scene, parameters={**scene.parameters, "tactile_node": board})
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(processes.folder())
        hardware = stack.enter_context(processes.Role(driver_long.__file__, "--emulate", str(folder)))
        ports = {name: str(folder / name) for name in ("servo", "board")}
        start = one_process if nodes == "process" else own_processes
        pids = stack.enter_context(start(scene, ports))
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        listener = driver_long.Listener(node := rclpy.create_node("benchmark"))
        stack.enter_context(processes.spinning(node))
        driver_long.dock(listener)
        if priority == "real time":
            prefer(pids)
        yield hardware, listener


@contextlib.contextmanager
def own_processes(scene: Any, ports: dict[str, str]) -> Iterator[list[int]]:
    with processes.nodes_of(scene, ports) as nodes:
        yield [node.pid for node in nodes.values()]


@contextlib.contextmanager
def one_process(scene: Any, ports: dict[str, str]) -> Iterator[list[int]]:
    """Run the scene's nodes by `deltacharger up`, on given ports as on a robot."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "charger.yaml"
        priority = scene.parameters["tactile_node"]["heartbeat_priority"]
        file.write_text(
            f"name: charger\nports: {{servo: {ports['servo']}, board: {ports['board']}}}\n"
            f"parameters: {{tactile_node: {{heartbeat_priority: {priority}}}}}\n"
        )
        command = [sys.executable, "-m", "deltacharger_bringup.cli", "up", "--scene", str(file)]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        try:
            yield [process.pid]
        finally:
            processes.end(process)


def prefer(pids: list[int]) -> None:
    """Give every thread of these processes real-time priority.

    Raises:
        CannotMeasure: it is not permitted.
    """
    try:
        for pid in pids:
            for task in Path(f"/proc/{pid}/task").iterdir():
                os.sched_setscheduler(int(task.name), os.SCHED_FIFO, os.sched_param(1))
    except PermissionError as error:
        raise CannotMeasure("real-time priority is not permitted here (CAP_SYS_NICE, or ulimit -r)") from error


def measure(hardware: processes.Role, listener: driver_long.Listener, load: int, seconds: float) -> Cell:
    """Charge beside `load` busy processes for `seconds`, and return the result.

    Raises:
        CannotMeasure: it does not charge, even without them.
    """
    cell, spans = Cell(), []
    while cell.charged < seconds:
        if not hardware.ask("look")["closed"]:
            driver_long.dock(listener)
        lapses = listener.counter("power stage", "lease_lapses")
        with contextlib.ExitStack() as stack:
            for _ in range(load):
                stack.enter_context(processes.busy())
            began = time.monotonic()
            while (closed := hardware.ask("look")["closed"]) and cell.charged + time.monotonic() - began < seconds:
                time.sleep(PERIOD)
            ended = time.monotonic()
        cell.charged += ended - began
        spans.append((began, ended))
        if not closed:
            time.sleep(SETTLE)
            cell.reasons.append(listener.wait_until_idle())
            lapsed = listener.counter("power stage", "lease_lapses") > lapses
            judge(cell, hardware.ask("record"), (began, ended), lapsed)
            processes.progress(f"  after {cell.charged:.0f} s: {cell.reasons[-1]}; {cell.ends}")
    at, live = np.array(hardware.ask("record")["beats"]).reshape(-1, 2).T
    inside = np.any([(at[1:] > began) & (at[1:] < ended) for began, ended in spans], 0)
    gaps = np.diff(at)[(live[1:] > 0.0) & (live[:-1] > 0.0) & inside]
    cell.gap = float(gaps.max(initial=0.0))
    return cell


def judge(cell: Cell, record: dict[str, Any], span: tuple[float, float], lapsed: bool) -> None:
    """Count the cause of the end of a span, and whether the board kept its limit."""
    at, live = np.array(record["beats"]).reshape(-1, 2).T
    _, due, taken = np.array(record["samples"]).reshape(-1, 3).T
    last = at[(live > 0.0) & (at < span[1])].max(initial=span[0])
    came, line = np.array(record["line"]).reshape(-1, 2).T
    board = _worst(taken, taken - due, last, span[1])
    late = max(board, _worst(came, line, last, span[1]))
    cell.ends["own" if late > LATE_BOARD else "lease" if lapsed else "host"] += 1
    opened = [each for each in record["openings"] if each >= last]
    cell.unsafe += bool(opened) and bool(opened[0] - last > LIMIT) and board <= LATE_BOARD


def _worst(at: np.ndarray, late: np.ndarray, last: float, end: float) -> float:
    return float(late[(at > last - STALE) & (at < end)].max(initial=0.0))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nodes", choices=NODES, nargs="+", default=NODES)
    parser.add_argument("--priority", choices=PRIORITIES, nargs="+", default=PRIORITIES)
    parser.add_argument("--loads", type=int, nargs="+", default=LOADS)
    parser.add_argument("--seconds", type=float, default=20.0, help="time of charging beside each load")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    arguments = parser.parse_args()
    figures: list[Figure] = []
    results: dict[str, Any] = {}
    for nodes in arguments.nodes:
        for priority in arguments.priority:
            try:
                with charger(nodes, priority) as (hardware, listener):
                    for load in arguments.loads:
                        cell = measure(hardware, listener, load, arguments.seconds)
                        what = f"{nodes}, {priority}, {load} busy: "
                        results[what] = vars(cell)
                        ends = ", ".join(f"{count} {cause}" for cause, count in cell.ends.items() if count)
                        figures += [
                            Figure(f"{what}ends{f' ({ends})' if ends else ''}", sum(cell.ends.values()), ""),
                            Figure(f"{what}unsafe", cell.unsafe, f"in {cell.charged:.0f} s"),
                            Figure(f"{what}longest gap", 1e3 * cell.gap, "ms"),
                        ]
                        processes.progress(f"{what}{vars(cell)}, load {os.getloadavg()[0]:.1f}")
            except CannotMeasure as error:
                processes.progress(f"{nodes}, {priority}: nothing measured: {error}")
    processes.print_figures(figures, arguments.json, results=results, cores=os.cpu_count(), load=os.getloadavg()[0])
    return 0 if figures else 1


if __name__ == "__main__":
    sys.exit(main())
