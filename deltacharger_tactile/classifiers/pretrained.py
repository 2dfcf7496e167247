# SPDX-License-Identifier: Apache-2.0
"""What a classifier may stand on: packaged models that learnt from many rigs before it learns from the data of one."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_tactile import MODELS, PoseEstimator, default_model
from deltacharger_tactile.classifiers import files, runtime

POSE = 3
"""Columns of the estimated pose: mm, mm, degrees."""
_POSE_UNITS = np.array([1e3, 1e3, 180.0 / np.pi])


def inputs(frames: Array, target: str, threshold: float) -> Array:
    """Return (N, 3) the packaged estimate of the pose; from 1 N on also the packaged NN's last hidden layer (N, 128).

    Below 1 N that network, which learnt the paper's readings, adds nothing to the estimate.

    Args:
        frames: (N, 2, 10, 10) N, NaN where dead.
        target: what is to be told.
        threshold: readings below it count as 0, N.
    """
    pose = _estimator(threshold).pose(frames[:, 0], frames[:, 1]) * _POSE_UNITS
    if threshold < CONTACT_FORCE:
        return np.asarray(pose)
    taxels = np.where(frames >= threshold, frames, 0.0).reshape(len(frames), -1)
    return np.column_stack([pose, runtime.hidden(_network(target), taxels)])


@functools.cache
def _estimator(threshold: float) -> PoseEstimator:
    return default_model(threshold)


@functools.cache
def _network(target: str) -> Mapping[str, NDArray[Any]]:
    return files.read(MODELS / f"nn-{target}.npz")[1]
