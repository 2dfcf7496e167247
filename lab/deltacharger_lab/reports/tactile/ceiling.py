# SPDX-License-Identifier: Apache-2.0
"""Best possible accuracy of one docking, and ways beyond it: more dockings, a hole in the electrode.

Each row of the section is a function of (rig, seed, plan) that returns accuracies by target; `ROWS` lists them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from deltacharger_lab.reports.tactile import fusion
from deltacharger_lab.reports.tactile.measure import accuracy, fitted, paper_set
from deltacharger_lab.reports.tactile.plan import TARGETS, TactilePlan, default, title
from deltacharger_lab.reports.tactile.shifts import changed
from deltacharger_lab.training import splits
from deltacharger_sim.pads.generator import generate_paper
from deltacharger_tactile.classifiers import labels
from deltacharger_tactile.classifiers.classifier import Classifier
from deltacharger_tactile.classifiers.labels import Examples
from deltacharger_tactile.dataset import Dataset
from deltacharger_tactile.parameters import TactileParameters

Row = dict[str, Any]
HOLE = 2.2e-3
"""Diameter of the hole, m, in the middle of each ridge."""
FUSED = (1, 2, 3, 5)
"""Dockings at one commanded pose whose probabilities are multiplied."""
CEILING = "ceiling of one docking"


def ceiling(rig: int, seed: int, plan: TactilePlan) -> list[Row]:
    """Judge the best of the models that can learn from much data of the same rig in time."""
    many = [paper_set(rig, 1000 + 100 * seed + index) for index in range(plan.ceiling_sets)]
    fresh = paper_set(rig, 900 + seed)
    row: Row = {"name": CEILING, "about": f"the same rig, {plan.ceiling_sets} times the paper's data, best model"}
    for target in TARGETS:
        parts = [labels.examples(data, target) for data in many]
        columns = ([getattr(each, name) for each in parts] for name in Examples.__dataclass_fields__)
        rows = Examples(*map(np.concatenate, columns))
        judged = labels.examples(fresh, target)
        names = [name for name in ("lda", "pose", "forest") if name in plan.names]
        row[target] = max(accuracy(fitted(name, target, rows, seed), judged) for name in names)
    return [row]


def several_dockings(rig: int, seed: int, plan: TactilePlan) -> list[Row]:
    """Judge the product of the probabilities of several dockings at one commanded pose."""
    name = default(plan)
    known, fresh = paper_set(rig, seed), [paper_set(rig, 800 + 10 * seed + index) for index in range(2)]
    rows: list[Row] = [
        {"name": f"{count} docking{'s' if count > 1 else ''}, {title(name)}", "about": "fused"} for count in FUSED
    ]
    for target in TARGETS:
        model = _learnt(name, target, known, seed)
        for row, count in zip(rows, FUSED, strict=True):
            row[target] = float(np.mean([_fused(model, labels.examples(data, target), count, seed) for data in fresh]))
    return rows


def hole(rig: int, seed: int, plan: TactilePlan) -> list[Row]:
    """Judge with a hole in the electrodes, the paper's idea, and without."""
    found = []
    drilled = changed("contact", hole=HOLE)
    for text, family in (("no hole", TactileParameters()), (f"hole of {1e3 * HOLE:g} mm", drilled)):
        known, fresh = (
            generate_paper(family, rigs=(rig,), seed=number, threshold=0.0) for number in (seed, 600 + seed)
        )
        for name in ("lda", "cnn"):
            if name in plan.names:
                found.append(_row(f"{title(name)}, {text}", name, known, fresh, seed))
    return found


ROWS: tuple[Callable[[int, int, TactilePlan], list[Row]], ...] = (ceiling, several_dockings, hole)
"""Rows of the section."""


def _row(text: str, name: str, known: Dataset, fresh: Dataset, seed: int) -> Row:
    row: Row = {"name": text, "about": ""}
    for target in TARGETS:
        row[target] = accuracy(_learnt(name, target, known, seed), labels.examples(fresh, target))
    return row


def _learnt(name: str, target: str, known: Dataset, seed: int) -> Classifier:
    rows = labels.examples(known, target)
    return fitted(name, target, rows.part(splits.by_docking(rows, seed)[0]), seed)


def _fused(model: Classifier, rows: Examples, count: int, seed: int) -> float:
    chosen = fusion.groups(rows, count, seed)
    shares = model.predict_proba(rows.frames).reshape(len(rows), -1)
    right = fusion.together(shares[chosen]).argmax(axis=1) == rows.labels[chosen[0]]
    return float(np.mean(right))
