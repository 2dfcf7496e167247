# SPDX-License-Identifier: Apache-2.0
"""Latency of solve_inverse_kinematics for a client: a node in a separate process, called over ROS.

    python lab/benchmarks/kinematics_service.py [--calls 500] [--batches 100] [--repeat 3] [--json]

Each call is timed from the filled request to the received answer, and compared with the library in this process. The
load of the machine is printed, too: on a busy machine the slowest calls do not show the service.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from array import array
from typing import Any

from deltacharger_core import environment

environment.prepare()
environment.isolate()

import numpy as np  # noqa: E402
import rclpy  # noqa: E402
from deltacharger.srv import SolveInverseKinematics  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402

from deltacharger_kinematics import Delta  # noqa: E402

POINTS = (1, 10_000)
TARGET = {1: 10.0, 10_000: 25.0}  # ms, p99
WARM_UP = 20  # calls without measurement
START_LIMIT = 30.0  # s


def workspace_points(count: int) -> np.ndarray:
    geometry = Delta().geometry
    return np.random.default_rng(1).uniform(geometry.workspace_min, geometry.workspace_max, (count, 3))


class Client:
    """A client and a kinematics_node in a separate process."""

    def __init__(self) -> None:
        namespace = f"/bench_{os.getpid()}"
        self._server = subprocess.Popen(
            [sys.executable, "-m", "deltacharger_kinematics.kinematics_node", "--ros-args", "-r", f"__ns:={namespace}"]
        )
        rclpy.init()
        self._node = rclpy.create_node("client", namespace=namespace)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._client = self._node.create_client(SolveInverseKinematics, "solve_inverse_kinematics")

    def __enter__(self) -> Client:
        if not self._client.wait_for_service(START_LIMIT):
            self.__exit__()
            raise TimeoutError(f"kinematics_node did not answer within {START_LIMIT:.0f} s")
        return self

    def __exit__(self, *_: object) -> None:
        self._server.terminate()
        self._server.wait(10.0)
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def call(self, points: np.ndarray) -> tuple[float, Any]:
        """Return the time of one call (s) and its answer."""
        request = SolveInverseKinematics.Request(positions=array("d", points.tobytes()))
        started = time.perf_counter()
        future = self._client.call_async(request)
        self._executor.spin_until_future_complete(future, 10.0)
        spent = time.perf_counter() - started
        answer = future.result()
        if answer is None:
            raise TimeoutError("kinematics_node did not answer within 10 s")
        return spent, answer


def measure(client: Client, count: int, calls: int) -> dict[str, float]:
    """Return the figures of `calls` calls with `count` points each, in ms."""
    points, delta = workspace_points(count), Delta()
    wanted = delta.inverse(points)
    served, library = [], []
    for number in range(calls + WARM_UP):
        spent, answer = client.call(points)
        if number == 0 and not np.array_equal(np.asarray(answer.angles).reshape(-1, 3), wanted.angles):
            raise RuntimeError("the service's angles are not the library's")
        started = time.perf_counter()
        delta.inverse(points)
        if number >= WARM_UP:
            library.append(time.perf_counter() - started)
            served.append(spent)
    middle, tail = (1000.0 * float(np.quantile(served, share)) for share in (0.5, 0.99))
    alone = 1000.0 * float(np.median(library))
    return {
        "points": count,
        "calls": calls,
        "p50_ms": middle,
        "p99_ms": tail,
        "library_p50_ms": alone,
        "ratio": middle / alone,
        "target_p99_ms": TARGET.get(count, math.nan),
        "load": os.getloadavg()[0],
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calls", type=int, default=500, help="calls with one point")
    parser.add_argument("--batches", type=int, default=100, help="calls with ten thousand points")
    parser.add_argument("--repeat", type=int, default=1, help="runs of the benchmark")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    arguments = parser.parse_args()
    calls = dict(zip(POINTS, (arguments.calls, arguments.batches), strict=True))
    with Client() as client:
        rows = [measure(client, count, calls[count]) for _ in range(arguments.repeat) for count in POINTS]
    if arguments.json:
        print(json.dumps({"rows": rows}))
        return 0
    print(f"{'points':>8}{'calls':>8}{'p50 ms':>9}{'p99 ms':>9}{'target':>8}{'library ms':>12}{'ratio':>8}{'load':>7}")
    for row in rows:
        print(
            f"{row['points']:>8.0f}{row['calls']:>8.0f}{row['p50_ms']:>9.2f}{row['p99_ms']:>9.2f}"
            f"{row['target_p99_ms']:>8.0f}{row['library_p50_ms']:>12.3f}{row['ratio']:>8.1f}{row['load']:>7.2f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
