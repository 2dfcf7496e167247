# SPDX-License-Identifier: Apache-2.0
"""Training of the pose estimator: its networks by Adam, its standard deviations and limits on other rigs.

Numpy only. The same seed gives the same model.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deltacharger_core.arrays import Array, Mask
from deltacharger_lab.training import reliability, splits
from deltacharger_tactile import errors, estimator, features

_BATCH = 512
_FEWEST = _BATCH  # dockings to fit an expert
_FEWEST_HELD_OUT = 50
_WARM_UP = 300  # steps
_RATE = 3e-3
_DECAY = 1e-5
_SMALLEST_FACTOR = 0.85
"""Held-out rigs may not shrink the networks' standard deviations further."""
_PICTURE = (48, 48)
"""Widths of the hidden layers of the network that predicts both pads."""
_RIDGE = 0.02
"""Added to the eigenvalues of the scaled covariance, to suppress directions without spread."""
_QUANTILE, _MARGIN = 0.999, 1.1
"""Limits of familiar frames: this quantile of held-out ones, times the margin."""


class TrainablePoseEstimator(estimator.PoseEstimator):
    """A pose estimator that learns.

    Args:
        name: name and version in messages.
        threshold: readings below it count as 0, N.
        hidden: widths of the hidden layers of each network.
        members: networks per expert.
        epochs: passes over the training data.

    Attributes:
        interval: (3,) standard deviations of (horizontal, vertical, angle) that contain the nominal share of errors,
            split-conformal on rigs unseen in training; inf before `fit`.
    """

    def __init__(
        self,
        name: str = "pose",
        threshold: float = estimator.THRESHOLD,
        hidden: Sequence[int] = (64, 48),
        members: int = 2,
        epochs: int = 12,
    ) -> None:
        super().__init__(name, threshold)
        self.hidden = tuple(hidden)
        self.members = members
        self.epochs = epochs
        self.interval = np.full(3, math.inf)

    def fit(
        self,
        frames: ArrayLike,
        pose: ArrayLike,
        held_out: tuple[ArrayLike, ArrayLike],
        seed: int = 0,
        progress: Callable[[float, str], None] = lambda share, text: None,
    ) -> TrainablePoseEstimator:
        """Learn from dockings, then scale the standard deviations on other rigs.

        Args:
            frames: (N, 2, 10, 10) N, tared, averaged, not thresholded; NaN where dead.
            pose: (N, 3) m, m, rad: (horizontal, vertical, angle) in contact.
            held_out: frames and poses of other rigs.
            seed: initial weights.
            progress: called with the share done and the current step.

        Raises:
            ModelError: too few different dockings on both pads or on one, in the training or held-out data.
        """
        random = np.random.default_rng([0xF17, seed])
        readings, seats = np.asarray(frames, dtype=float), to_seat(np.asarray(pose, dtype=float))
        inputs, holds, touched = self._prepare(readings)
        in_range, single = holds & estimator.within(seats), touched & ~holds
        self._require(readings, in_range, single, _FEWEST, "dockings")
        for index, (name, rows) in enumerate(zip(estimator.EXPERTS, (holds, single), strict=True)):
            progress(index / 3.0, f"{self.name}: {np.count_nonzero(rows)} dockings in contact with {name} pad(s)")
            self._experts[name] = _learn_expert(
                inputs[:, rows], seats[rows], self.hidden, self.members, self.epochs, random
            )
        progress(2.0 / 3.0, f"{self.name}: typical frames")
        usual = inputs[:, in_range]
        seen = np.concatenate([self._experts["both"].predict(usual)[0] * sign for sign in features.MIRROR_SIGNS])
        self._support = _learn_support(usual.reshape(-1, usual.shape[-1]), seen, self.epochs, random)
        self._calibrate(np.asarray(held_out[0], dtype=float), to_seat(np.asarray(held_out[1], dtype=float)))
        progress(1.0, f"{self.name}: done")
        return self

    def _require(self, frames: Array, in_range: Mask, single: Mask, needed: int, what: str) -> None:
        for rows, where in ((in_range, "on both pads, in range"), (single, "on one pad")):
            found = len(splits.distinct(frames[rows], self.threshold))
            if found < needed:
                raise errors.ModelError(self.name, f"{found} different {what} {where}, at least {needed} are needed")

    def _calibrate(self, frames: Array, seat: Array) -> None:
        inputs, holds, touched = self._prepare(frames)
        in_range, single = holds & estimator.within(seat), touched & ~holds
        self._require(frames, in_range, single, _FEWEST_HELD_OUT, "held-out dockings")
        for name, rows in zip(estimator.EXPERTS, (holds, single), strict=True):
            self._experts[name] = _scaled(self._experts[name], inputs[:, rows], seat[rows])
        usual = inputs[:, in_range]
        mean, spread = self._experts["both"].predict(usual)
        self._support = _limited(self._learnt, usual[0], mean)
        error = estimator.to_pose(mean) - estimator.to_pose(seat[in_range])
        ratio = np.sort(np.abs(error) / estimator.pose_stddev(mean, spread), axis=0)
        self.interval = ratio[min(math.ceil((len(ratio) + 1) * reliability.NOMINAL), len(ratio)) - 1]

    def save(self, path: str | Path) -> None:
        """Write one npz file that loads without pickle."""
        support = self._learnt
        arrays: dict[str, Any] = {
            "support_centre": support.centre,
            "support_whitening": support.whitening.astype(np.float32),
            "support_shown_centre": support.shown_centre,
            "support_shown_spread": support.shown_spread,
        } | _arrays("picture", support.picture)
        for name, expert in self._experts.items():
            arrays |= {f"{name}_{part}": getattr(expert, part) for part in estimator.PARTS}
            for member, network in enumerate(expert.networks):
                arrays |= _arrays(f"{name}_{member}", network)
        header = {
            "format": estimator.FORMAT,
            "name": self.name,
            "threshold": self.threshold,
            "hidden": self.hidden,
            "members": self.members,
            "epochs": self.epochs,
            "interval": self.interval.tolist(),
            "support": [support.distance_limit, support.picture_limit],
            "features": features.names(),
            "about": self.about,
        }
        np.savez_compressed(path, meta=np.array(json.dumps(header, sort_keys=True)), **arrays)

    def _restore(self, header: dict[str, Any], arrays: dict[str, Any]) -> None:
        super()._restore(header, arrays)
        self.hidden, self.members, self.epochs = tuple(header["hidden"]), header["members"], header["epochs"]
        self.interval = np.array(header["interval"], dtype=float).reshape(3)


def _learn_expert(
    inputs: Array, pose: Array, hidden: Sequence[int], members: int, epochs: int, random: np.random.Generator
) -> estimator.Expert:
    """Learn an expert from mirrored inputs (4, N, F) and poses (N, 3) in m, m, rad.

    Args:
        inputs: features of the mirror images.
        pose: (horizontal, vertical, angle) of the unmirrored image.
        hidden: widths of the hidden layers.
        members: networks.
        epochs: passes over the data.
        random: initial weights and order of the rows.
    """
    signed = (pose / estimator.POSE_SCALE)[None] * features.MIRROR_SIGNS[:, None]
    flat, targets = inputs.reshape(-1, inputs.shape[-1]), signed.reshape(-1, 3).astype(np.float32)
    centre, spread = flat.mean(axis=0), flat.std(axis=0) + 1e-3
    scaled = np.clip((flat - centre) / spread, -estimator.CLIP, estimator.CLIP).astype(np.float32)
    networks = tuple(_fit(scaled, targets, hidden, epochs, random) for _ in range(members))
    return estimator.Expert(centre.astype(np.float32), spread.astype(np.float32), networks, np.ones(3))


def _scaled(expert: estimator.Expert, inputs: Array, pose: Array) -> estimator.Expert:
    """Return an expert whose standard deviations hold on these rows, which `_learn_expert` did not see."""
    mean, spread = expert.predict(inputs)
    ratio = np.abs(mean - pose) / spread
    # Three standard deviations must cover 99.73 %, including tails, and one the bulk.
    factor = np.maximum(np.sqrt(np.mean(ratio**2, axis=0)), np.quantile(ratio, 0.9973, axis=0) / 3.0)
    return replace(expert, factor=np.maximum(factor, _SMALLEST_FACTOR))


def _learn_support(inputs: Array, pose: Array, epochs: int, random: np.random.Generator) -> estimator.Support:
    """Learn from features (N, F) and the poses (N, 3) estimated from them."""
    centre, spread = inputs.mean(axis=0), inputs.std(axis=0) + 1e-2
    scaled = (inputs - centre) / spread
    values, vectors = np.linalg.eigh(scaled.T @ scaled / len(scaled) + _RIDGE * np.eye(scaled.shape[1]))
    shown = inputs[:, estimator.SHOWN]
    shown_centre, shown_spread = shown.mean(axis=0), shown.std(axis=0)
    targets = ((shown - shown_centre) / shown_spread).astype(np.float32)
    picture = _fit(estimator.picture_inputs(inputs, pose), targets, _PICTURE, epochs, random)
    whitening = (vectors / np.sqrt(values)) / spread[:, None]
    return estimator.Support(centre, whitening, shown_centre, shown_spread, picture)


def _limited(support: estimator.Support, inputs: Array, pose: Array) -> estimator.Support:
    """Return a copy with limits from these held-out rows, features (N, F) and poses (N, 3)."""
    return replace(
        support,
        distance_limit=_MARGIN * float(np.quantile(support.distance(inputs), _QUANTILE)),
        picture_limit=_MARGIN * float(np.quantile(support.deviation(inputs, pose), _QUANTILE)),
    )


def _fit(
    inputs: estimator.Weights,
    targets: estimator.Weights,
    hidden: Sequence[int],
    epochs: int,
    random: np.random.Generator,
) -> estimator.Network:
    """Fit by Adam with a cosine schedule.

    The predicted standard deviation weights the likelihood's gradient (Seitzer et al. 2022, beta = 0.5). Without it,
    the mean of hard cases is never learnt.

    Args:
        inputs: (N, F) scaled features.
        targets: (N, K) scaled poses.
        hidden: widths of the hidden layers.
        epochs: passes over the data.
        random: initial weights and order of the rows.
    """
    network = _initial(inputs.shape[1], hidden, targets.shape[1], random)
    values = [*network.weights, *network.biases]
    moments = [(np.zeros_like(value), np.zeros_like(value)) for value in values]
    batches = len(inputs) // _BATCH
    total = epochs * batches
    step = 0
    for _ in range(epochs):
        order = random.permutation(len(inputs))
        for batch in range(batches):
            rows = order[batch * _BATCH : (batch + 1) * _BATCH]
            step += 1
            rate = 0.5 * _RATE * (1.0 + math.cos(math.pi * step / total)) * min(1.0, step / _WARM_UP)
            gradients = _gradients(network, inputs[rows], targets[rows])
            for value, (first, second), gradient in zip(values, moments, gradients, strict=True):
                first += 0.1 * (gradient - first)
                second += 0.001 * (gradient * gradient - second)
                scale = np.sqrt(second / (1.0 - 0.999**step)) + 1e-8
                value -= rate * (first / (1.0 - 0.9**step) / scale + _DECAY * value)
    return network


def _initial(inputs: int, hidden: Sequence[int], outputs: int, random: np.random.Generator) -> estimator.Network:
    sizes = [inputs, *hidden, 2 * outputs]
    weights = [
        (random.standard_normal((a, b)) * math.sqrt(2.0 / a)).astype(np.float32) for a, b in itertools.pairwise(sizes)
    ]
    weights[-1] *= np.float32(0.1)
    return estimator.Network(tuple(weights), tuple(np.zeros(size, np.float32) for size in sizes[1:]))


def _gradients(
    network: estimator.Network, inputs: estimator.Weights, targets: estimator.Weights
) -> list[estimator.Weights]:
    layers = network.forward(inputs)
    outputs = targets.shape[1]
    logarithm = np.clip(layers[-1][:, outputs:], *estimator.LOG_SPREAD)
    error = layers[-1][:, :outputs] - targets
    precision, weight = np.exp(-2.0 * logarithm), np.exp(logarithm)
    flow = np.concatenate([error * precision * weight, (1.0 - error * error * precision) * weight], axis=1)
    flow = (flow / len(inputs)).astype(np.float32)
    by_weight: list[estimator.Weights] = []
    by_bias: list[estimator.Weights] = []
    for index in range(len(network.weights) - 1, -1, -1):
        by_weight.insert(0, np.asarray(layers[index].T @ flow, dtype=np.float32))
        by_bias.insert(0, np.asarray(flow.sum(axis=0), dtype=np.float32))
        if index:
            flow = (flow @ network.weights[index].T) * (layers[index] > 0.0)
    return [*by_weight, *by_bias]


def _arrays(prefix: str, network: estimator.Network) -> dict[str, estimator.Weights]:
    """Return weights and biases by the names that `Network.restore` expects."""
    named = {f"{prefix}_weight{layer}": weight for layer, weight in enumerate(network.weights)}
    return named | {f"{prefix}_bias{layer}": bias for layer, bias in enumerate(network.biases)}


def to_seat(pose: Array) -> Array:
    """Convert poses (N, 3) m, m, rad (horizontal, vertical, angle) to seats (N, 3): along, across, angle."""
    x, y, angle = pose.T
    return np.column_stack([x, y * np.cos(angle) - x * np.sin(angle), angle])
