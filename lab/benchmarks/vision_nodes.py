# SPDX-License-Identifier: Apache-2.0
"""CPU time and latency of electrode_detector_node and simulated_camera_node, each in a separate process.

Three phases: at rest without requests, repeated calls of detect_electrodes, detection at 10 Hz.

python lab/benchmarks/vision_nodes.py [--requests 50] [--seconds 10] [--json]
"""

from __future__ import annotations

import argparse
import contextlib
import time
from pathlib import Path
from typing import Any

import driver_processes as processes
import numpy as np
from driver_processes import CannotMeasure, CpuMeter, Figure, at_most

from deltacharger_core import environment

environment.prepare()
environment.isolate()

RATE = 10.0  # Hz
NODES = ("electrode_detector_node", "simulated_camera_node")
ANSWER = 20.0  # s


def resident(pid: int) -> float:
    """Return the memory of a process, MB."""
    line = next(line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024.0


def ask(node: Any, client: Any, times: int) -> list[float]:
    """Return the time of each of `times` requests, ms; between them the camera pauses."""
    import rclpy
    from deltacharger.srv import DetectElectrodes

    took = []
    for _ in range(times):
        started = time.perf_counter()
        future = client.call_async(DetectElectrodes.Request())
        rclpy.spin_until_future_complete(node, future, timeout_sec=ANSWER)
        answer = future.result()
        if answer is None or not answer.success:
            raise CannotMeasure("no answer" if answer is None else answer.message)
        took.append(1e3 * (time.perf_counter() - started))
        time.sleep(0.1)
    return took


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--requests", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    import rclpy
    from deltacharger.msg import ElectrodeDetection
    from deltacharger.srv import DetectElectrodes

    rclpy.init()
    node = rclpy.create_node("asker")
    client = node.create_client(DetectElectrodes, "detect_electrodes")
    figures: list[Figure] = []
    with contextlib.ExitStack() as stack:
        pids = {}
        for name in NODES:
            process = processes.start_node(name, {"rate": RATE if name.startswith("electrode") else 30.0})
            stack.callback(processes.end, process)
            pids[name] = process.pid
        if not client.wait_for_service(processes.PATIENCE):
            raise CannotMeasure("electrode_detector_node did not start")
        ask(node, client, 3)
        processes.progress(f"at rest, {options.seconds:g} s")
        meter = CpuMeter(pids)
        time.sleep(options.seconds)
        figures += [at_most(f"{name} at rest", used, "% of a core", 2.0) for name, used in meter.percent().items()]
        processes.progress(f"{options.requests} requests")
        took = ask(node, client, options.requests)
        figures.append(Figure("detect_electrodes, median", float(np.median(took)), "ms"))
        figures.append(Figure("detect_electrodes, 95 %", float(np.percentile(took, 95)), "ms"))
        processes.progress(f"at {RATE:g} Hz, {options.seconds:g} s")
        seen: list[Any] = []
        node.create_subscription(ElectrodeDetection, "electrode_detection", seen.append, 10)
        _spin(node, 2.0)
        seen.clear()
        meter = CpuMeter(pids)
        _spin(node, options.seconds)
        used = meter.percent()
        figures += [Figure(f"{name} at {RATE:g} Hz", used[name], "% of a core") for name in NODES]
        figures.append(Figure("detections", len(seen) / options.seconds, "Hz"))
        figures += [Figure(f"{name}", resident(pids[name]), "MB") for name in NODES]
    processes.print_figures(figures, options.json)
    rclpy.try_shutdown()
    return 0 if all(figure.met is not False for figure in figures) else 1


def _spin(node: Any, seconds: float) -> None:
    import rclpy

    end = time.monotonic() + seconds
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.05)


if __name__ == "__main__":
    raise SystemExit(main())
