# SPDX-License-Identifier: Apache-2.0
"""What the pose estimator has learnt: experts for the pose, and whether frames look as in training.

Small regression networks estimate their own uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_tactile import features

Weights = NDArray[np.float32]

LOG_SPREAD = (-6.0, 3.0)
"""Bounds of the log of a predicted standard deviation (targets are scaled to about 1)."""
POSE_SCALE = np.array([0.005, 0.005, math.radians(6.0)])
"""Size of a pose in networks: m, m, rad."""
CLIP = 6.0
"""Largest scaled input of a network."""
PARTS = ("centre", "spread", "factor")
"""Arrays of an expert beside its networks."""
_NAMES = features.names()
_SHOWN = ("u_mm", "v_mm", "uu_mm2", "uv_mm2", "vv_mm2", "slope", "active", "peak_N")
SHOWN = [_NAMES.index(f"{side}_{name}") for side in ("left", "right") for name in _SHOWN]
"""Columns of the features that `Support.picture` predicts."""
_LOADS = [_NAMES.index("left_force_N"), _NAMES.index("right_force_N")]
_LOAD_SCALE = 20.0
_FLOOR = np.array([1e-4, 5e-5, math.radians(0.03)])
"""Smallest reported standard deviations, m, m, rad."""


@dataclass(frozen=True)
class Network:
    """Fully connected layers with ReLU; the last returns K means and K logarithms of standard deviations.

    Attributes:
        weights: (inputs, outputs) of each layer, float32.
        biases: (outputs,) of each layer, float32.
    """

    weights: tuple[Weights, ...]
    biases: tuple[Weights, ...]

    def predict(self, inputs: Weights) -> tuple[Weights, Weights]:
        """Return mean and standard deviation (N, K) of scaled inputs (N, F)."""
        layer = self.forward(inputs)[-1]
        outputs = layer.shape[1] // 2
        spread = np.exp(np.clip(layer[:, outputs:], *LOG_SPREAD))
        return layer[:, :outputs], np.asarray(spread)

    def forward(self, inputs: Weights) -> list[Weights]:
        """Return the inputs and the outputs of every layer."""
        layers = [inputs]
        last = len(self.weights) - 1
        for index, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            value = layers[-1] @ weight + bias
            layers.append(value if index == last else np.maximum(value, 0.0))
        return layers

    @staticmethod
    def restore(prefix: str, arrays: Mapping[str, Any]) -> Network:
        """Restore from a file's arrays `<prefix>_weight<i>` and `<prefix>_bias<i>`."""
        count = sum(name.startswith(f"{prefix}_weight") for name in arrays)
        weights = tuple(arrays[f"{prefix}_weight{layer}"] for layer in range(count))
        return Network(weights, tuple(arrays[f"{prefix}_bias{layer}"] for layer in range(count)))


@dataclass(frozen=True)
class Expert:
    """Ensemble of networks for one kind of contact; their mean is the estimate.

    Attributes:
        centre: (F,) mean of the features.
        spread: (F,) their standard deviation.
        networks: each estimates a pose and standard deviations from features.
        factor: (3,) correction of the standard deviations, from held-out rigs.
    """

    centre: Weights
    spread: Weights
    networks: tuple[Network, ...]
    factor: Array

    def predict(self, inputs: Array) -> tuple[Array, Array]:
        """Return mean and standard deviation (N, 3) in m, m, rad of mirrored inputs (4, N, F)."""
        flat = inputs.reshape(-1, inputs.shape[-1]).astype(np.float32)
        scaled = ((flat - self.centre) / self.spread).clip(-CLIP, CLIP)
        outputs = [network.predict(scaled) for network in self.networks]
        shape = (len(outputs), *inputs.shape[:2], -1)
        means, spreads = (np.concatenate(each).reshape(shape) for each in zip(*outputs, strict=True))
        every = (means * features.MIRROR_SIGNS[:, None]).reshape(-1, *means.shape[2:])
        mean = every.mean(axis=0)
        variance = (spreads**2).reshape(every.shape).mean(axis=0) + ((every - mean) ** 2).mean(axis=0)
        return mean * POSE_SCALE, np.maximum(np.sqrt(variance) * POSE_SCALE * self.factor, _FLOOR)

    @staticmethod
    def restore(prefix: str, arrays: Mapping[str, Any], members: int) -> Expert:
        """Restore from a file's arrays with this prefix."""
        centre, spread, factor = (arrays[f"{prefix}_{part}"] for part in PARTS)
        networks = tuple(Network.restore(f"{prefix}_{member}", arrays) for member in range(members))
        return Expert(centre, spread, networks, factor)


@dataclass(frozen=True)
class Support:
    """Statistics of training frames, for two checks.

    The Mahalanobis distance of the features finds frames far from all training frames. The second check predicts the
    appearance of both pads (centres, moments, active taxels) at the estimated pose and load, and compares. A drifted
    row, for example, shifts the estimate but contradicts the other features.

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

    def distance(self, inputs: Array) -> Array:
        """Mahalanobis distance (N,) from the training features, per root of a feature."""
        white = (inputs - self.centre) @ self.whitening
        return np.asarray(np.sqrt(np.mean(white * white, axis=1)))

    def deviation(self, inputs: Array, pose: Array) -> Array:
        """Root mean square deviation (N,) of the shown features from the prediction at `pose` (N, 3)."""
        mean, spread = self.picture.predict(picture_inputs(inputs, pose))
        shown = (inputs[:, SHOWN] - self.shown_centre) / self.shown_spread
        return np.asarray(np.sqrt(np.mean(((shown - mean) / spread) ** 2, axis=1)))

    def contains(self, inputs: Array, pose: Array) -> Mask:
        """Whether features (N, F) and the poses estimated from them (N, 3) look like training."""
        near = self.distance(inputs) <= self.distance_limit
        return np.asarray(near & (self.deviation(inputs, pose) <= self.picture_limit))


def picture_inputs(inputs: Array, pose: Array) -> Weights:
    """Return the inputs (N, 5) of `Support.picture`: poses (N, 3) and the loads in features (N, F), scaled."""
    scaled = np.concatenate([pose / POSE_SCALE, inputs[:, _LOADS] / _LOAD_SCALE], axis=1)
    return np.asarray(np.clip(np.nan_to_num(scaled), -CLIP, CLIP), dtype=np.float32)
