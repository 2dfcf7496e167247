# SPDX-License-Identifier: Apache-2.0
"""Ours and the paper's models at one threshold and on the same data; then what lower thresholds and pretraining add."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_lab.reports.tactile.measure import fitted, paper_set
from deltacharger_lab.reports.tactile.plan import TARGETS, TactilePlan
from deltacharger_tactile import default_model
from deltacharger_tactile.classifiers import labels, splits
from deltacharger_tactile.classifiers.labels import Examples
from deltacharger_tactile.estimator import THRESHOLD

ESTIMATE = ""
WAYS: tuple[tuple[str, str, float], ...] = tuple(
    (text, model, cut)
    for cut in (CONTACT_FORCE, THRESHOLD)
    for text, model in (
        ("NN, taxels", "nn"),
        ("CNN, taxels", "cnn"),
        ("LDA, physical features", "lda"),
        ("pose: features and pretrained estimate", "pose"),
        ("the pretrained estimate alone", ESTIMATE),
    )
)
"""What a row is called, which model learns (`ESTIMATE`: none), and the least reading that counts, N."""


def compare(rig: int, seed: int, plan: TactilePlan) -> list[dict[str, Any]]:
    """Return for every way the share told right by target, and the share on which it abstains; each third judged."""
    known = paper_set(rig, seed)
    rows: list[dict[str, Any]] = []
    for text, model, cut in WAYS:
        if model and model not in plan.names:
            continue
        row: dict[str, Any] = {"name": text, "model": model, "threshold": cut, "rig": rig}
        for target in TARGETS:
            examples = labels.examples(known, target)
            told = _estimated(examples, target, cut) if not model else _learnt(model, examples, target, cut, seed)
            row[target] = float(np.mean(told == examples.labels))
            row[f"{target} abstained"] = float(np.mean(told < 0))
        rows.append(row)
    return rows


def _learnt(model: str, examples: Examples, target: str, cut: float, seed: int) -> NDArray[np.int64]:
    """Return the class (N,) that a model tells which has learnt from the other two thirds."""
    told = np.empty(len(examples), dtype=np.int64)
    for learns, judges in splits.thirds(examples, seed):
        told[judges] = fitted(model, target, examples.part(learns), seed, cut).predict(examples.frames[judges])
    return told


def _estimated(examples: Examples, target: str, cut: float) -> NDArray[np.int64]:
    """Return the class (N,) nearest to the packaged model's estimate; −1 where that is out of range by its own rule."""
    found = default_model(cut).predict(examples.frames[:, 0], examples.frames[:, 1])
    value = np.abs(found.angle) if target == "angle" else np.asarray(getattr(found, target))
    nearest = np.argmin(np.abs(np.nan_to_num(value)[:, None] - labels.centres(target)), axis=1)
    return np.where(found.in_range, nearest, -1)
