"""When a classifier's answer may be acted on: split-conformal sets, and a check that frames look as in training.

A conformal set holds the true class with the nominal probability as long as new frames come from where the held-out
ones came from. It does not notice when they no longer do; that is what the drift check is for.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_tactile.errors import ModelError

Array = NDArray[np.float64]

NOMINAL = 0.95
_FEWEST = 20  # held-out frames, fewer of which say nothing about one in twenty
_TAIL = 0.005  # share of the held-out frames on either side that may look strange
_MARGIN = 0.05  # of the value, beyond what was seen


@dataclass(frozen=True)
class Reliability:
    """What held-out frames taught.

    Attributes:
        quantile: largest 1 − probability with which a class still belongs to the set.
        force_low, force_high: N, total load of both pads between which frames look familiar.
        active_low, active_high: taxels that feel something, likewise.
    """

    quantile: float
    force_low: float
    force_high: float
    active_low: float
    active_high: float

    def sets(self, probabilities: Array) -> NDArray[np.bool_]:
        """Return which classes (N, C) belong to the set of each frame; a set may be empty."""
        return np.asarray(1.0 - probabilities <= self.quantile)

    def drifted(self, frames: Array, threshold: float) -> NDArray[np.bool_]:
        """Return which frames (N, 2, 10, 10) N look like none of training."""
        force, active = _looks(frames, threshold)
        familiar = (force >= self.force_low) & (force <= self.force_high)
        return np.asarray(~(familiar & (active >= self.active_low) & (active <= self.active_high)))

    def to_dict(self) -> dict[str, float]:
        """Return it as plain numbers."""
        return asdict(self)

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Reliability:
        """Return what `to_dict` gave."""
        return Reliability(**values)


def learn(probabilities: Array, labels: NDArray[np.int64], frames: Array, threshold: float) -> Reliability:
    """Learn from frames that training did not see (Vovk et al. 2005; score 1 − probability of the true class).

    Args:
        probabilities: (N, C) that the classifier gives them.
        labels: (N,) their classes.
        frames: (N, 2, 10, 10) N.
        threshold: readings below it count as 0, N.

    Raises:
        ModelError: too few frames.
    """
    count = len(labels)
    if count < _FEWEST:
        raise ModelError("reliability", f"{count} held-out frames are too few; give at least {_FEWEST}")
    scores = np.sort(1.0 - probabilities[np.arange(count), labels])
    rank = math.ceil((count + 1) * NOMINAL)
    quantile = float(scores[rank - 1]) if rank <= count else 1.0
    force, active = _looks(frames, threshold)
    low_force, high_force = np.quantile(force, (_TAIL, 1.0 - _TAIL))
    low_active, high_active = np.quantile(active, (_TAIL, 1.0 - _TAIL))
    low, high = 1.0 - _MARGIN, 1.0 + _MARGIN
    return Reliability(quantile, low * low_force, high * high_force, low * low_active, high * high_active)


def _looks(frames: Array, threshold: float) -> tuple[Array, Array]:
    """Return the total load (N) and the number of active taxels of each frame."""
    felt = np.where(frames >= threshold, frames, 0.0)
    return felt.sum(axis=(1, 2, 3)), np.count_nonzero(felt, axis=(1, 2, 3)).astype(float)
