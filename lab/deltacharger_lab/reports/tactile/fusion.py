# SPDX-License-Identifier: Apache-2.0
"""Combines several dockings at one place.

Every docking draws new jitter, tilt and hysteresis. Another docking therefore helps, while more frames of one docking
hardly do. Errors that a device repeats remain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_core.arrays import Array
from deltacharger_tactile.classifiers.labels import Examples
from deltacharger_tactile.errors import DatasetError

_LEAST = 1e-6
"""Smallest class probability of one docking: a single outlier must not rule out the true class."""


def together(probabilities: ArrayLike) -> Array:
    """Return class probabilities (N, C) from D independent dockings (D, N, C): their normalised product."""
    odds = np.log(np.maximum(np.asarray(probabilities, dtype=float), _LEAST)).sum(axis=0)
    shares = np.exp(odds - odds.max(axis=1, keepdims=True))
    return np.asarray(shares / shares.sum(axis=1, keepdims=True))


def groups(examples: Examples, dockings: int, seed: int) -> NDArray[np.int64]:
    """Return rows (D, N) of dockings at the same commanded value and device, in any session; each row at most once.

    Args:
        examples: one row per docking.
        dockings: D, dockings per group.
        seed: of the grouping.

    Raises:
        DatasetError: no value was commanded that often on one device.
    """
    random = np.random.default_rng([0x6909, seed])
    places = np.column_stack([np.round(examples.values, 6), examples.rigs])
    _, place = np.unique(places, axis=0, return_inverse=True)
    parts = []
    for number in range(place.max() + 1):
        rows = random.permutation(np.flatnonzero(place.reshape(-1) == number))
        parts.append(rows[: len(rows) // dockings * dockings].reshape(dockings, -1))
    found = np.concatenate(parts, axis=1)
    if not found.size:
        raise DatasetError("fusion", f"no value was commanded {dockings} times on one device")
    return found
