# SPDX-License-Identifier: Apache-2.0
"""Networks for one kind of contact: features of four mirror images to pose and standard deviations."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_tactile import features
from deltacharger_tactile.network import Network, Weights, fit

_SCALE = np.array([0.005, 0.005, math.radians(6.0)])
_FLOOR = np.array([1e-4, 5e-5, math.radians(0.03)])
"""Smallest reported standard deviations."""
_SMALLEST_FACTOR = 0.85
"""Held-out rigs may not shrink the networks' standard deviations further."""
_CLIP = 6.0


@dataclass(frozen=True)
class Expert:
    """Ensemble of networks; their mean is the estimate.

    Attributes:
        centre: (F,) mean of the features.
        spread: (F,) their standard deviation.
        networks: each estimates a pose and standard deviations.
        factor: (3,) correction of the standard deviations, from held-out rigs.
    """

    centre: Weights
    spread: Weights
    networks: tuple[Network, ...]
    factor: Array

    @staticmethod
    def learn(
        inputs: Array, pose: Array, hidden: Sequence[int], members: int, epochs: int, random: np.random.Generator
    ) -> Expert:
        """Learn from mirrored inputs (4, N, F) and poses (N, 3) in m, m, rad.

        Args:
            inputs: features of the mirror images.
            pose: (horizontal, vertical, angle) of the unmirrored image.
            hidden: widths of the hidden layers.
            members: networks.
            epochs: passes over the data.
            random: initial weights and order of the rows.
        """
        signed = (pose / _SCALE)[None] * features.MIRROR_SIGNS[:, None]
        flat, targets = inputs.reshape(-1, inputs.shape[-1]), signed.reshape(-1, 3).astype(np.float32)
        centre, spread = flat.mean(axis=0), flat.std(axis=0) + 1e-3
        scaled = np.clip((flat - centre) / spread, -_CLIP, _CLIP).astype(np.float32)
        networks = tuple(fit(scaled, targets, hidden, epochs, random) for _ in range(members))
        return Expert(centre.astype(np.float32), spread.astype(np.float32), networks, np.ones(3))

    def predict(self, inputs: Array) -> tuple[Array, Array]:
        """Return mean and standard deviation (N, 3) in m, m, rad of mirrored inputs (4, N, F)."""
        flat = inputs.reshape(-1, inputs.shape[-1]).astype(np.float32)
        scaled = ((flat - self.centre) / self.spread).clip(-_CLIP, _CLIP)
        outputs = [network.predict(scaled) for network in self.networks]
        shape = (len(outputs), *inputs.shape[:2], -1)
        means, spreads = (np.concatenate(each).reshape(shape) for each in zip(*outputs, strict=True))
        every = (means * features.MIRROR_SIGNS[:, None]).reshape(-1, *means.shape[2:])
        mean = every.mean(axis=0)
        variance = (spreads**2).reshape(every.shape).mean(axis=0) + ((every - mean) ** 2).mean(axis=0)
        return mean * _SCALE, np.maximum(np.sqrt(variance) * _SCALE * self.factor, _FLOOR)

    def scaled(self, inputs: Array, pose: Array) -> Expert:
        """Return an expert whose standard deviations hold on these rows, which `learn` did not see."""
        mean, spread = self.predict(inputs)
        ratio = np.abs(mean - pose) / spread
        # Three standard deviations must cover 99.73 %, including tails, and one the bulk.
        factor = np.maximum(np.sqrt(np.mean(ratio**2, axis=0)), np.quantile(ratio, 0.9973, axis=0) / 3.0)
        return replace(self, factor=np.maximum(factor, _SMALLEST_FACTOR))

    def arrays(self, prefix: str) -> dict[str, NDArray[Any]]:
        """Return all arrays by the names that `restore` expects."""
        found: dict[str, NDArray[Any]] = {f"{prefix}_{part}": getattr(self, part) for part in _PARTS}
        for member, network in enumerate(self.networks):
            found |= network.arrays(f"{prefix}_{member}")
        return found

    @staticmethod
    def restore(prefix: str, arrays: Mapping[str, Any], members: int) -> Expert:
        """Restore from the output of `arrays` with this prefix."""
        centre, spread, factor = (arrays[f"{prefix}_{part}"] for part in _PARTS)
        networks = tuple(Network.restore(f"{prefix}_{member}", arrays) for member in range(members))
        return Expert(centre, spread, networks, factor)


_PARTS = ("centre", "spread", "factor")
