# SPDX-License-Identifier: Apache-2.0
"""CPU time of subscribing to a robot's /tf, for a node that needs it rarely: python lab/benchmarks/transforms.py.

A second process publishes transforms. This one measures its CPU time without a listener, with the readers of
deltacharger_ros.frames, and with tf2_ros's TransformListener, and the time of a look-up. Needs tf2_ros.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import rclpy
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node

from deltacharger_core import environment
from deltacharger_core.frames import TransformParameters
from deltacharger_ros.executor import Spinner
from deltacharger_ros.frames import TF, TfTree

FRAMES = 4  # transforms in a message


def publish(rate: float) -> None:
    """Publish at this rate until killed."""
    from tf2_msgs.msg import TFMessage

    rclpy.init()
    node = Node("robot")
    topic = node.create_publisher(TFMessage, TF, 100)
    due = time.monotonic()
    while True:
        message = TFMessage(transforms=[TransformStamped(child_frame_id=f"link_{index}") for index in range(FRAMES)])
        for index, each in enumerate(message.transforms):
            each.header.frame_id = f"link_{index - 1}" if index else "map"
            each.header.stamp = node.get_clock().now().to_msg()
        topic.publish(message)
        due += 1.0 / rate
        time.sleep(max(0.0, due - time.monotonic()))


def nothing(node: Node) -> Any:
    """Do not listen."""


def readers(node: Node) -> TfTree:
    """Listen as docking_node does."""
    return TfTree(node, TransformParameters())


def listener(node: Node) -> Any:
    """Listen as most nodes do."""
    from tf2_ros import Buffer, TransformListener

    return TransformListener(Buffer(), node, spin_thread=False)


def cost(make: Callable[[Node], Any], seconds: float) -> float:
    """Return the share of a core (%) that a node with this listener uses."""
    node = Node("listener")
    listening = make(node)
    spinner = Spinner(node)
    time.sleep(1.0)  # discovery is not measured
    began, used = time.monotonic(), time.process_time()
    time.sleep(seconds)
    share = 100.0 * (time.process_time() - used) / (time.monotonic() - began)
    if isinstance(listening, TfTree):
        began = time.perf_counter()
        listening.lookup("map", f"link_{FRAMES - 1}")
        first, began = time.perf_counter() - began, time.perf_counter()
        listening.lookup("map", f"link_{FRAMES - 1}")
        print(f"  a look-up: the first {1e3 * first:.1f} ms, the next {1e3 * (time.perf_counter() - began):.1f} ms")
    spinner.close()
    return share


def main() -> None:
    """Print the CPU share of each way to listen."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rate", type=float, default=300.0, help="messages per second")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement")
    parser.add_argument("--publish", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    environment.prepare()
    if options.publish:
        publish(options.rate)
    robot = subprocess.Popen([sys.executable, __file__, "--publish", "--rate", str(options.rate)])
    try:
        rclpy.init()
        for make in (nothing, readers, listener):
            share = cost(make, options.seconds)
            print(f"{make.__name__:10} {share:5.2f} % of a core at {options.rate:g} messages a second")
    finally:
        robot.kill()
        robot.wait()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
