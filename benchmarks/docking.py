# SPDX-License-Identifier: Apache-2.0
"""How dockings end: the real state machine against the simulated world, in virtual time, on seeds of their own.

    python benchmarks/docking.py [--dockings 40] [--seed 5000] [--json]

For each band of target roll, and for both approaches on stiff and soft servos. Targets are offset by up to ±8 mm in x
and y and ±6 mm in z from where the goal says; every docking has another rig.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import statistics
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from deltacharger_bringup.campaign.docking import run
from deltacharger_bringup.campaign.draw import Drawn
from deltacharger_bringup.campaign.felt import EstimatorErrors
from deltacharger_bringup.virtual_charger import GOAL
from deltacharger_docking.observation import DockGoal
from deltacharger_docking.parameters import DockingParameters
from deltacharger_sim.parameters import ServoParameters, TargetParameters, WorldParameters
from deltacharger_tactile.parameters import TactileParameters

BANDS = ((0.0, 5.0), (5.0, 7.0), (7.0, 8.0), (8.0, 9.0), (9.0, 10.0), (10.0, 12.0), (12.0, 16.0))  # degrees
STIFFNESS = (2.5, 5.0, 10.0, 15.0, 20.0)  # N·m/rad


@dataclass
class Tally:
    """What happened in one group of dockings."""

    codes: Counter[str] = field(default_factory=Counter)
    times: list[float] = field(default_factory=list)
    moves: list[int] = field(default_factory=list)
    rest: list[float] = field(default_factory=list)
    in_band: int = 0
    shorts: int = 0
    unsafe: float = 0.0
    peak_push: float = 0.0

    def add(self, row: dict[str, Any]) -> None:
        self.codes[row["code_name"]] += 1
        self.shorts += row["shorts"]
        self.unsafe += row["energised_unsafe"]
        self.peak_push = max(self.peak_push, row["peak_push"])
        if row["charged"] and not math.isnan(row["final_misalignment"]):
            self.times.append(row["time"])
            self.moves.append(row["moves"])
            self.rest.append(1000 * row["final_misalignment"])
            self.in_band += 0.4 <= row["contact_current"] <= 0.5

    def summary(self) -> dict[str, Any]:
        count = sum(self.codes.values())
        charged = self.codes["NONE"]
        return {
            "n": count,
            "charged": charged / count,
            "refused": {name: n for name, n in sorted(self.codes.items()) if name != "NONE"},
            "in_band": self.in_band / charged if charged else math.nan,
            "time_median": statistics.median(self.times) if self.times else math.nan,
            "moves_median": statistics.median(self.moves) if self.moves else math.nan,
            "rest_mm_median": statistics.median(self.rest) if self.rest else math.nan,
            "rest_mm_max": max(self.rest, default=math.nan),
            "shorts": self.shorts,
            "energised_unsafe": self.unsafe,
            "peak_push": self.peak_push,
        }


def dock(number: int, roll: float, stiffness: float, approach: str, charge: bool) -> dict[str, Any]:
    """Run docking `number` on a target with `roll` (degrees), computing all that the nodes would."""
    draw = random.Random(number)
    target = TargetParameters(
        x=draw.uniform(-0.008, 0.008),
        y=draw.uniform(-0.008, 0.008),
        z=0.080 + draw.uniform(-0.006, 0.006),
        roll=math.radians(roll),
    )
    world = WorldParameters(target=target, servo=ServoParameters(stiffness=stiffness))
    parameters = DockingParameters(servo_stiffness=stiffness, approach=approach)
    drawn = Drawn(number, {}, world, TactileParameters(), parameters, GOAL, number, number, EstimatorErrors())
    return run(drawn, exact=True, goal=DockGoal(GOAL, start_charging=charge))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dockings", type=int, default=40, help="per group")
    parser.add_argument("--seed", type=int, default=5000, help="of the first docking")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    arguments = parser.parse_args()
    started, number = time.perf_counter(), arguments.seed
    groups: dict[str, Tally] = {}
    jobs = [(f"{low:g}–{high:g}°", low, high, None, "guarded") for low, high in BANDS]
    jobs += [(f"{way}, {k:g} N·m/rad", 0.0, 5.0, k, way) for way in ("guarded", "paper") for k in (2.5, 10.0, 20.0)]
    for name, low, high, stiffness, approach in jobs:
        tally = groups[name] = Tally()
        for _ in range(arguments.dockings):
            number += 1
            draw = random.Random(number)
            roll = draw.uniform(low, high) * draw.choice((-1, 1))
            tally.add(dock(number, roll, stiffness or draw.choice(STIFFNESS), approach, stiffness is None))
            print(f"\r{name}: {sum(tally.codes.values())}/{arguments.dockings}   ", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    summaries = {name: tally.summary() for name, tally in groups.items()}
    if arguments.json:
        print(json.dumps(summaries))
        return 0
    row = "{:<24}{:>9}{:>9}{:>8}{:>7}{:>9}{:>7}{:>8}  {}"
    print(row.format("group", "charged", "in band", "time s", "moves", "rest mm", "max", "shorts", "refused"))
    for name, each in summaries.items():
        rates = (f"{100 * each[key]:.1f}%" for key in ("charged", "in_band"))
        numbers = (f"{each[key]:.1f}" for key in ("time_median", "moves_median", "rest_mm_median", "rest_mm_max"))
        refused = ", ".join(f"{code} {count}" for code, count in each["refused"].items())
        print(row.format(name, *rates, *numbers, each["shorts"], refused))
    spent = (time.perf_counter() - started) / (number - arguments.seed)
    print(f"unsafe energised time {sum(each['energised_unsafe'] for each in summaries.values()):.3f} s in all dockings")
    print(f"{spent:.2f} s of computing per docking")
    return 0


if __name__ == "__main__":
    sys.exit(main())
