# SPDX-License-Identifier: Apache-2.0
"""Benefit of holes in the target's electrodes for docking: `python lab/benchmarks/holed_electrodes.py`, some minutes.

It runs dockings of the packaged campaign `random` in three versions: plain electrodes, a hole of 2.2 mm in each ridge
with the packaged pose model, and this hole with a model trained on such electrodes (on other rigs).
"""

from __future__ import annotations

import argparse
import functools
import math
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_lab.campaigns.docking import dock_once
from deltacharger_lab.campaigns.scene import load_campaign_scene
from deltacharger_lab.training.pose import train
from deltacharger_sim.virtual import virtual_charger
from deltacharger_tactile import PoseEstimator

HOLE = 2.2e-3  # m
load = functools.cache(PoseEstimator.load)


def dock(scene: str, seed: int, model: Path | None, number: int) -> dict[str, Any]:
    """Run one docking, with a trained model instead of the packaged one."""
    if model is not None:
        virtual_charger.packaged_model = functools.partial(load, model)
    return dock_once(load_campaign_scene(scene), seed, number)


def summary(rows: list[dict[str, Any]]) -> str:
    column = {name: np.array([row[name] for row in rows], dtype=float) for name in ("time", "moves", "contacts")}
    charged = np.array([row["charged"] for row in rows])
    first, last, rest = (
        np.array([row[name] for row in rows])[charged]
        for name in ("first_horizontal_error", "last_horizontal_error", "final_horizontal")
    )
    times = np.percentile(column["time"][charged], [50, 95])
    return "  ".join(
        (
            f"{100.0 * charged.mean():6.2f} %",
            f"{times[0]:5.1f} {times[1]:5.1f} s",
            f"{column['contacts'].mean():5.2f}",
            f"{1e3 * math.sqrt(np.nanmean(first**2)):5.2f} mm",
            f"{1e3 * math.sqrt(np.nanmean(last**2)):5.2f} mm",
            f"{1e3 * np.nanpercentile(np.abs(rest), 95):5.2f} mm",
            f"{sum(row['shorts'] for row in rows)}",
        )
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-n", type=int, default=2000, help="dockings of each row")
    parser.add_argument("--seed", type=int, default=61)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print("training on holed electrodes, about a minute", flush=True)
        trained = Path(folder) / "holed.npz"
        train(hole=HOLE).save(trained)
        print(
            f"{options.n} dockings each, seed {options.seed}: charged, time p50 p95, contacts, rms error along x of the"
        )
        print("first and last estimate, p95 of the offset at rest along x, shorts")
        for text, scene, model in (
            ("plain, packaged model", "random", None),
            ("hole, packaged model ", "holes", None),
            ("hole, its own model  ", "holes", trained),
        ):
            one = functools.partial(dock, scene, options.seed, model)
            with ProcessPoolExecutor() as workers:
                rows = list(workers.map(one, range(options.n), chunksize=25))
            print(f"  {text}  {summary(rows)}", flush=True)


if __name__ == "__main__":
    main()
