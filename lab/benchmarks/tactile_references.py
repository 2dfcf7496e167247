# SPDX-License-Identifier: Apache-2.0
"""Benefit of reference dockings and of a hole in the ridge: `python lab/benchmarks/tactile_references.py`, a minute.

It uses simulated rigs 870-879, used nowhere else, and the paper's position set at 0.25 N, 67/33 by docking.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from deltacharger_lab.training.classifier import TrainableClassifier
from deltacharger_lab.training.splits import by_docking
from deltacharger_sim.pads import Rig, generate_paper, measure
from deltacharger_tactile.classifiers.labels import Examples, examples
from deltacharger_tactile.estimator import THRESHOLD
from deltacharger_tactile.parameters import TactileParameters

RIGS = range(870, 880)
NAMES = ("lda", "pose")
TARGET = "horizontal"
TILTS = (0.0, 0.06)  # degrees about y
REFERENCES = (0, 3, 10, 30)
MIDDLE = 2  # class without offset


def dockings(rig: Rig, offsets: np.ndarray, seed: int) -> np.ndarray:
    """Return frames (N, 2, 10, 10) N of dockings at horizontal offsets (N,) m."""
    pose = np.column_stack([offsets, np.zeros((len(offsets), 2))])
    measured = measure(TactileParameters(), rig, pose, np.random.default_rng(seed), 1, THRESHOLD)
    frames = np.stack([measured["left"], measured["right"]], axis=1)
    frames[measured["dead"]] = np.nan
    return frames


def trained(name: str, seed: int, family: TactileParameters | None = None) -> tuple[TrainableClassifier, Examples]:
    rows = examples(generate_paper(family, rigs=(seed,), seed=7, threshold=THRESHOLD), TARGET)
    learns, judges = by_docking(rows, 0)
    model = TrainableClassifier(name, TARGET, THRESHOLD).fit(rows.frames[learns], rows.labels[learns])
    return model, rows.part(judges)


def references(name: str, seed: int) -> list[list[float]]:
    """Return accuracy in % by tilt and number of reference dockings, on 300 dockings of one rig."""
    rig = Rig.draw(TactileParameters(), seed)
    wanted = np.repeat(np.arange(5), 60)
    table = []
    for tilt in TILTS:
        tilted = dataclasses.replace(rig, tilt=rig.tilt + np.array([0.0, math.radians(tilt)]))
        frames, known = dockings(tilted, 0.005 * wanted - 0.010, 3), dockings(tilted, np.zeros(max(REFERENCES)), 4)
        row = []
        for count in REFERENCES:
            model, _ = trained(name, seed)
            if count:
                model.refer(known[:count], np.full(count, MIDDLE))
            row.append(100.0 * float(np.mean(model.predict(frames) == wanted)))
        table.append(row)
    return table


def main() -> None:
    print(f"horizontal, {len(RIGS)} simulated rigs, accuracy in % after 0, 3, 10, 30 reference dockings at zero")
    for name in NAMES:
        mean = np.mean([references(name, seed) for seed in RIGS], axis=0)
        for tilt, row in zip(TILTS, mean, strict=True):
            print(f"  {name:5s} tilt {tilt:4.2f}°  " + "  ".join(f"{value:5.1f}" for value in row))
    print("horizontal, accuracy in % without and with a hole of 2.2 mm")
    base = TactileParameters()
    holed = dataclasses.replace(base, contact=dataclasses.replace(base.contact, hole=2.2e-3))
    for name in NAMES:
        row = []
        for family in (base, holed):
            pairs = [trained(name, seed, family) for seed in RIGS]
            row.append(100.0 * np.mean([np.mean(model.predict(rows.frames) == rows.labels) for model, rows in pairs]))
        print(f"  {name:5s}  {row[0]:5.1f}  {row[1]:5.1f}")


if __name__ == "__main__":
    main()
