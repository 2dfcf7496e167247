# SPDX-License-Identifier: Apache-2.0
"""From poses to the paper's classes, and which rows of a data set belong to which of its three problems."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_tactile.dataset import ANGLE_CLASSES, POSITION_CLASSES, SUBSET_ANGLE, SUBSET_POSITION, Dataset
from deltacharger_tactile.errors import DatasetError

TARGETS = ("angle", "vertical", "horizontal")
_ANGLE_STEP = np.radians(1.0)


@dataclass(frozen=True)
class Examples:
    """What one classifier learns from or is judged by.

    Attributes:
        frames: (N, 2, 10, 10) N, tared and thresholded; NaN where dead.
        labels: (N,) class: whole degrees of |angle|, or the step of −10 … 10 mm.
        values: (N,) what was commanded, rad or m; of the angle its size.
        groups: (N,) number of the docking; frames of one docking never lie on both sides of a split.
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


def classes(target: str) -> int:
    """Return the number of classes of a target."""
    return ANGLE_CLASSES if target == "angle" else len(POSITION_CLASSES)


def centres(target: str) -> Array:
    """Return the middle of each class: rad or m."""
    return np.arange(ANGLE_CLASSES) * _ANGLE_STEP if target == "angle" else np.array(POSITION_CLASSES)


def label(values: Array, target: str) -> NDArray[np.int64]:
    """Return the class of values (N,), |angle| in rad or an offset in m; −1 where none of the paper's classes holds it.

    Class k of the angle is |angle| within k ± 0.5°.
    """
    middle = centres(target)
    nearest = np.argmin(np.abs(values[:, None] - middle), axis=1)
    half = 0.5 * (middle[1] - middle[0])
    return np.where(np.abs(values - middle[nearest]) <= half + 1e-12, nearest, -1)


def rows(data: Dataset, target: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return which rows belong to a target, and their classes: of the angle set, or of the position set.

    Of a continuous data set all rows within a class belong to it.
    """
    subset = SUBSET_ANGLE if target == "angle" else SUBSET_POSITION
    classes_of = label(_values(data, target), target)
    chosen = np.flatnonzero(((data.subset == subset) | (data.subset < 0)) & (classes_of >= 0))
    return chosen, classes_of[chosen]


def _values(data: Dataset, target: str) -> Array:
    commanded = np.asarray(getattr(data, target), dtype=float)
    return np.abs(commanded) if target == "angle" else commanded


def examples(data: Dataset, target: str) -> Examples:
    """Return the rows of a target.

    Raises:
        DatasetError: no row belongs to it.
    """
    chosen, known = rows(data, target)
    if not len(chosen):
        raise DatasetError(target, "no row belongs to it; generate the data with --protocol paper, or use 'pose'")
    frames = np.stack(data.robot_frames(), axis=1)[chosen]
    columns = (data.attempt, data.rig, data.session)
    return Examples(frames, known, _values(data, target)[chosen], *(column[chosen] for column in columns))
