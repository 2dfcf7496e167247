# SPDX-License-Identifier: Apache-2.0
"""What the laboratory's own classifiers see: physical features, estimated pose, and outputs of packaged models."""

import functools
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core import arrays, machine
from deltacharger_tactile import PoseEstimator, default_model, features, model_path
from deltacharger_tactile.classifiers import classifier, runtime
from deltacharger_tactile.classifiers.classifier import MODELS

NAMES = dict.fromkeys(MODELS, "taxels") | {"lda": "features", "pose": "pose"}
"""Inputs of each: all taxels, features, or features and the outputs of `PRETRAINED`."""
PRETRAINED = "pretrained"
"""Key in a file: digest of the packaged models used in training."""
POSE = 3
"""Columns of the estimated pose: mm, mm, degrees."""
_POSE_UNITS = np.array([1e3, 1e3, 180.0 / np.pi])


def inputs(frames: arrays.Array, target: str, threshold: float) -> arrays.Array:
    """Return physical features, the estimated pose, and from 1 N on the last hidden layer of the packaged NN.

    Below 1 N that network adds nothing to the estimate: it was trained on the paper's readings.

    Args:
        frames: (N, 2, 10, 10) N, NaN where dead.
        target: what to classify.
        threshold: readings below it count as 0, N.

    Returns:
        (N, F + 3) or (N, F + 3 + 128); NaN unknown.
    """
    found = _estimator(threshold).predict(frames[:, 0], frames[:, 1])
    pose = np.column_stack([found.horizontal, found.vertical, found.angle])
    physical = features.extract(features.fill_dead(frames), threshold).values
    known = [physical, pose * _POSE_UNITS]
    if threshold >= machine.CONTACT_FORCE:
        taxels = np.where(frames >= threshold, frames, 0.0).reshape(len(frames), -1)
        known.append(runtime.hidden(_network(target), taxels))
    return np.concatenate(known, axis=1)


@functools.cache
def digest(target: str, threshold: float) -> str:
    """Return 16 hexadecimal digits that change with the packaged models that `inputs` asks."""
    paths = [model_path(threshold)]
    if threshold >= machine.CONTACT_FORCE:
        paths.append(_network_path(target))
    found = hashlib.sha256()
    for path in paths:
        found.update(path.read_bytes())
    return found.hexdigest()[:16]


@functools.cache
def _estimator(threshold: float) -> PoseEstimator:
    return default_model(threshold)


@functools.cache
def _network(target: str) -> Mapping[str, NDArray[Any]]:
    return runtime.read(_network_path(target))[1]


def _network_path(target: str) -> Path:
    return classifier.path("nn", target)
