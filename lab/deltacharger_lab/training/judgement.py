# SPDX-License-Identifier: Apache-2.0
"""Evaluates classifiers and pose estimators on dockings that they have not seen."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_lab.training import classifier, estimator, labels
from deltacharger_lab.training.reliability import NOMINAL, WINDOW
from deltacharger_tactile import dataset, errors

AXES = ("horizontal", "vertical", "angle")


def evaluate_classifier(model: classifier.TrainableClassifier, examples: labels.Examples) -> dict[str, Any]:
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


def evaluate_pose(model: estimator.TrainablePoseEstimator, data: dataset.Dataset) -> dict[str, Any]:
    """Return results for angle, vertical and horizontal, each as in `evaluate_classifier`.

    Errors (rad, m) are against the pose in contact if known, else the commanded one, over all rows with an estimate.
    `accuracy` is over the rows of `labels.rows`; a row without an estimate is wrong. `coverage` is the share of errors
    within the nominal interval, for estimates in range. `act_rate` is the share of `sure` rows, `drift_rate` the share
    of rows unlike training.

    Raises:
        DatasetError: the data have a higher threshold than the model.
    """
    if data.threshold > model.threshold:
        raise errors.DatasetError(
            "pose",
            f"the data are cut at {data.threshold:g} N and the model needs readings from {model.threshold:g} N on; "
            f"generate them with --threshold {model.threshold:g} or less",
        )
    left, right = data.robot_frames()
    estimate = model.predict(left, right)
    in_range, sure = np.asarray(estimate.in_range), np.asarray(estimate.sure)
    drift = float(np.mean(model.drifted(left, right)))
    result: dict[str, Any] = {"target": "pose", "n": len(data)}
    for axis, name in enumerate(AXES):
        found, spread = getattr(estimate, name), getattr(estimate, f"{name}_stddev")
        error = np.abs(found - data.poses()[:, axis])
        held = error[in_range] <= model.interval[axis] * spread[in_range]
        result[name] = {
            "target": name,
            "n": len(data),
            "accuracy": _accuracy(found, data, name),
            "mean_absolute_error": _mean(error[np.isfinite(error)]),
            "nominal": NOMINAL,
            "coverage": _mean(held),
            "act_rate": float(np.mean(sure)),
            "drift_rate": drift,
        }
    return result


def _accuracy(found: Array, data: dataset.Dataset, name: str) -> float:
    size = np.abs if name == "angle" else np.asarray
    rows, wanted = labels.rows(data, name)
    nearest = np.argmin(np.abs(np.nan_to_num(size(found[rows]), nan=np.inf)[:, None] - labels.centres(name)), axis=1)
    return _mean((nearest == wanted) & np.isfinite(found[rows]))


def _mean(values: NDArray[Any]) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
