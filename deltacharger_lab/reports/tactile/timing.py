# SPDX-License-Identifier: Apache-2.0
"""How long one prediction of each model takes, on numpy, one thread."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_lab.reports.tactile.measure import paper_set
from deltacharger_lab.reports.tactile.plan import TARGETS, TactilePlan
from deltacharger_tactile.classifiers import labels
from deltacharger_tactile.classifiers.classifier import Classifier

_WARM_UP = 20


def predictions(plan: TactilePlan, kept: str) -> list[dict[str, Any]]:
    """Return median and 99th percentile of single predictions, ms, of the models in a folder."""
    data = paper_set(plan.rigs[0], plan.seeds[0] + 1)
    found = []
    for target in TARGETS:
        frames = labels.examples(data, target).frames
        for name in plan.names:
            model = Classifier.load(Path(kept) / f"{name}-{target}.npz")
            times = np.array([_once(model, frames[index % len(frames)]) for index in range(plan.repeats + _WARM_UP)])
            median, slow = np.quantile(times[_WARM_UP:], (0.5, 0.99))
            found.append({"model": name, "target": target, "median_ms": float(median), "p99_ms": float(slow)})
    return found


def generation() -> float:
    """Return the s that a paper-size data set of one rig takes."""
    started = time.perf_counter()
    paper_set(0, 0)
    return time.perf_counter() - started


def timing(plan: TactilePlan, kept: str) -> dict[str, Any]:
    """Return every run time; the only work of this moment, in a process with one thread."""
    generation()  # what is loaded and allocated for the first time does not count
    return {"predictions": predictions(plan, kept), "generation_s": min(generation() for _ in range(3))}


def _once(model: Classifier, frame: Any) -> float:
    started = time.perf_counter()
    model.predict_proba(frame)
    return 1e3 * (time.perf_counter() - started)
