# SPDX-License-Identifier: Apache-2.0
"""CPU use of the driver: servo_node, tactile_node, the bus and the board link, each in a separate process.

The emulated hardware (bench plants) and the subscribers run in other processes. `feed` sends servo_node 50
trajectories per second, as docking_node does while the arm moves. Target: 5 % of a core each.

python lab/benchmarks/driver_cost.py [--seconds 30] [--json]
"""

import argparse
import contextlib
import os
import sys
import threading
import time
from pathlib import Path
from typing import Any

import driver_processes as processes
from driver_processes import CannotMeasure, CpuMeter, Figure, Role, at_most

from deltacharger_core import environment

environment.prepare()
environment.isolate()

SETTLE = 5.0  # s for discovery and the clock's first fits
RATE = 100.0  # Hz of the bus loop
PARTS = {
    "servo_node": "servo_node, three servos x full block at 100 Hz",
    "tactile_node": "tactile_node at 120 Hz",
    "feed": "servo_node that follows 50 trajectories per second",
    "bus loop": "the bus loop without ROS",
    "board link": "the board link without ROS",
}


def emulate(folder: Path) -> None:
    """Run both emulators until stdin ends."""
    from deltacharger_driver.ports import PseudoTerminal
    from deltacharger_sim.emulators.board import BoardEmulator
    from deltacharger_sim.emulators.servo_bus import ServoBusEmulator
    from deltacharger_sim.parameters import WorldParameters
    from deltacharger_sim.world import SharedWorld, World

    world = SharedWorld(World(WorldParameters()))
    servos = PseudoTerminal(ServoBusEmulator(world), folder / "servo")
    with servos, PseudoTerminal(BoardEmulator(world), folder / "board"):
        processes.serve({})


def listen(feed: bool) -> None:
    """Subscribe once to each topic of the driver; with `feed`, switch torque on and send trajectories."""
    import rclpy
    from deltacharger.msg import ChargerPower, ServoState, TactileFrame
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
        node.create_timer(0.02, lambda: publisher.publish(_trajectory(node.get_clock().now())))
    with processes.spinning(node):
        processes.serve({})


def _trajectory(now: Any) -> Any:
    """Return 120 ms of a slow oscillation, six points, stamped now."""
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


def loop_bus(folder: Path) -> None:
    """Cycle the servo bus at 100 Hz, without ROS, until stdin ends."""
    from deltacharger_driver.servos.bus import ServoBus
    from deltacharger_driver.servos.registers import BusSettings

    bus = ServoBus(BusSettings(str(folder / "servo")))
    bus.open()
    orders = threading.Thread(target=processes.serve, args=({},), daemon=True)  # the bus is used by this thread
    orders.start()
    due = time.monotonic()
    while orders.is_alive():
        bus.write_goals((-0.7, -0.7, -0.7), (0.5, 0.5, 0.5))
        bus.read()
        due = max(due + 1.0 / RATE, time.monotonic())
        time.sleep(max(due - time.monotonic(), 0.0))


def hold_link(folder: Path) -> None:
    """Receive tactile frames, without ROS, until stdin ends."""
    from deltacharger_driver.board.link import BoardLink

    with BoardLink(str(folder / "board"), on_tactile=lambda sample: None) as link:
        link.start()
        processes.serve({})


def measure(part: str, seconds: float) -> Figure:
    """Return the CPU of one part in % of a core."""
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(processes.folder())

        def role(name: str) -> int:
            return stack.enter_context(Role(__file__, "--role", name, "--folder", str(folder))).pid

        emulated = role("emulate")
        if part in ("bus loop", "board link"):
            measured = role(part)
        else:
            name, port = ("tactile_node", "board") if part == "tactile_node" else ("servo_node", "servo")
            node = processes.start_node(name, {"port": folder / port})
            stack.callback(processes.end, node)
            measured = node.pid
            role("feed" if part == "feed" else "listen")
        time.sleep(SETTLE)
        meter = CpuMeter({"measured": measured, "emulated": emulated})
        time.sleep(seconds)
        used = meter.percent()
    what = f"{PARTS[part]} (its emulator {used['emulated']:.1f})"
    return at_most(what, used["measured"], "% of a core", processes.DRIVER_LIMIT)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="time to measure each part")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS), help="what to measure")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    parser.add_argument("--role", help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    roles = {"emulate": emulate, "bus loop": loop_bus, "board link": hold_link}
    if arguments.role:
        listens = arguments.role in ("listen", "feed")
        listen(arguments.role == "feed") if listens else roles[arguments.role](arguments.folder)
        return 0
    figures: list[Figure] = []
    try:
        for part in arguments.parts:
            processes.progress(f"{part}: {SETTLE + arguments.seconds:.0f} s")
            figures.append(measure(part, arguments.seconds))
    except CannotMeasure as error:
        processes.progress(f"nothing measured: {error}")
        return 1
    processes.print_figures(figures, arguments.json, seconds=arguments.seconds, load=os.getloadavg()[0])
    return 0


if __name__ == "__main__":
    sys.exit(main())
