# SPDX-License-Identifier: Apache-2.0
"""Performance of a simulated charger: rates, gaps, CPU, docking time, memory. Run by `make bench`.

python lab/benchmarks/charger.py [--seconds 30] [--json]
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from deltacharger_core import environment

environment.prepare()
environment.isolate()

import rclpy  # noqa: E402
from deltacharger.msg import ServoState, TactileFrame  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import QoSProfile, qos_profile_sensor_data  # noqa: E402

COMMAND = str(Path(sys.executable).with_name("deltacharger"))
READY_LIMIT = 60.0  # s


class Counter:
    """Records sequence numbers and stamps of both topics."""

    def __init__(self, node: Any) -> None:
        self.tactile: list[tuple[int, float]] = []
        self.servo: list[float] = []
        node.create_subscription(TactileFrame, "tactile_frame", self._on_tactile, qos_profile_sensor_data)
        node.create_subscription(ServoState, "servo_state", self._on_servo, QoSProfile(depth=10))

    def _on_tactile(self, message: TactileFrame) -> None:
        self.tactile.append((message.sequence, stamp(message)))

    def _on_servo(self, message: ServoState) -> None:
        self.servo.append(stamp(message))


def stamp(message: Any) -> float:
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def rate(stamps: list[float]) -> float:
    return (len(stamps) - 1) / (stamps[-1] - stamps[0]) if len(stamps) > 1 else float("nan")


def cpu_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(("VmHWM", "VmRSS"))) / 1024


def measure_rates(seconds: float) -> dict[str, Any]:
    """Start the simulated charger in a separate process and listen for `seconds`."""
    started = time.monotonic()
    charger = subprocess.Popen([COMMAND, "up"], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    assert charger.stderr is not None
    for line in charger.stderr:
        if line.strip() == "ready":
            break
        if time.monotonic() - started > READY_LIMIT:
            raise TimeoutError(f"the charger was not ready within {READY_LIMIT:.0f} s")
    ready = time.monotonic() - started
    rclpy.init()
    node = rclpy.create_node("bench")
    counter = Counter(node)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    used, begin = cpu_seconds(charger.pid), time.monotonic()
    shown = 0
    while time.monotonic() - begin < seconds:
        executor.spin_once(timeout_sec=0.1)
        if int(time.monotonic() - begin) > shown:
            shown = int(time.monotonic() - begin)
            print(f"\r{shown}/{seconds:.0f} s", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    result = {
        "ready_s": ready,
        "seconds": seconds,
        "tactile_hz": rate([at for _, at in counter.tactile]),
        "tactile_gaps": sum(b[0] - a[0] - 1 for a, b in zip(counter.tactile, counter.tactile[1:], strict=False)),
        "tactile_frames": len(counter.tactile),
        "servo_hz": rate(counter.servo),
        "charger_cpu_percent": 100 * (cpu_seconds(charger.pid) - used) / (time.monotonic() - begin),
        "charger_memory_mb": memory_mb(charger.pid),
    }
    node.destroy_node()
    rclpy.shutdown()
    charger.send_signal(signal.SIGTERM)
    charger.wait(20)
    return result


def measure_docking() -> dict[str, Any]:
    """Run the command of `make dock` and return its times and its peak memory."""
    started = time.monotonic()
    picture = Path(tempfile.mkdtemp()) / "dock.png"
    command = [COMMAND, "dock", "--json", "--picture", str(picture)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdout is not None
    answer = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    result = json.loads(answer)
    shutil.rmtree(picture.parent)
    return {
        "wall_s": time.monotonic() - started,
        "docking_s": result["elapsed"],
        "success": result["success"] and os.waitstatus_to_exitcode(status) == 0,
        "memory_mb": usage.ru_maxrss / 1024,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="time to count messages")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    arguments = parser.parse_args()
    rates = measure_rates(arguments.seconds)
    docking = [measure_docking() for _ in range(2)]
    if arguments.json:
        print(json.dumps({"rates": rates, "docking": docking}))
        return 0
    rows = [
        ("ready after", f"{rates['ready_s']:.1f} s", ""),
        (
            "tactile frames",
            f"{rates['tactile_hz']:.2f} Hz",
            f"{rates['tactile_gaps']} lost in {rates['seconds']:.0f} s",
        ),
        ("servo state", f"{rates['servo_hz']:.2f} Hz", ""),
        ("CPU at rest, everything in one process", f"{rates['charger_cpu_percent']:.0f} %", "of one core"),
        ("memory of that process", f"{rates['charger_memory_mb']:.0f} MB", ""),
    ]
    for number, run in enumerate(docking, 1):
        rows.append((f"dock, run {number}", f"{run['wall_s']:.1f} s", f"of which docking {run['docking_s']:.1f} s"))
        rows.append((f"dock, run {number}, memory", f"{run['memory_mb']:.0f} MB", "" if run["success"] else "FAILED"))
    for what, value, remark in rows:
        print(f"{what:<42}{value:>12}  {remark}")
    return 0 if all(run["success"] for run in docking) else 1


if __name__ == "__main__":
    sys.exit(main())
