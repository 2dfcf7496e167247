# SPDX-License-Identifier: Apache-2.0
"""Splits into training and test frames: by docking, device or session, or at random as in the paper."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deltacharger_tactile.classifiers.labels import Examples
from deltacharger_tactile.errors import DatasetError

Rows = NDArray[np.int64]

PAPER_SHARE = 0.67
"""Share of the dockings that the paper trains with."""


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


def by_frame(examples: Examples, seed: int, share: float = PAPER_SHARE) -> tuple[Rows, Rows]:
    """Split frames at random, ignoring dockings; optimistic if a docking has several frames."""
    order = np.random.default_rng([0xF4A3E, seed]).permutation(len(examples))
    count = round(share * len(order))
    return np.sort(order[:count]), np.sort(order[count:])


def leave_one_out(examples: Examples, what: str) -> list[tuple[Rows, Rows]]:
    """Return one split for each rig or session, which alone is the test set.

    Args:
        examples: to split.
        what: `rigs` or `sessions`.

    Raises:
        DatasetError: there is only one.
    """
    owners = getattr(examples, what)
    every = np.unique(owners)
    if len(every) < 2:
        raise DatasetError(what, "there is only one; generate or record more of them")
    return [(np.flatnonzero(owners != owner), np.flatnonzero(owners == owner)) for owner in every]
