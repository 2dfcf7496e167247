"""How soon the contactor is open after a node was killed or stopped, nodes and emulated hardware as real processes.

Targets: 100 ms after tactile_node, 350 ms after docking_node or servo_node; SIGKILL and SIGSTOP alike. The emulated
hardware runs in a process of its own, so that nothing on the host's side can starve it together with the node. How well
it kept up itself is told as well: the time between the last byte that it heard and its opening, which a board on time
holds to 95 ms where nobody orders an opening, and the longest pause of its watching thread.

python benchmarks/driver_kill.py [--tactile 10] [--dockings 1] [--json]
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from deltacharger_bringup import environment

environment.prepare()
environment.isolate()

LIMITS = {"tactile_node": 0.100, "docking_node": 0.350, "servo_node": 0.350}  # s
SIGNALS = (signal.SIGKILL, signal.SIGSTOP)
PATIENCE = 60.0  # s
ATTEMPTS = 3
LOOK = 0.001  # s between two looks of the emulator at its contactor
SEED = 74  # of the instants within heartbeat and cycle at which nodes are killed


Hooks = tuple[Callable[[], bool], Callable[[], None], Callable[[], float]]
"""Whether the contactor is closed; press on the pads; when the board last heard something, s."""


class Ear:
    """A board that remembers when it last heard something."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self.last = 0.0
        self.poll, self.next_event = device.poll, device.next_event

    def receive(self, data: bytes, now: float) -> bytes:
        """Pass bytes on."""
        self.last = time.monotonic()
        return bytes(self._device.receive(data, now))


class NotCharging(Exception):
    """The charger did not come to charge, so there was nothing to measure."""


def emulate(kind: str, folder: Path) -> None:
    """Serve emulated hardware until stdin ends; orders come as lines, answers go out as JSON."""
    with contextlib.ExitStack() as stack:
        is_closed, press, heard = (_bench if kind == "bench" else _world)(stack, folder)
        print(json.dumps("ready"), flush=True)
        for line in sys.stdin:
            order = line.strip()
            if order == "press":
                press()
                print(json.dumps("pressed"), flush=True)
            else:
                print(json.dumps({**_watch(is_closed, order == "closed"), "heard": heard()}), flush=True)


def _bench(stack: contextlib.ExitStack, folder: Path) -> Hooks:
    from deltacharger_driver.bench_plant import BenchPlant
    from deltacharger_driver.board_emulator import BoardEmulator
    from deltacharger_driver.pseudo_terminal import PseudoTerminal

    plant = BenchPlant()
    board = Ear(BoardEmulator(plant))
    stack.enter_context(PseudoTerminal(board, folder / "board"))
    return lambda: plant.read_power()[3], lambda: plant.press(20.0), lambda: board.last


def _world(stack: contextlib.ExitStack, folder: Path) -> Hooks:
    from deltacharger_bringup.scene import load_scene
    from deltacharger_bringup.simulated_charger import SimulatedCharger

    charger = stack.enter_context(SimulatedCharger(load_scene("simulated"), folder))
    tap = charger._taps[-1]  # the board's, which is served last
    return lambda: charger.world.circuit.closed, lambda: None, lambda: tap.last


def _watch(is_closed: Callable[[], bool], wanted: bool) -> dict[str, float]:
    """Wait until the contactor is as wanted; return when that was and the longest pause of this process (s)."""
    last, pause, end = time.monotonic(), 0.0, time.monotonic() + PATIENCE
    while is_closed() is not wanted and last < end:
        time.sleep(LOOK)
        now = time.monotonic()
        last, pause = now, max(pause, now - last)
    return {"at": time.monotonic(), "pause": pause}


class Emulator:
    """The emulated hardware in its process."""

    def __init__(self, kind: str, folder: Path) -> None:
        command = [sys.executable, __file__, "--emulate", kind, "--folder", str(folder)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._read()

    def ask(self, order: str) -> Any:
        """Give an order and return the answer."""
        self.begin(order)
        return self._read()

    def begin(self, order: str) -> None:
        """Give an order whose answer `end` returns."""
        assert self._process.stdin is not None
        self._process.stdin.write(order + "\n")
        self._process.stdin.flush()

    def end(self) -> Any:
        """Return the answer to `begin`."""
        return self._read()

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(10.0)
        self._process.kill()

    def _read(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit("the emulated hardware ended; see its message above")
        return json.loads(line)


def start(name: str, parameters: dict[str, Any]) -> subprocess.Popen[bytes]:
    """Start a node as a process of its own."""
    from deltacharger_bringup.node_table import NODES

    command = [sys.executable, "-c", f"import sys; from {NODES[name].module} import main; sys.exit(main())"]
    for key, value in parameters.items():
        command += ["-p", f"{key}:={value}"] if "--ros-args" in command else ["--ros-args", "-p", f"{key}:={value}"]
    return subprocess.Popen([*command, "--ros-args", "--log-level", "fatal"])


def end(process: subprocess.Popen[bytes]) -> None:
    """End a node, also one that is stopped."""
    if process.poll() is None:
        process.kill()
        process.wait()


def strike(emulator: Emulator, process: subprocess.Popen[bytes], number: int) -> dict[str, float]:
    """Send the signal at a random moment; return the s to the open contactor, and how the emulator kept up."""
    emulator.begin("open")
    time.sleep(0.3 + random.random() * 0.1)
    at = time.monotonic()
    process.send_signal(number)
    answer = emulator.end()
    if answer["at"] < at:
        raise NotCharging("the contactor opened by itself before the kill")
    return {"seconds": answer["at"] - at, "pause": answer["pause"], "silence": answer["at"] - answer["heard"]}


@contextlib.contextmanager
def holding(client: Any, group: Any) -> Iterator[None]:
    """Renew a lease ten times a second, as docking_node does, from a thread of this process."""
    from builtin_interfaces.msg import Duration
    from deltacharger.srv import SetContactor

    contactor = client.create_client(SetContactor, "set_contactor", callback_group=group)
    over = threading.Event()

    def renew() -> None:
        while not over.wait(0.1):
            request = SetContactor.Request(close=True, holder="benchmark", lease=Duration(nanosec=250_000_000))
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
    if not service.wait_for_service(PATIENCE):
        raise NotCharging(f"nobody serves {name}")
    future = service.call_async(kind.Request())
    future.add_done_callback(lambda done: answered.set())
    if not answered.wait(10.0) or not future.result().success:
        raise NotCharging(f"{name} failed: {future.result()}")


def kill_tactile(number: int, folder: Path) -> dict[str, float]:
    """tactile_node alone on a bench plant; the lease is held from here."""
    import rclpy
    from deltacharger.srv import Probe
    from rclpy.callback_groups import ReentrantCallbackGroup
    from std_srvs.srv import Trigger

    from deltacharger_bringup.node_support import Spinner

    emulator = Emulator("bench", folder)
    process = start("tactile_node", {"port": folder / "board"})
    spinner = Spinner(rclpy.create_node("benchmark"))
    group = ReentrantCallbackGroup()
    try:
        call(spinner.node, Trigger, "tare", group)
        emulator.ask("press")
        time.sleep(0.2)
        call(spinner.node, Probe, "probe", group)
        with holding(spinner.node, group):
            emulator.ask("closed")
            return strike(emulator, process, number)
    finally:
        spinner.close()
        end(process)
        emulator.close()


def kill_while_charging(name: str, number: int, folder: Path) -> dict[str, float]:
    """All nodes of the simulated scene; the node dies while docking_node charges."""
    from deltacharger_bringup.client import ChargerClient
    from deltacharger_bringup.outcomes import DockRequest, Pose
    from deltacharger_bringup.scene import load_scene

    scene = load_scene("simulated")
    ports = {"servo": str(folder / "servo"), "board": str(folder / "board")}
    emulator = Emulator("world", folder)
    nodes = {each: start(each, scene.node_parameters(each, ports)) for each in scene.start_order()}
    try:
        with ChargerClient() as client:
            if not client.wait_until_ready(PATIENCE):
                raise NotCharging("the charger is not ready")
            outcome = client.dock(DockRequest(Pose(0.0, 0.0, 0.080)), deadline=180.0)
        if not outcome.success:
            raise NotCharging(f"docking failed: {outcome.error_message}")
        return strike(emulator, nodes[name], number)
    finally:
        for process in nodes.values():
            end(process)
        emulator.close()


def attempt(name: str, number: int, alone: bool) -> dict[str, float]:
    """One kill; where the charger did not come to charge, which is another matter, it is tried again."""
    for left in reversed(range(ATTEMPTS)):
        folder = Path(tempfile.mkdtemp(prefix="deltacharger-"))
        try:
            return kill_tactile(number, folder) if alone else kill_while_charging(name, number, folder)
        except NotCharging as error:
            print(f"{error}; attempts left: {left}", file=sys.stderr, flush=True)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    raise SystemExit("the charger never came to charge")


def run(tactile: int, dockings: int) -> list[dict[str, Any]]:
    """Return one row per node and signal."""
    import rclpy

    random.seed(SEED)
    rclpy.init()
    cases = [("tactile_node", "alone", tactile), *((name, "charging", dockings) for name in LIMITS)]
    rows = []
    for name, chain, rounds in cases:
        for number in SIGNALS if rounds else ():
            runs = []
            for turn in range(rounds):
                print(f"{name} {chain} {number.name} {turn + 1}/{rounds}", file=sys.stderr, flush=True)
                runs.append(attempt(name, number, chain == "alone"))
            times = [each["seconds"] for each in runs]
            rows.append(
                {
                    "load": os.getloadavg()[0],
                    "node": name,
                    "signal": number.name,
                    "chain": chain,
                    "runs": rounds,
                    "median_ms": 1e3 * statistics.median(times),
                    "largest_ms": 1e3 * max(times),
                    "limit_ms": 1e3 * LIMITS[name],
                    "silence_ms": 1e3 * max(each["silence"] for each in runs),
                    "emulator_pause_ms": 1e3 * max(each["pause"] for each in runs),
                }
            )
            print(show(rows[-1]), file=sys.stderr, flush=True)
    rclpy.shutdown()
    return rows


def show(row: dict[str, Any]) -> str:
    """Return a row in words."""
    return (
        f"{row['node']:<13} {row['signal']:<8} {row['chain']:<9} {row['runs']} runs: median {row['median_ms']:.0f} ms, "
        f"largest {row['largest_ms']:.0f} ms of {row['limit_ms']:.0f} ms; longest silence before an opening "
        f"{row['silence_ms']:.0f} ms, pause of the emulator {row['emulator_pause_ms']:.0f} ms, load {row['load']:.1f}"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tactile", type=int, default=10, help="kills of tactile_node alone, per signal")
    parser.add_argument("--dockings", type=int, default=1, help="kills of each node while charging, per signal")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    parser.add_argument("--emulate", choices=("bench", "world"), help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.emulate:
        emulate(arguments.emulate, arguments.folder)
        return 0
    rows = run(arguments.tactile, arguments.dockings)
    if arguments.json:
        print(json.dumps({"rows": rows}))
    else:
        print("\n".join(show(row) for row in rows))
    return 0 if all(row["largest_ms"] <= row["limit_ms"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
