# SPDX-License-Identifier: Apache-2.0
"""Which frames teach something, and splits into training and test frames by docking, as in the paper."""

import numpy as np
from numpy.typing import NDArray

from deltacharger_core import arrays, machine
from deltacharger_lab.training.labels import Examples

Rows = NDArray[np.int64]

PAPER_SHARE = 0.67
"""Share of the dockings that the paper trains with."""


def distinct(frames: arrays.Array, threshold: float) -> Rows:
    """Return the rows of frames (N, 2, 10, 10) N that are in contact and repeat no earlier row; NaN is no contact.

    Only these teach something: pads that touch nothing and a board that repeats itself give the same for every pose.
    """
    seen = np.where(frames >= threshold, frames, 0.0).astype(np.float32)  # as data sets store
    seen = seen.reshape(-1, machine.PADS * machine.ROWS * machine.COLUMNS)
    _, first = np.unique(seen, axis=0, return_index=True)
    return np.sort(first[seen[first].any(axis=1)])


def by_docking(examples: Examples, seed: int, share: float = PAPER_SHARE) -> tuple[Rows, Rows]:
    """Split at random by docking; with one frame per docking, this is the paper's split.

    Args:
        examples: to split.
        seed: of the split.
        share: of the dockings, for training.

    Returns:
        rows for training, rows for testing.
    """
    random = np.random.default_rng([0x59117, seed])
    groups = np.unique(examples.groups)
    chosen = random.permutation(groups)[: round(share * len(groups))]
    learns = np.isin(examples.groups, chosen)
    return np.flatnonzero(learns), np.flatnonzero(~learns)


def thirds(examples: Examples, seed: int) -> list[tuple[Rows, Rows]]:
    """Return three splits 67/33 by docking, in which each docking is tested once; arguments of `by_docking`."""
    random = np.random.default_rng([0x3D5, seed])
    parts = np.array_split(random.permutation(np.unique(examples.groups)), 3)
    judged = [np.isin(examples.groups, part) for part in parts]
    return [(np.flatnonzero(~rows), np.flatnonzero(rows)) for rows in judged]
