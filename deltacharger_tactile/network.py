# SPDX-License-Identifier: Apache-2.0
"""A small regression network that estimates its own uncertainty: numpy only, Gaussian likelihood, Adam."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Weights = NDArray[np.float32]

_LOG_SPREAD = (-6.0, 3.0)
"""Bounds of the log of a predicted standard deviation (targets are scaled to about 1)."""
_BATCH = 512
_WARM_UP = 300
_RATE = 3e-3
_DECAY = 1e-5


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
        spread = np.exp(np.clip(layer[:, outputs:], *_LOG_SPREAD))
        return layer[:, :outputs], np.asarray(spread)

    def forward(self, inputs: Weights) -> list[Weights]:
        """Return the inputs and the outputs of every layer."""
        layers = [inputs]
        last = len(self.weights) - 1
        for index, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            value = layers[-1] @ weight + bias
            layers.append(value if index == last else np.maximum(value, 0.0))
        return layers

    def arrays(self, prefix: str) -> dict[str, Weights]:
        """Return weights and biases by the names that `restore` expects."""
        named = {f"{prefix}_weight{layer}": weight for layer, weight in enumerate(self.weights)}
        return named | {f"{prefix}_bias{layer}": bias for layer, bias in enumerate(self.biases)}

    @staticmethod
    def restore(prefix: str, arrays: Mapping[str, Any]) -> Network:
        """Restore from the output of `arrays` with this prefix."""
        count = sum(name.startswith(f"{prefix}_weight") for name in arrays)
        weights = tuple(arrays[f"{prefix}_weight{layer}"] for layer in range(count))
        return Network(weights, tuple(arrays[f"{prefix}_bias{layer}"] for layer in range(count)))


def fit(inputs: Weights, targets: Weights, hidden: Sequence[int], epochs: int, random: np.random.Generator) -> Network:
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


def _initial(inputs: int, hidden: Sequence[int], outputs: int, random: np.random.Generator) -> Network:
    sizes = [inputs, *hidden, 2 * outputs]
    weights = [
        (random.standard_normal((a, b)) * math.sqrt(2.0 / a)).astype(np.float32) for a, b in itertools.pairwise(sizes)
    ]
    weights[-1] *= np.float32(0.1)
    return Network(tuple(weights), tuple(np.zeros(size, np.float32) for size in sizes[1:]))


def _gradients(network: Network, inputs: Weights, targets: Weights) -> list[Weights]:
    layers = network.forward(inputs)
    outputs = targets.shape[1]
    logarithm = np.clip(layers[-1][:, outputs:], *_LOG_SPREAD)
    error = layers[-1][:, :outputs] - targets
    precision, weight = np.exp(-2.0 * logarithm), np.exp(logarithm)
    flow = np.concatenate([error * precision * weight, (1.0 - error * error * precision) * weight], axis=1)
    flow = (flow / len(inputs)).astype(np.float32)
    by_weight: list[Weights] = []
    by_bias: list[Weights] = []
    for index in range(len(network.weights) - 1, -1, -1):
        by_weight.insert(0, np.asarray(layers[index].T @ flow, dtype=np.float32))
        by_bias.insert(0, np.asarray(flow.sum(axis=0), dtype=np.float32))
        if index:
            flow = (flow @ network.weights[index].T) * (layers[index] > 0.0)
    return [*by_weight, *by_bias]
