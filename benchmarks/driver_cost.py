"""What the driver costs: CPU of servo_node, tactile_node, the bus and the board link, each in a process of its own.

The emulated hardware (bench plants) and the subscribers run in further processes. `feed` sends servo_node 50
trajectories per second, as docking_node does while the arm moves.

python benchmarks/driver_cost.py [--seconds 30] [--json]
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from deltacharger_bringup import environment

environment.prepare()
environment.isolate()

SETTLE = 5.0  # s for discovery and the clock's first fits
RATE = 100.0  # Hz of the bus loop
PARTS = ("servo_node", "tactile_node", "feed", "bus loop", "board link")


def emulate(folder: Path) -> None:
    """Serve both emulators until stdin ends."""
    from deltacharger_driver.bench_arm import BenchArm
    from deltacharger_driver.bench_plant import BenchPlant
    from deltacharger_driver.board_emulator import BoardEmulator
    from deltacharger_driver.pseudo_terminal import PseudoTerminal
    from deltacharger_driver.servo_emulator import ServoBusEmulator

    servos = PseudoTerminal(ServoBusEmulator(BenchArm()), folder / "servo")
    with servos, PseudoTerminal(BoardEmulator(BenchPlant()), folder / "board"):
        print("ready", flush=True)
        sys.stdin.read()


def listen(feed: bool) -> None:
    """Subscribe once to each topic of the driver; with `feed`, switch torque on and send pieces of a line."""
    import rclpy
    from deltacharger.msg import ChargerPower, ServoState, TactileFrame
    from rclpy.executors import ExternalShutdownException
    from rclpy.qos import QoSProfile, qos_profile_sensor_data
    from std_srvs.srv import SetBool
    from trajectory_msgs.msg import JointTrajectory

    rclpy.init()
    node = rclpy.create_node("listener")
    latest = QoSProfile(depth=1)
    node.create_subscription(ServoState, "servo_state", lambda message: None, latest)
    node.create_subscription(TactileFrame, "tactile_frame", lambda message: None, qos_profile_sensor_data)
    node.create_subscription(ChargerPower, "charger_power", lambda message: None, latest)
    if feed:
        torque: Any = node.create_client(SetBool, "set_torque")
        torque.wait_for_service(20.0)
        rclpy.spin_until_future_complete(node, torque.call_async(SetBool.Request(data=True)))
        publisher = node.create_publisher(JointTrajectory, "joint_trajectory", latest)
        node.create_timer(0.02, lambda: publisher.publish(_piece(node.get_clock().now())))
    print("ready", flush=True)
    with contextlib.suppress(ExternalShutdownException, KeyboardInterrupt):
        rclpy.spin(node)


def _piece(now: Any) -> Any:
    """120 ms of a slow swing, six points, stamped now."""
    import math
    from array import array

    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    message = JointTrajectory(joint_names=[f"limb_{limb}_arm_joint" for limb in range(3)])
    message.header.stamp = now.to_msg()
    for step in range(1, 7):
        angle = -0.7 + 0.1 * math.sin(now.nanoseconds * 1e-9 + 0.02 * step)
        point = JointTrajectoryPoint(positions=array("d", [angle] * 3), effort=array("d", [1.2] * 3))
        point.time_from_start.nanosec = 20_000_000 * step
        message.points.append(point)
    return message


def loop(part: str, folder: Path) -> None:
    """The library without ROS: a bus cycle at 100 Hz, or the link with a callback."""
    if part == "bus loop":
        from deltacharger_driver.servo_bus import ServoBus
        from deltacharger_driver.servo_snapshot import BusSettings

        bus = ServoBus(BusSettings(str(folder / "servo")))
        bus.open()
        print("ready", flush=True)
        due = time.monotonic()
        while True:
            bus.write_goals((-0.7, -0.7, -0.7), (0.5, 0.5, 0.5))
            bus.read()
            due = max(due + 1.0 / RATE, time.monotonic())
            time.sleep(due - time.monotonic() if due > time.monotonic() else 0.0)
    from deltacharger_driver.board_link import BoardLink

    with BoardLink(str(folder / "board"), on_tactile=lambda sample: None) as link:
        link.start()
        print("ready", flush=True)
        time.sleep(1e9)


def cpu_seconds(pid: int) -> float:
    """CPU time of a process so far, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def spawn(*arguments: str) -> subprocess.Popen[str]:
    """Start a role of this script and wait until it is ready."""
    process = subprocess.Popen(
        [sys.executable, __file__, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    if process.stdout.readline().strip() != "ready":
        raise SystemExit(f"{' '.join(arguments)} did not start; see its message above")
    return process


def node(name: str, port: Path) -> subprocess.Popen[str]:
    """Start a driver node on a port."""
    command = [sys.executable, "-m", f"deltacharger_driver.{name}", "--ros-args", "-p", f"port:={port}"]
    return subprocess.Popen([*command, "--log-level", "fatal"], text=True)


def measure(part: str, seconds: float, folder: Path) -> dict[str, Any]:
    """Return the CPU of one part in % of a core."""
    with contextlib.ExitStack() as stack:

        def keep(process: subprocess.Popen[str]) -> subprocess.Popen[str]:
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        emulator = keep(spawn("--role", "emulate", "--folder", str(folder)))
        if part in ("bus loop", "board link"):
            process = keep(spawn("--role", part, "--folder", str(folder)))
        elif part == "tactile_node":
            process = keep(node(part, folder / "board"))
            keep(spawn("--role", "listen"))
        else:
            process = keep(node("servo_node", folder / "servo"))
            keep(spawn("--role", "feed" if part == "feed" else "listen"))
        time.sleep(SETTLE)
        before, began = (cpu_seconds(process.pid), cpu_seconds(emulator.pid)), time.monotonic()
        time.sleep(seconds)
        elapsed = time.monotonic() - began
        used, emulated = cpu_seconds(process.pid) - before[0], cpu_seconds(emulator.pid) - before[1]
    return {"part": part, "cpu_percent": 100 * used / elapsed, "emulators_percent": 100 * emulated / elapsed}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="how long each part is measured")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="what to measure")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    parser.add_argument("--role", help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.role == "emulate":
        emulate(arguments.folder)
    elif arguments.role in ("listen", "feed"):
        listen(arguments.role == "feed")
    elif arguments.role:
        loop(arguments.role, arguments.folder)
    else:
        rows = []
        for part in arguments.parts:
            folder = Path(tempfile.mkdtemp(prefix="deltacharger-"))
            rows.append({**measure(part, arguments.seconds, folder), "load": os.getloadavg()[0]})
            shutil.rmtree(folder, ignore_errors=True)
            if not arguments.json:
                row = rows[-1]
                print(
                    f"{row['part']:<14}{row['cpu_percent']:>6.1f} % of a core, emulators "
                    f"{row['emulators_percent']:.1f} %, load {row['load']:.1f}",
                    flush=True,
                )
        if arguments.json:
            print(json.dumps({"seconds": arguments.seconds, "rows": rows}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
