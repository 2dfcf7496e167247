# SPDX-License-Identifier: Apache-2.0
"""Evaluates a classifier on frames that it has not seen."""

from __future__ import annotations

from typing import Any

import numpy as np

from deltacharger_tactile.classifiers import labels
from deltacharger_tactile.classifiers.classifier import Classifier
from deltacharger_tactile.classifiers.familiarity import WINDOW
from deltacharger_tactile.classifiers.labels import Examples
from deltacharger_tactile.classifiers.reliability import NOMINAL


def evaluate(model: Classifier, examples: Examples) -> dict[str, Any]:
    """Return accuracy, mean absolute error (rad or m), and the performance of conformal sets and drift check.

    `coverage` is the share of frames whose set holds the true class. `act_rate` is the share with exactly one class in
    the set and no drift. `drift_rate` is the share that look unlike training. All three are NaN without calibration.
    `drifted_together` is 1 if all frames together look unlike training, else 0; NaN if they are too few.
    """
    probabilities = model.predict_proba(examples.frames)
    found = np.argmax(probabilities, axis=1)
    result = {
        "target": model.target,
        "n": len(examples),
        "accuracy": float(np.mean(found == examples.labels)),
        "mean_absolute_error": float(np.mean(np.abs(labels.centres(model.target)[found] - examples.values))),
        "nominal": NOMINAL,
        "coverage": float("nan"),
        "act_rate": float("nan"),
        "drift_rate": float("nan"),
        "drifted_together": float("nan"),
    }
    reliability = model.reliability
    if reliability is not None:
        sets = reliability.sets(probabilities)
        drifted = reliability.familiar.strange(examples.frames, model.threshold)
        result["coverage"] = float(np.mean(sets[np.arange(len(examples)), examples.labels]))
        result["act_rate"] = float(np.mean((sets.sum(axis=1) == 1) & ~drifted))
        result["drift_rate"] = float(np.mean(drifted))
        if len(examples) >= WINDOW:
            result["drifted_together"] = float(reliability.drifted_together(examples.frames, model.threshold))
    return result
