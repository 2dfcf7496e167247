# SPDX-License-Identifier: Apache-2.0
"""Checks that frames look as in training, and match the pose estimated from them.

Two checks. The Mahalanobis distance of the features finds frames far from all training frames. The second predicts the
appearance of both pads (centres, moments, active taxels) at the estimated pose and load, and compares. A drifted
row, for example, shifts the estimate but contradicts the other features.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from deltacharger_core.arrays import Array, Mask
from deltacharger_tactile import features
from deltacharger_tactile.network import Network, Weights, fit

_SHOWN = ("u_mm", "v_mm", "uu_mm2", "uv_mm2", "vv_mm2", "slope", "active", "peak_N")
_NAMES = features.names()
_TARGETS = [_NAMES.index(f"{side}_{name}") for side in ("left", "right") for name in _SHOWN]
_LOADS = [_NAMES.index("left_force_N"), _NAMES.index("right_force_N")]
_POSE_SCALE = np.array([0.005, 0.005, math.radians(6.0)])
_LOAD_SCALE = 20.0
_HIDDEN = (48, 48)
_RIDGE = 0.02
"""Added to the eigenvalues of the scaled covariance, to suppress directions without spread."""
_QUANTILE, _MARGIN = 0.999, 1.1


@dataclass(frozen=True)
class Support:
    """Statistics of training frames.

    Attributes:
        centre: (F,) mean features.
        whitening: (F, F) features to uncorrelated unit ones.
        shown_centre: (16,) mean of the predicted features.
        shown_spread: (16,) their spread.
        picture: network from pose and loads to the predicted features.
        distance_limit: largest Mahalanobis distance (per root of a feature).
        picture_limit: largest root mean square deviation from the prediction, in standard deviations.
    """

    centre: Array
    whitening: Array
    shown_centre: Array
    shown_spread: Array
    picture: Network
    distance_limit: float = math.inf
    picture_limit: float = math.inf

    @staticmethod
    def learn(inputs: Array, pose: Array, epochs: int, random: np.random.Generator) -> Support:
        """Learn from features (N, F) and the poses (N, 3) estimated from them."""
        centre, spread = inputs.mean(axis=0), inputs.std(axis=0) + 1e-2
        scaled = (inputs - centre) / spread
        values, vectors = np.linalg.eigh(scaled.T @ scaled / len(scaled) + _RIDGE * np.eye(scaled.shape[1]))
        shown = inputs[:, _TARGETS]
        shown_centre, shown_spread = shown.mean(axis=0), shown.std(axis=0)
        targets = ((shown - shown_centre) / shown_spread).astype(np.float32)
        picture = fit(_picture_inputs(inputs, pose), targets, _HIDDEN, epochs, random)
        whitening = (vectors / np.sqrt(values)) / spread[:, None]
        return Support(centre, whitening, shown_centre, shown_spread, picture)

    def limited(self, inputs: Array, pose: Array) -> Support:
        """Return a copy with limits of 1.1 times the 99.9 % quantile of these held-out rows."""
        return replace(
            self,
            distance_limit=_MARGIN * float(np.quantile(self.distance(inputs), _QUANTILE)),
            picture_limit=_MARGIN * float(np.quantile(self.deviation(inputs, pose), _QUANTILE)),
        )

    def distance(self, inputs: Array) -> Array:
        """Mahalanobis distance (N,) from the training features, per root of a feature."""
        white = (inputs - self.centre) @ self.whitening
        return np.asarray(np.sqrt(np.mean(white * white, axis=1)))

    def deviation(self, inputs: Array, pose: Array) -> Array:
        """Root mean square deviation (N,) of the shown features from the prediction at `pose` (N, 3)."""
        mean, spread = self.picture.predict(_picture_inputs(inputs, pose))
        shown = (inputs[:, _TARGETS] - self.shown_centre) / self.shown_spread
        return np.asarray(np.sqrt(np.mean(((shown - mean) / spread) ** 2, axis=1)))

    def contains(self, inputs: Array, pose: Array) -> Mask:
        """Whether features (N, F) and the poses estimated from them (N, 3) look like training."""
        near = self.distance(inputs) <= self.distance_limit
        return np.asarray(near & (self.deviation(inputs, pose) <= self.picture_limit))


def _picture_inputs(inputs: Array, pose: Array) -> Weights:
    scaled = np.concatenate([pose / _POSE_SCALE, inputs[:, _LOADS] / _LOAD_SCALE], axis=1)
    return np.asarray(np.clip(np.nan_to_num(scaled), -6.0, 6.0), dtype=np.float32)
