"""From poses to the paper's classes, and which rows of a data set belong to which of its three problems."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_tactile.errors import DatasetError
from deltacharger_tactile.generator import (
    ANGLE_CLASSES,
    POSITION_CLASSES,
    SUBSET_ANGLE,
    SUBSET_POSITION,
    Dataset,
)

TARGETS = ("angle", "vertical", "horizontal")
_ANGLE_STEP = np.radians(1.0)


@dataclass(frozen=True)
class Examples:
    """What one classifier learns from or is judged by.

    Attributes:
        frames: (N, 2, 10, 10) N, tared and thresholded; 0 where dead.
        labels: (N,) class: whole degrees of |angle|, or the step of −10 … 10 mm.
        values: (N,) what was commanded, rad or m; of the angle its size.
        groups: (N,) number of the docking; frames of one docking never lie on both sides of a split.
        rigs: (N,) seed of the device.
        sessions: (N,) number of the session.
    """

    frames: NDArray[np.float64]
    labels: NDArray[np.int64]
    values: NDArray[np.float64]
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


def centres(target: str) -> NDArray[np.float64]:
    """Return the middle of each class: rad or m."""
    return np.arange(ANGLE_CLASSES) * _ANGLE_STEP if target == "angle" else np.array(POSITION_CLASSES)


def label(values: NDArray[np.float64], target: str) -> NDArray[np.int64]:
    """Return the class of values (N,), |angle| in rad or an offset in m; −1 where none of the paper's classes holds it.

    Class k of the angle is |angle| within k ± 0.5°.
    """
    middle = centres(target)
    nearest = np.argmin(np.abs(values[:, None] - middle), axis=1)
    half = 0.5 * (middle[1] - middle[0])
    return np.where(np.abs(values - middle[nearest]) <= half + 1e-12, nearest, -1)


def examples(data: Dataset, target: str) -> Examples:
    """Return the rows of the paper's protocol that belong to a target: the angle set, or the position set.

    Of a continuous data set all rows within a class count.

    Raises:
        DatasetError: no row belongs to it.
    """
    subset = SUBSET_ANGLE if target == "angle" else SUBSET_POSITION
    commanded = np.asarray(getattr(data, target), dtype=float)
    values = np.abs(commanded) if target == "angle" else commanded
    labels = label(values, target)
    rows = np.flatnonzero(((data.subset == subset) | (data.subset < 0)) & (labels >= 0))
    if not len(rows):
        raise DatasetError(target, "no row belongs to it; generate the data with --protocol paper, or use 'pose'")
    frames = np.stack([data.left, data.right], axis=1).astype(float)
    return Examples(frames[rows], labels[rows], values[rows], data.attempt[rows], data.rig[rows], data.session[rows])
