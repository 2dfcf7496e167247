# SPDX-License-Identifier: Apache-2.0
"""When a classifier's answer may be used: split-conformal sets, and a check that frames look as in training.

A conformal set holds the true class with the nominal probability if new frames are distributed like the held-out ones.
The drift check detects when they no longer are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_lab.training import familiarity
from deltacharger_lab.training.familiarity import FEWEST, WINDOW, Familiarity
from deltacharger_tactile.errors import ModelError

NOMINAL = 0.95


@dataclass(frozen=True)
class Reliability:
    """Results from held-out frames.

    Attributes:
        quantile: largest 1 − probability of a class in the set.
        familiar: statistics of training frames.
    """

    quantile: float
    familiar: Familiarity

    def sets(self, probabilities: Array) -> Mask:
        """Return which classes (N, C) belong to the set of each frame; a set may be empty."""
        return np.asarray(1.0 - probabilities <= self.quantile)

    def drifted_together(self, frames: Array, threshold: float) -> bool:
        """Return whether the last dockings together look unlike training, though each alone may not.

        Args:
            frames: (N, 2, 10, 10) N, one per docking.
            threshold: readings below it count as 0, N.

        Raises:
            ModelError: too few frames.
        """
        if len(frames) < WINDOW:
            raise ModelError("reliability", f"{len(frames)} dockings are too few to judge; give at least {WINDOW}")
        return self.familiar.strange_together(frames, threshold)

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers."""
        return {"quantile": self.quantile, "familiar": self.familiar.to_dict()}

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Reliability:
        """Restore from the output of `to_dict`."""
        return Reliability(values["quantile"], Familiarity.from_dict(values["familiar"]))


def learn(
    probabilities: Array,
    labels: NDArray[np.int64],
    frames: Array,
    threshold: float,
    familiar: Array | None = None,
) -> Reliability:
    """Learn from frames that training did not see (Vovk et al. 2005; score 1 − probability of the true class).

    Args:
        probabilities: (N, C) by the classifier.
        labels: (N,) their classes.
        frames: (N, 2, 10, 10) N.
        threshold: readings below it count as 0, N.
        familiar: (M, 2, 10, 10) N, further normal frames. Training frames may be used: the drift check does not use the
            classifier's output.

    Raises:
        ModelError: too few frames, or too few of them differ and are in contact.
    """
    count = len(labels)
    if count < FEWEST:
        raise ModelError("reliability", f"{count} held-out frames are too few; give at least {FEWEST}")
    scores = np.sort(1.0 - probabilities[np.arange(count), labels])
    rank = math.ceil((count + 1) * NOMINAL)
    quantile = float(scores[rank - 1]) if rank <= count else 1.0
    every = frames if familiar is None else np.concatenate([frames, familiar])
    return Reliability(quantile, familiarity.learn(every, threshold))
