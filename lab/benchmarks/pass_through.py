# SPDX-License-Identifier: Apache-2.0
"""Time of a servo cycle (write three goals, read all states), for each connection.

- adapter: the servos' port itself;
- emulated board: through the board link, beside 120 tactile frames per second;
- firmware: through the host program of firmware/, at 1 Mbaud to the computer. Needs a C compiler.

Servos answer after the time of their bytes at 1 Mbit/s. Cycles are measured back to back, the connections in turn.

python lab/benchmarks/pass_through.py [--cycles 500] [--json]
"""

import argparse
import contextlib
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import driver_processes as processes
import numpy as np
from driver_processes import Figure

from deltacharger_core.machine import BAUD_RATE
from deltacharger_driver.board.keeper import BoardKeeper
from deltacharger_driver.ports import PseudoTerminal
from deltacharger_driver.servos.bus import ServoBus
from deltacharger_driver.servos.registers import BusSettings
from deltacharger_sim import parameters, world
from deltacharger_sim.emulators.board import BoardEmulator
from deltacharger_sim.emulators.servo_bus import ServoBusEmulator

ANGLES, CURRENTS = (-0.7, -0.5, -0.2), (0.3, 0.3, 0.3)
ROUNDS = 5
ON_THE_WIRE = 0.5e-3  # s of instruction and reply at 1 Mbit/s
FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"


def new_servos() -> ServoBusEmulator:
    servos = ServoBusEmulator(world.SharedWorld(world.World(parameters.WorldParameters())))
    servos.faults.delay = ON_THE_WIRE
    return servos


@contextlib.contextmanager
def adapter(folder: Path) -> Iterator[str]:
    with PseudoTerminal(new_servos(), folder / "servos") as cable:
        yield cable.path


@contextlib.contextmanager
def behind(board: str, folder: Path) -> Iterator[str]:
    """Yield the port that tactile_node would provide."""
    port = folder / "servos"
    keeper = BoardKeeper(board, 120.0, *[lambda *_: None] * 3, port)
    keeper.start()
    try:
        while not port.exists():
            time.sleep(0.01)
        yield str(port)
    finally:
        keeper.close()


@contextlib.contextmanager
def emulated_board(folder: Path) -> Iterator[str]:
    board = BoardEmulator(world.SharedWorld(world.World(parameters.WorldParameters())), servos=new_servos())
    with PseudoTerminal(board, folder / "board") as cable, behind(cable.path, folder) as port:
        yield port


@contextlib.contextmanager
def firmware(folder: Path) -> Iterator[str]:
    built = ["make", "-s", "-C", str(FIRMWARE), f"BUILD={folder / 'build'}", str(folder / "build" / "board_host")]
    subprocess.run(built, check=True)
    with PseudoTerminal(new_servos(), folder / "bus") as bus:
        command = [folder / "build" / "board_host", "--servos", bus.path, "--pty", folder / "board"]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as board:
            assert board.stdout is not None
            assert board.stdin is not None
            board.stdout.readline()
            board.stdin.write(f"baud {BAUD_RATE}\n")
            board.stdin.flush()
            try:
                with behind(str(folder / "board"), folder) as port:
                    yield port
            finally:
                board.communicate("quit\n")


WAYS = {"adapter": adapter, "emulated board": emulated_board, "firmware": firmware}


def cycles(port: str, count: int) -> list[float]:
    """Return the time of each of `count` cycles, s; NaN if a servo did not answer."""
    bus, times = ServoBus(BusSettings(port)), []
    bus.open()
    try:
        bus.enable_torque(CURRENTS)
        for _ in range(count):
            began = time.perf_counter()
            complete = bus.exchange(ANGLES, CURRENTS).complete
            times.append(time.perf_counter() - began if complete else float("nan"))
        bus.disable_torque()
    finally:
        bus.close()
    return times


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=int, default=500, help="cycles of each connection per round")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    arguments = parser.parse_args()
    times: dict[str, list[float]] = {name: [] for name in WAYS}
    with contextlib.ExitStack() as stack:
        ports = {name: stack.enter_context(way(stack.enter_context(processes.folder()))) for name, way in WAYS.items()}
        for each in range(ROUNDS):
            for name, port in ports.items():
                times[name] += cycles(port, arguments.cycles)
            processes.progress(f"round {each + 1} of {ROUNDS}")
    figures = []
    for name, all_times in times.items():
        taken = 1e3 * np.array(all_times)
        figures += [
            Figure(f"{name}: a cycle, median", float(np.nanmedian(taken)), "ms"),
            Figure(f"{name}: a cycle, 99 %", float(np.nanpercentile(taken, 99.0)), "ms"),
            Figure(f"{name}: cycles above 16.7 ms (60 Hz)", int(np.sum(taken > 1e3 / 60.0)), f"of {taken.size}"),
            Figure(f"{name}: cycles without all servos", int(np.isnan(taken).sum()), f"of {taken.size}"),
        ]
    processes.print_figures(figures, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
