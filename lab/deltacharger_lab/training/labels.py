# SPDX-License-Identifier: Apache-2.0
"""The paper's classes of poses, and the rows of a data set for each of its three problems."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_tactile import dataset, errors, parameters

_ANGLE_STEP = np.radians(1.0)


@dataclass(frozen=True)
class Examples:
    """Examples for training or testing one classifier.

    Attributes:
        frames: (N, 2, 10, 10) N, tared and thresholded; NaN where dead.
        labels: (N,) class: rounded degrees of |angle|, or the step of −10 … 10 mm.
        values: (N,) commanded value, rad or m; for the angle its magnitude.
        groups: (N,) number of the docking; a split never separates its frames.
        rigs: (N,) seed of the device.
        sessions: (N,) number of the session.
    """

    frames: Array
    labels: NDArray[np.int64]
    values: Array
    groups: NDArray[np.int64]
    rigs: NDArray[np.int64]
    sessions: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.labels)

    def part(self, rows: NDArray[Any]) -> Examples:
        """Return the given rows (indices or mask)."""
        return Examples(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


def centres(target: str) -> Array:
    """Return the centre of each class: rad or m."""
    return (
        np.arange(parameters.ANGLE_CLASSES) * _ANGLE_STEP
        if target == "angle"
        else np.array(parameters.POSITION_CLASSES)
    )


def label(values: Array, target: str) -> NDArray[np.int64]:
    """Return the class of values (N,), |angle| in rad or an offset in m; −1 outside the paper's classes.

    Class k of the angle is |angle| within k ± 0.5°.
    """
    middle = centres(target)
    nearest = np.argmin(np.abs(values[:, None] - middle), axis=1)
    half = 0.5 * (middle[1] - middle[0])
    return np.where(np.abs(values - middle[nearest]) <= half + 1e-12, nearest, -1)


def rows(data: dataset.Dataset, target: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows of a target's set (angle or position) and their classes.

    From a continuous data set, use all rows within a class.
    """
    subset = dataset.SUBSET_ANGLE if target == "angle" else dataset.SUBSET_POSITION
    classes_of = label(_values(data, target), target)
    chosen = np.flatnonzero(((data.subset == subset) | (data.subset < 0)) & (classes_of >= 0))
    return chosen, classes_of[chosen]


def _values(data: dataset.Dataset, target: str) -> Array:
    commanded = np.asarray(getattr(data, target), dtype=float)
    return np.abs(commanded) if target == "angle" else commanded


def examples(data: dataset.Dataset, target: str) -> Examples:
    """Return the examples of a target.

    Raises:
        DatasetError: there are none.
    """
    chosen, known = rows(data, target)
    if not len(chosen):
        raise errors.DatasetError(target, "it has no rows; generate the data with --protocol paper, or use 'pose'")
    frames = np.stack(data.robot_frames(), axis=1)[chosen]
    columns = (data.attempt, data.rig, data.session)
    return Examples(frames, known, _values(data, target)[chosen], *(column[chosen] for column in columns))
