# SPDX-License-Identifier: Apache-2.0
"""Time until the contactor is open and the arm at rest after a node was killed or stopped.

Nodes and emulated hardware run in separate processes, so that a stopped node does not delay the hardware. Signals are
SIGKILL and SIGSTOP. Targets: the contactor opens within 100 ms after tactile_node and 350 ms after docking_node or
servo_node. A line of the arm (0.12 m/s, signal on the way) continues for at most 200 ms.

Figures of the hardware itself show whether it was on time: the time between the last byte that its board received and
the opening (95 ms if on time and without a command to open), and the longest pause of its monitoring thread. The line
has ended when the arm is within 0.2 mm of its last position along the line. The arm rests when this is true in all
directions. A servo with a tripped watchdog holds its position without the lead for its load, so it sags.

python lab/benchmarks/driver_kill.py [--tactile 10] [--dockings 1] [--json]
"""

import argparse
import contextlib
import os
import random
import signal
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import driver_processes as processes
from driver_processes import CannotMeasure, Figure, Role, at_most

from deltacharger_core import environment
from deltacharger_core.machine import DOCK_DISTANCE

environment.prepare()
environment.isolate()

LIMITS = {"tactile_node": 100.0, "docking_node": 350.0, "servo_node": 350.0}  # ms until the contactor is open
LINE_LIMIT = 200.0  # ms
SIGNALS = (signal.SIGKILL, signal.SIGSTOP)
ATTEMPTS = 3
PERIOD = 0.001  # s between two checks of contactor or arm in the emulated hardware
SEED = 74  # of the times within heartbeat and cycle at which nodes are killed
MOVING = 0.020  # m along the line from home: the arm is at full speed
TRACK = 0.45  # s of recording the arm after a kill; 0.5 s without tactile frames send it home
NEAR = 0.0002  # m


class TimedBoard:
    """A board that stores the time of the last received bytes, s, monotonic."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self.last = 0.0
        self.poll, self.next_event = device.poll, device.next_event

    def receive(self, data: bytes, now: float) -> bytes:
        """Forward bytes."""
        self.last = now
        return bytes(self._device.receive(data, now))


def emulate_bench(folder: Path) -> None:
    """Emulate a board whose target comes to the electrodes on order, until stdin ends."""
    from deltacharger_driver.ports import PseudoTerminal
    from deltacharger_sim.charger.simulation import Simulation
    from deltacharger_sim.emulators.board import BoardEmulator
    from deltacharger_sim.world import SharedWorld

    plant = SharedWorld(Simulation().build_world())
    board = TimedBoard(BoardEmulator(plant))

    def watch(closed: bool) -> dict[str, float]:
        return {**_until(lambda: plant.read_power().closed is closed), "heard": board.last}

    with PseudoTerminal(board, folder / "board"):
        orders = {
            "press": lambda: plant.world.mechanics.move_along(-DOCK_DISTANCE),
            "closed": lambda: watch(True),
            "open": lambda: watch(False),
        }
        processes.serve(orders)


def emulate_world(folder: Path) -> None:
    """Emulate the simulated scene's hardware until stdin ends."""
    from deltacharger_bringup.scenes.scene import load_scene
    from deltacharger_sim.charger.simulated_charger import SimulatedCharger

    with SimulatedCharger(load_scene("simulated").simulation, folder) as charger:
        world = charger.world

        def watch_opening() -> dict[str, float]:
            return {**_until(lambda: not world.circuit.closed), "heard": charger.board_heard}

        def track() -> list[tuple[float, float, float, float]]:
            places, end = [], time.monotonic() + TRACK
            while time.monotonic() < end:
                x, y, z = world.snapshot().position
                places.append((time.monotonic(), x, y, z))
                time.sleep(PERIOD)
            return places

        def watch_start() -> bool:
            _until(lambda: world.snapshot().position[2] > MOVING)
            return bool(world.snapshot().position[2] > MOVING)

        processes.serve({"open": watch_opening, "moving": watch_start, "track": track})


def _until(condition: Callable[[], bool]) -> dict[str, float]:
    """Wait for a condition; return the time at which it became true and the longest pause of this process (s)."""
    last, pause, end = time.monotonic(), 0.0, time.monotonic() + processes.PATIENCE
    while not condition() and last < end:
        time.sleep(PERIOD)
        now = time.monotonic()
        last, pause = now, max(pause, now - last)
    return {"at": time.monotonic(), "pause": pause}


def hardware(kind: str, folder: Path) -> Role:
    """Start emulated hardware: `bench` or `world`."""
    return Role(__file__, "--emulate", kind, "--folder", str(folder))


def strike_charging(role: Role, pid: int, number: int) -> dict[str, float]:
    """Send the signal at a random time; return the ms until the contactor is open, and delays of the hardware."""
    role.begin("open")
    time.sleep(0.3 + random.random() * 0.1)
    at = time.monotonic()
    os.kill(pid, number)
    answer = role.end()
    if answer["at"] < at:
        raise CannotMeasure("the contactor opened without a command before the kill")
    silence = answer["at"] - answer["heard"]
    return {"open": 1e3 * (answer["at"] - at), "silence": 1e3 * silence, "pause": 1e3 * answer["pause"]}


def strike_moving(role: Role, pid: int, number: int) -> dict[str, float]:
    """Send the signal in motion; return the ms until the end of the line and until rest, and the distance (mm)."""
    if not role.ask("moving"):
        raise CannotMeasure("the arm did not start to move")
    role.begin("track")
    time.sleep(random.random() * 0.02)
    at = time.monotonic()
    os.kill(pid, number)
    places = [place for place in role.end() if place[0] >= at]
    last, first = places[-1], places[0]
    line = [time for time, _, _, z in places if abs(z - last[3]) > NEAR]
    rest = [place[0] for place in places if max(abs(a - b) for a, b in zip(place[1:], last[1:], strict=True)) > NEAR]
    if last[3] - first[3] < NEAR:
        raise CannotMeasure("the arm did not move when the signal was sent")
    return {
        "line": 1e3 * (max(line, default=at) - at),
        "rest": 1e3 * (max(rest, default=at) - at),
        "way": 1e3 * (max(place[3] for place in places) - first[3]),
    }


@contextlib.contextmanager
def holding(client: Any, group: Any) -> Iterator[None]:
    """Renew a lease ten times per second, as docking_node does, in a thread of this process."""
    from builtin_interfaces.msg import Duration
    from deltacharger.srv import SetContactor

    contactor = client.create_client(SetContactor, "set_contactor", callback_group=group)
    over = threading.Event()

    def renew() -> None:
        while not over.wait(0.1):
            request = SetContactor.Request(close=True, holder="benchmark", lease=Duration(nanosec=250_000_000))
            request.current_max, request.voltage_max, request.start_time, request.gap_time = 10.0, 29.4, 3.0, 0.2
            contactor.call_async(request)

    thread = threading.Thread(target=renew)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def call(client: Any, kind: Any, name: str, group: Any) -> None:
    """Call a service that must succeed."""
    service = client.create_client(kind, name, callback_group=group)
    answered = threading.Event()
    if not service.wait_for_service(processes.PATIENCE):
        raise CannotMeasure(f"no server of {name}")
    future = service.call_async(kind.Request())
    future.add_done_callback(lambda done: answered.set())
    if not answered.wait(10.0) or not future.result().success:
        raise CannotMeasure(f"{name} failed: {future.result()}")


def kill_alone(name: str, number: int, folder: Path) -> dict[str, float]:
    """Kill tactile_node alone on a bench plant; this process holds the lease."""
    import rclpy
    from deltacharger.srv import Probe
    from rclpy.callback_groups import ReentrantCallbackGroup
    from std_srvs.srv import Trigger

    with contextlib.ExitStack() as stack:
        role = stack.enter_context(hardware("bench", folder))
        node = processes.start_node(name, {"port": folder / "board"})
        stack.callback(processes.end, node)
        client, group = rclpy.create_node("benchmark"), ReentrantCallbackGroup()
        stack.enter_context(processes.spinning(client))
        call(client, Trigger, "tare", group)
        role.ask("press")
        time.sleep(0.2)
        call(client, Probe, "probe", group)
        stack.enter_context(holding(client, group))
        role.ask("closed")
        return strike_charging(role, node.pid, number)


@contextlib.contextmanager
def charger(folder: Path) -> Iterator[tuple[Role, dict[str, int]]]:
    """Start the simulated scene's hardware and nodes; yields the hardware and the nodes' process ids."""
    from deltacharger_bringup.scenes.scene import load_scene

    ports = {"servo": str(folder / "servo"), "board": str(folder / "board")}
    with hardware("world", folder) as role, processes.nodes_of(load_scene("simulated"), ports) as nodes:
        yield role, {name: node.pid for name, node in nodes.items()}


def kill_charging(name: str, number: int, folder: Path) -> dict[str, float]:
    """Kill one of all nodes of the simulated scene while docking_node charges."""
    with charger(folder) as (role, pids):
        processes.charge()
        return strike_charging(role, pids[name], number)


def kill_moving(name: str, number: int, folder: Path) -> dict[str, float]:
    """Kill one of all nodes of the simulated scene while the arm moves to the target."""
    with charger(folder) as (role, pids):
        client = subprocess.Popen([sys.executable, __file__, "--emulate", "client"])
        try:
            return strike_moving(role, pids[name], number)
        finally:
            processes.end(client)


def charge() -> None:
    """Request a charge; its result is ignored."""
    with contextlib.suppress(CannotMeasure):
        processes.charge()


def attempt(kill: Callable[[str, int, Path], dict[str, float]], name: str, number: int) -> dict[str, float]:
    """Make one kill; try again if the charger did not reach the state to be interrupted."""
    for left in reversed(range(ATTEMPTS)):
        try:
            with processes.folder() as folder:
                return kill(name, number, folder)
        except CannotMeasure as error:
            processes.progress(f"{error}; attempts left: {left}")
    raise SystemExit("the charger never reached the state to be interrupted")


def figures_of(label: str, name: str, runs: list[dict[str, float]]) -> list[Figure]:
    """Return the figures of several kills of one kind."""
    values = {key: [run[key] for run in runs] for key in runs[0]}
    count = f", largest of {len(runs)}"
    if "open" in values:
        return [
            at_most(f"{label}: contactor open{count}", max(values["open"]), "ms", LIMITS[name]),
            Figure(f"{label}: median", statistics.median(values["open"]), "ms"),
            Figure(f"{label}: longest silence before an opening", max(values["silence"]), "ms"),
            Figure(f"{label}: longest pause of the hardware", max(values["pause"]), "ms"),
        ]
    return [
        at_most(f"{label}: line ended{count}", max(values["line"]), "ms", LINE_LIMIT),
        Figure(f"{label}: arm at rest{count}", max(values["rest"]), "ms"),
        Figure(f"{label}: way along the line{count}", max(values["way"]), "mm"),
    ]


def run(alone: int, dockings: int) -> list[Figure]:
    """Make all kills and return the figures."""
    import rclpy

    random.seed(SEED)
    rclpy.init()
    cases = [("tactile_node", "alone", kill_alone, alone)]
    cases += [(name, "charging", kill_charging, dockings) for name in LIMITS]
    cases += [(name, "moving", kill_moving, dockings) for name in LIMITS]
    figures: list[Figure] = []
    for name, chain, kill, rounds in cases:
        for number in SIGNALS if rounds else ():
            label = f"{name} {number.name} {chain}"
            runs = []
            for turn in range(rounds):
                processes.progress(f"{label} {turn + 1}/{rounds}, load {os.getloadavg()[0]:.1f}")
                runs.append(attempt(kill, name, number))
            figures += figures_of(label, name, runs)
    rclpy.shutdown()
    return figures


ROLES: dict[str, Callable[[Path], None]] = {
    "bench": emulate_bench,
    "world": emulate_world,
    "client": lambda folder: charge(),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tactile", type=int, default=10, help="kills of tactile_node alone, per signal")
    parser.add_argument(
        "--dockings", type=int, default=1, help="kills of each node on the way and charging, per signal"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    parser.add_argument("--emulate", choices=ROLES, help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, default=Path(), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.emulate:
        ROLES[arguments.emulate](arguments.folder)
        return 0
    figures = run(arguments.tactile, arguments.dockings)
    processes.print_figures(figures, arguments.json)
    return 1 if any(figure.met is False for figure in figures) else 0


if __name__ == "__main__":
    sys.exit(main())
