# SPDX-License-Identifier: Apache-2.0
"""Our and the paper's models at one threshold on the same data; gain of lower thresholds and pretraining."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_lab.reports.tactile.measure import fitted, paper_set
from deltacharger_lab.reports.tactile.plan import TARGETS, threshold
from deltacharger_lab.training import splits
from deltacharger_tactile import default_model
from deltacharger_tactile.classifiers import labels
from deltacharger_tactile.classifiers.labels import Examples
from deltacharger_tactile.estimator import THRESHOLD

ESTIMATE = ""
WAYS: tuple[tuple[str, str, float], ...] = (
    ("NN, taxels", "nn", CONTACT_FORCE),
    ("CNN, taxels", "cnn", CONTACT_FORCE),
    ("LDA, physical features", "lda", CONTACT_FORCE),
    ("pose: features and the pretrained estimate", "pose", CONTACT_FORCE),
    ("the pretrained estimate alone", ESTIMATE, CONTACT_FORCE),
    ("LDA, physical features", "lda", THRESHOLD),
    ("pose: features and the pretrained estimate", "pose", THRESHOLD),
    ("the pretrained estimate alone", ESTIMATE, THRESHOLD),
)
"""Name of a row, the model that learns (`ESTIMATE`: none), and the smallest reading that counts, N."""


def compare(rig: int, seed: int) -> list[dict[str, Any]]:
    """Return correct and abstained shares by target of each row that the table of all models lacks."""
    known, rows = paper_set(rig, seed), []
    for _, model, cut in WAYS:
        if model and cut == threshold(model):
            continue
        row: dict[str, Any] = {"model": model, "threshold": cut}
        for target in TARGETS:
            examples = labels.examples(known, target)
            predicted = _learnt(model, examples, target, cut, seed) if model else _estimated(examples, target, cut)
            row[target] = float(np.mean(predicted == examples.labels))
            row[f"{target} abstained"] = float(np.mean(predicted < 0))
        rows.append(row)
    return rows


def table(measured: Sequence[dict[str, Any]], accuracy: dict[str, Any]) -> list[dict[str, Any]]:
    """Return all rows: means of `compare`, and the results of all models on the same dockings."""
    found = []
    for text, model, cut in WAYS:
        rows = [row for row in measured if (row["model"], row["threshold"]) == (model, cut)]
        if rows:
            shares = {key: float(np.mean([row[key] for row in rows])) for key in rows[0] if key not in _NO_SHARES}
        elif model in accuracy:
            shares = {target: accuracy[model][target]["mean"] for target in TARGETS}
        else:
            continue
        found.append({"name": text, "model": model, "threshold": cut, **shares})
    return found


_NO_SHARES = ("model", "threshold")


def _learnt(model: str, examples: Examples, target: str, cut: float, seed: int) -> NDArray[np.int64]:
    """Return the class (N,) from a model trained on the other two thirds."""
    predicted = np.empty(len(examples), dtype=np.int64)
    for learns, judges in splits.thirds(examples, seed):
        predicted[judges] = fitted(model, target, examples.part(learns), seed, cut).predict(examples.frames[judges])
    return predicted


def _estimated(examples: Examples, target: str, cut: float) -> NDArray[np.int64]:
    """Return the class (N,) nearest to the packaged model's estimate; −1 if that is out of range by its own rule."""
    found = default_model(cut).predict(examples.frames[:, 0], examples.frames[:, 1])
    value = np.abs(found.angle) if target == "angle" else np.asarray(getattr(found, target))
    nearest = np.argmin(np.abs(np.nan_to_num(value)[:, None] - labels.centres(target)), axis=1)
    return np.where(found.in_range, nearest, -1)
