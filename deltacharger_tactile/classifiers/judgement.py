# SPDX-License-Identifier: Apache-2.0
"""How good a classifier is on frames that it has not seen."""

from __future__ import annotations

from typing import Any

import numpy as np

from deltacharger_tactile.classifiers import labels
from deltacharger_tactile.classifiers.classifier import Classifier
from deltacharger_tactile.classifiers.familiarity import WINDOW
from deltacharger_tactile.classifiers.labels import Examples
from deltacharger_tactile.classifiers.reliability import NOMINAL


def evaluate(model: Classifier, examples: Examples) -> dict[str, Any]:
    """Return accuracy, mean absolute error (rad or m), and how its conformal sets and its drift check do.

    `coverage` is the share of frames whose set holds the true class, `act_rate` that of frames with one class alone in
    the set and no drift, `drift_rate` that of frames that look like none of training; NaN where the model was not
    calibrated. `drifted_together` is 1 where all frames together look so, 0 where not, NaN where they are too few.
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
