# SPDX-License-Identifier: Apache-2.0
"""What load beside a charger is safe: how often held charging ends for it, by the priority of what must be in time.

Every node of the simulated scene and the emulated hardware are processes of their own. The charger docks and charges
beside 0, 1, 2 and 4 processes that spin at ordinary priority. Counted are the ends of charging that nobody asked for,
five at most beside each load, and the longest gap between two heartbeats at the board, which opens after 100 ms.

- ordinary: everything at ordinary priority (tactile_node's heartbeat_priority is 0);
- heartbeat: as installed, the thread of the heartbeat runs with SCHED_FIFO;
- processes: all of servo_node, tactile_node, misalignment_node and docking_node does, as with `chrt -f 1` before them.

Leave the computer alone meanwhile: other programs are load, too. It takes about 6 minutes, more where charging ends.
The bytes of the emulated hardware are moved by threads of the kernel at ordinary priority, which nodes of real-time
priority can starve; a real port is served by interrupts.

python benchmarks/heartbeat_load.py [--seconds 20] [--json]
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import driver_long
import driver_processes as processes
import numpy as np
from driver_processes import CannotMeasure, Figure

LOADS = (0, 1, 2, 4)  # busy processes
SETTINGS = ("ordinary", "heartbeat", "processes")
IN_TIME = ("servo_node", "tactile_node", "misalignment_node", "docking_node")
LOOK = 0.1  # s between two looks at the contactor
ENDS_MAX = 5  # after which a load is known to be too much


@contextlib.contextmanager
def charger(setting: str) -> Iterator[tuple[processes.Role, driver_long.Listener]]:
    """Run a charger of its own, docked and charging."""
    import rclpy

    from deltacharger_scenes.scene import load_scene

    scene = load_scene("simulated")
    board = {**scene.parameters.get("tactile_node", {}), "heartbeat_priority": int(setting == "heartbeat")}
    scene = replace(scene, parameters={**scene.parameters, "tactile_node": board})
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(processes.folder())
        hardware = stack.enter_context(processes.Role(driver_long.__file__, "--emulate", str(folder)))
        ports = {name: str(folder / name) for name in ("servo", "board")}
        nodes = stack.enter_context(processes.nodes_of(scene, ports))
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        listener = driver_long.Listener(node := rclpy.create_node("benchmark"))
        stack.enter_context(processes.spinning(node))
        driver_long.dock(listener)
        if setting == "processes":
            prefer([nodes[name].pid for name in IN_TIME])
        yield hardware, listener


def prefer(pids: list[int]) -> None:
    """Give every thread of these processes real-time priority.

    Raises:
        CannotMeasure: that is not permitted here.
    """
    try:
        for pid in pids:
            for task in Path(f"/proc/{pid}/task").iterdir():
                os.sched_setscheduler(int(task.name), os.SCHED_FIFO, os.sched_param(1))
    except PermissionError as error:
        raise CannotMeasure("real-time priority is not permitted here (CAP_SYS_NICE, or ulimit -r)") from error


def count(hardware: processes.Role, listener: driver_long.Listener, load: int, seconds: float) -> dict[str, Any]:
    """Return what became of charging beside `load` busy processes; where it ends, the charger docks again without them.

    Raises:
        CannotMeasure: it does not come to charge, even without them.
    """
    spans, reasons, charged = [], [], 0.0
    while charged < seconds and len(reasons) < ENDS_MAX:
        if not hardware.ask("look")["closed"]:
            driver_long.dock(listener)
        with contextlib.ExitStack() as stack:
            for _ in range(load):
                stack.enter_context(processes.busy())
            began = time.monotonic()
            while (closed := hardware.ask("look")["closed"]) and charged + time.monotonic() - began < seconds:
                time.sleep(LOOK)
            ended = time.monotonic()
        charged += ended - began
        spans.append((began, ended))
        if not closed:
            reasons.append(listener.wait_until_idle())
    at, live = np.array(hardware.ask("record")["beats"]).reshape(-1, 2).T
    gaps = np.diff(at)[
        (live[1:] > 0.0) & (live[:-1] > 0.0) & np.any([(at[1:] > a) & (at[1:] < b) for a, b in spans], 0)
    ]
    return {
        "ends": len(reasons),
        "reasons": reasons,
        "charged": charged,
        "gap": 1e3 * float(gaps.max(initial=0.0)),
        "gap99": 1e3 * float(np.percentile(gaps, 99.0)) if gaps.size else float("nan"),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, help="of charging beside each load")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    arguments = parser.parse_args()
    figures: list[Figure] = []
    results: dict[str, Any] = {}
    for setting in SETTINGS:
        try:
            with charger(setting) as (hardware, listener):
                for load in LOADS:
                    found = results[f"{setting} {load}"] = count(hardware, listener, load, arguments.seconds)
                    what = f"{setting}, {load} busy: "
                    figures += [
                        Figure(f"{what}charging ended in {found['charged']:.0f} s", found["ends"], "times"),
                        Figure(f"{what}gap between heartbeats, 99 %", found["gap99"], "ms"),
                        Figure(f"{what}gap between heartbeats, longest", found["gap"], "ms"),
                    ]
                    processes.progress(f"{what}{found}, load {os.getloadavg()[0]:.1f}")
        except CannotMeasure as error:
            processes.progress(f"{setting}: nothing measured: {error}")
    processes.tell(figures, arguments.json, results=results, cores=os.cpu_count(), load=os.getloadavg()[0])
    return 0 if figures else 1


if __name__ == "__main__":
    sys.exit(main())
