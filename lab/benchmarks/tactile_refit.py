# SPDX-License-Identifier: Apache-2.0
"""Accuracy of the paper's networks on the generator's defaults: `python lab/benchmarks/tactile_refit.py`, 2 minutes.

The defaults were fitted once, only on these rigs and this seed, before any estimator was tuned, so that these networks
reach about the paper's accuracy. `--write` stores them with the measured values in deltacharger_tactile/frozen.json.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import deltacharger_tactile
from deltacharger_lab.training.classifier import TrainableClassifier
from deltacharger_lab.training.splits import thirds
from deltacharger_sim.pads import generate_paper
from deltacharger_tactile.classifiers.labels import examples
from deltacharger_tactile.parameters import TactileParameters

RIGS = range(500, 510)
SEED = 7
SPLIT = 0
"""Of the thirds that are held out in turn."""
FITTED = ("angle_jitter", "position_jitter", "tilt_spread")
AIMS = {("cnn", "angle"): 95.46, ("cnn", "vertical"): 98.2, ("cnn", "horizontal"): 86.9, ("nn", "horizontal"): 87.9}
"""Accuracy in the paper, per cent."""


def measure_rig(parameters: TactileParameters, rig: int) -> dict[tuple[str, str], float]:
    """Return each network's accuracy in % on a rig's 600 + 500 pairs, 67/33 by docking, each third held out once."""
    import torch

    torch.set_num_threads(1)
    data = generate_paper(parameters, rigs=(rig,), seed=SEED)
    found = {}
    for name, target in AIMS:
        rows = examples(data, target)
        right = []
        for learns, judges in thirds(rows, SPLIT):
            model = TrainableClassifier(name, target).fit(rows.frames[learns], rows.labels[learns])
            right.append(model.predict(rows.frames[judges]) == rows.labels[judges])
        found[name, target] = 100.0 * float(np.mean(np.concatenate(right)))
    return found


def measure(parameters: TactileParameters) -> dict[tuple[str, str], list[float]]:
    """Return the accuracy in per cent of each network on each rig."""
    found: dict[tuple[str, str], list[float]] = {case: [] for case in AIMS}
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        for rig, each in zip(RIGS, pool.map(partial(measure_rig, parameters), RIGS), strict=True):
            print(f"rig {rig}", *(f"{value:.1f}" for value in each.values()), flush=True)
            for case, value in each.items():
                found[case].append(value)
    return found


def frozen(found: dict[tuple[str, str], list[float]]) -> dict[str, Any]:
    parameters = TactileParameters()
    accuracy = {
        f"{name} {target}": {
            "paper": AIMS[name, target],
            "mean": round(float(np.mean(values)), 2),
            "standard_error": round(float(np.std(values, ddof=1)) / len(values) ** 0.5, 2),
        }
        for (name, target), values in found.items()
    }
    return {
        "digest": parameters.digest(),
        "parameters": json.loads(parameters.to_json()),
        "fitted": [f"docking.{name}" for name in FITTED],
        "fitted_on": {"rigs": [RIGS[0], RIGS[-1]], "seed": SEED, "split": SPLIT, "protocol": "paper"},
        "simulated_accuracy_percent": accuracy,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="store the defaults with the measured values")
    for name in FITTED:
        parser.add_argument(f"--{name.replace('_', '-')}", type=float, help="another value, m or rad (not written)")
    options = parser.parse_args()
    base = TactileParameters()
    tried = {name: value for name in FITTED if (value := getattr(options, name)) is not None}
    write = options.write and not tried
    result = frozen(measure(dataclasses.replace(base, docking=dataclasses.replace(base.docking, **tried))))
    for case, values in result["simulated_accuracy_percent"].items():
        print(f"{case:16s} {values['mean']:6.2f} ± {values['standard_error']:.2f} %   paper {values['paper']:.2f} %")
    if write:
        path = Path(deltacharger_tactile.__file__).parent / "frozen.json"
        path.write_text(json.dumps(result, indent=2) + "\n")
        print(f"{path}: digest {result['digest']}")


if __name__ == "__main__":
    main()
