# SPDX-License-Identifier: Apache-2.0
"""How often a held charge ends beside busy programs, with and without permission for real-time priority.

The simulated charger runs as under `ros2 launch`: its hardware and each node are processes of their own. Beside it
programs spin at niceness 19. A held charge should end by its stop condition. An end before that has a code; unsafe are
seconds that the simulated world records as energised without clearance, shorts, and live electrodes that parted.

Run no other programs during the measurement: they are load. An hour with the usual numbers.

python lab/benchmarks/held_charges.py [--charges 6] [--seconds 300] [--busy 4] [--json]
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import driver_processes as processes
from driver_processes import CannotMeasure, Figure

from deltacharger_core import environment

environment.prepare()
environment.isolate()

MORE = 120.0  # s that docking may take
NICEST = 19
RECORD = "world.json"
UNSAFE = ("energised_shorts", "energised_unsafe", "parted_live")  # of the world's record
_DROP_FOR_CHILDREN, _MAY_HAVE_PRIORITY = 24, 23  # PR_CAPBSET_DROP and CAP_SYS_NICE of Linux


def held_charge(scene: Any, seconds: float, busy: int) -> tuple[str, float]:
    """Hold a charge for this time beside `busy` programs; return the code's name ('' = held), and what was unsafe.

    Raises:
        CannotMeasure: the charger does not start.
    """
    from deltacharger_ros.client import ChargerClient
    from deltacharger_ros.outcomes import DockRequest, Pose

    with processes.folder() as folder:
        with contextlib.ExitStack() as stack:
            stack.enter_context(hardware(folder))
            stack.enter_context(processes.nodes_of(scene, {name: str(folder / name) for name in ("servo", "board")}))
            client = stack.enter_context(ChargerClient())
            if not client.wait_until_ready(processes.PATIENCE):
                raise CannotMeasure("the charger is not ready")
            for _ in range(busy):
                stack.enter_context(processes.busy(NICEST))
            request = DockRequest(Pose(0.0, 0.0, 0.080), hold=True, stop_after=seconds)
            outcome = client.dock(request, deadline=seconds + MORE)
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    processes.progress(f"  {outcome.error_message or 'held'}; load {os.getloadavg()[0]:.1f}")
    return ("" if outcome.success else outcome.error_name), sum(float(record[name]) for name in UNSAFE)


@contextlib.contextmanager
def hardware(folder: Path) -> Iterator[None]:
    """Run the emulated hardware with its ports in a folder; at its end it writes the world's record there."""
    words = ("simulate", "--directory", str(folder), "--record", str(folder / RECORD), "--as-node")
    command = [sys.executable, "-m", "deltacharger_bringup.cli", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        try:
            if not any(line.strip() == "ready" for line in process.stdout):
                raise CannotMeasure("the emulated hardware did not start")
            yield
        finally:
            process.terminate()
            process.communicate()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--charges", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=300.0, help="time of charging")
    parser.add_argument("--busy", type=int, default=4, help="programs that spin")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    arguments = parser.parse_args()
    from deltacharger_scenes.scene import load_scene

    figures = []
    for permitted in (True, False):
        if not permitted:  # for all processes from now on
            ctypes.CDLL(None).prctl(_DROP_FOR_CHILDREN, _MAY_HAVE_PRIORITY, 0, 0, 0)
        what = f"{arguments.busy} busy, real time {'' if permitted else 'not '}permitted: "
        processes.progress(what)
        charges = [
            held_charge(load_scene("simulated"), arguments.seconds, arguments.busy) for _ in range(arguments.charges)
        ]
        codes = [code for code, _ in charges if code]
        named = f" ({', '.join(codes)})" if codes else ""
        figures += [
            Figure(f"{what}charges that ended{named}", len(codes), f"of {len(charges)}"),
            Figure(f"{what}unsafe", sum(unsafe for _, unsafe in charges), ""),
        ]
    processes.print_figures(figures, arguments.json, cores=os.cpu_count(), seconds=arguments.seconds)
    return 0


if __name__ == "__main__":
    sys.exit(main())
