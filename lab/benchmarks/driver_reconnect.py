# SPDX-License-Identifier: Apache-2.0
"""Time until servo_node and tactile_node publish again after their port was unplugged and replugged.

Target: 2 s from the replug to the first good servo_state (all servos valid) or the first tactile_frame. Emulated
hardware and nodes run in separate processes. The cable is unplugged for a random time, so that replugs cover all phases
of the nodes' attempts to reopen. Torque is off, as after every unplugging.

python lab/benchmarks/driver_reconnect.py [--replugs 20] [--json]
"""

import argparse
import contextlib
import os
import random
import statistics
import sys
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

import driver_processes as processes
from driver_processes import CannotMeasure, Figure, at_most

from deltacharger_core import environment

environment.prepare()
environment.isolate()

LIMIT = 2.0  # s
OUT = (0.3, 2.0)  # s with the cable unplugged
IN = (0.5, 1.0)  # s with the cable plugged in before the next time
PATIENCE = 20.0  # s until the first message, and until a port counts as lost
SEED = 47
NODES = {"servo": "servo_node", "board": "tactile_node"}  # by port
MESSAGES = {"servo": "good servo_state", "board": "tactile_frame"}


def emulate(folder: Path) -> None:
    """Run both emulators on one world, plug and unplug on order, until stdin ends."""
    from deltacharger_driver.ports import PseudoTerminal
    from deltacharger_sim.emulators.board import BoardEmulator
    from deltacharger_sim.emulators.servo_bus import ServoBusEmulator
    from deltacharger_sim.parameters import WorldParameters
    from deltacharger_sim.world import SharedWorld, World

    world = SharedWorld(World(WorldParameters()))

    def plug(name: str) -> float:
        began = time.monotonic()  # before the port appears: this time counts for the node
        cables[name].replug()
        return began

    processes.take_priority()
    servo = PseudoTerminal(ServoBusEmulator(world), folder / "servo")
    board = PseudoTerminal(BoardEmulator(world), folder / "board")
    cables = {"servo": servo, "board": board}
    with servo, board:
        unplugs = {f"unplug {name}": cable.unplug for name, cable in cables.items()}
        processes.serve({**unplugs, **{f"plug {name}": partial(plug, name) for name in cables}})


class Listener:
    """Time of the first good message after `clear`, by port."""

    def __init__(self, node: Any) -> None:
        from deltacharger.msg import ServoState, TactileFrame
        from rclpy.qos import QoSProfile, qos_profile_sensor_data

        self._received = {name: threading.Event() for name in NODES}
        self._first = dict.fromkeys(NODES, 0.0)
        node.create_subscription(ServoState, "servo_state", self._on_state, QoSProfile(depth=1))
        node.create_subscription(TactileFrame, "tactile_frame", lambda _: self._note("board"), qos_profile_sensor_data)

    def clear(self, name: str) -> None:
        """Forget the messages of a port's node."""
        self._received[name].clear()

    def wait(self, name: str) -> float:
        """Return the time of the first good message, s."""
        if not self._received[name].wait(PATIENCE):
            raise CannotMeasure(f"no {MESSAGES[name]} within {PATIENCE:.0f} s")
        return self._first[name]

    def has_received(self, name: str) -> bool:
        """Whether a good message arrived since `clear`."""
        return self._received[name].is_set()

    def _on_state(self, message: Any) -> None:
        if len(message.valid) == 3 and all(message.valid):
            self._note("servo")

    def _note(self, name: str) -> None:
        if not self._received[name].is_set():
            self._first[name] = time.monotonic()
            self._received[name].set()


def replug(hardware: processes.Role, listener: Listener, name: str, source: random.Random) -> float:
    """Unplug and replug a cable; return the s until the node publishes again."""
    time.sleep(source.uniform(*IN))
    hardware.ask(f"unplug {name}")
    time.sleep(0.2)  # until messages sent before have arrived
    listener.clear(name)
    time.sleep(source.uniform(*OUT) - 0.2)
    if listener.has_received(name):
        raise CannotMeasure(f"{NODES[name]} published without a cable")
    plugged = hardware.ask(f"plug {name}")
    return listener.wait(name) - float(plugged)


def run(replugs: int) -> dict[str, list[float]]:
    """Return the s of every replug, by port."""
    import rclpy

    source, times = random.Random(SEED), {name: list[float]() for name in NODES}
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(processes.folder())
        hardware = stack.enter_context(processes.Role(__file__, "--emulate", str(folder)))
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        listener = Listener(node := rclpy.create_node("benchmark"))
        stack.enter_context(processes.spinning(node))
        for name, executable in NODES.items():
            stack.callback(processes.end, processes.start_node(executable, {"port": folder / name}))
        for name in NODES:
            listener.wait(name)
        for turn in range(replugs):
            for name, taken in times.items():
                taken.append(replug(hardware, listener, name, source))
            done = ", ".join(f"{NODES[name]} {taken[-1]:.2f} s" for name, taken in times.items())
            processes.progress(f"replug {turn + 1}/{replugs}: {done}")
    return times


def evaluate(times: dict[str, list[float]]) -> list[Figure]:
    """Return the distribution for each port."""
    figures = []
    for name, taken in times.items():
        what = f"{NODES[name]}, replug to {MESSAGES[name]}, {len(taken)} times"
        figures += [
            Figure(f"{what}: shortest", min(taken), "s"),
            Figure("  median", statistics.median(taken), "s"),
            Figure("  90 % within", sorted(taken)[-(-9 * len(taken) // 10) - 1], "s"),
            at_most("  longest", max(taken), "s", LIMIT),
        ]
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--replugs", type=int, default=20, help="of each port")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    parser.add_argument("--emulate", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.emulate:
        emulate(arguments.emulate)
        return 0
    if arguments.replugs < 1:
        parser.error("--replugs must be at least 1")
    try:
        times = run(arguments.replugs)
    except CannotMeasure as error:
        processes.progress(f"nothing measured: {error}")
        return 1
    processes.print_figures(evaluate(times), arguments.json, seconds=times, load=os.getloadavg()[0])
    return 0


if __name__ == "__main__":
    sys.exit(main())
