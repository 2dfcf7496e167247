# SPDX-License-Identifier: Apache-2.0
"""Trained classifiers from their files: arrays without pickle, and class probabilities on numpy alone.

Each kind is a function of arrays (named as in the file) and inputs. Trees compare in their trainer's precision (float32
if it used that), so that a reading on a threshold takes the same branch.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import LARGEST_MODEL, Array, NpzError, read_npz
from deltacharger_tactile.errors import ModelError

Arrays = Mapping[str, NDArray[Any]]


def softmax(scores: Array) -> Array:
    """Return the softmax of scores (N, C) along the classes."""
    shifted = np.exp(scores - scores.max(axis=1, keepdims=True))
    return np.asarray(shifted / shifted.sum(axis=1, keepdims=True))


def linear(arrays: Arrays, inputs: Array) -> Array:
    """Softmax of `inputs` (N, F) @ `weights` (F, C) + `bias` (C); unknown inputs (NaN) count as `usual` (F)."""
    known = np.where(np.isnan(inputs), arrays["usual"], inputs) if "usual" in arrays else inputs
    return softmax(known @ arrays["weights"] + arrays["bias"])


def one_against_rest(arrays: Arrays, inputs: Array) -> Array:
    """Logistic of each class's score, divided by their sum."""
    scores = inputs @ arrays["weights"] + arrays["bias"]
    each = 1.0 / (1.0 + np.exp(-np.clip(scores, -500.0, 500.0)))
    return np.asarray(each / each.sum(axis=1, keepdims=True))


def neighbours(arrays: Arrays, inputs: Array) -> Array:
    """Share of each class among the `count` nearest of `examples` (M, F) with `labels` (M,), Euclidean."""
    examples, labels, count = arrays["examples"], arrays["labels"], int(arrays["count"])
    inputs = inputs.astype(examples.dtype)
    squared = np.sum(inputs * inputs, axis=1)[:, None] - 2.0 * inputs @ examples.T + np.sum(examples * examples, axis=1)
    nearest = np.argsort(squared, axis=1, kind="stable")[:, :count]
    votes = np.zeros((len(inputs), int(arrays["classes"])))
    np.add.at(votes, (np.arange(len(inputs))[:, None], labels[nearest]), 1.0 / count)
    return votes


def forest(arrays: Arrays, inputs: Array) -> Array:
    """Mean over trees of the class shares in the leaf that each input reaches."""
    return np.asarray(_leaves(arrays, inputs, arrays["value"]).mean(axis=1))


def boosted(arrays: Arrays, inputs: Array) -> Array:
    """Softmax of `base` (C,) plus the leaves of each class's trees; `owner` (T,) is the class of a tree."""
    leaves = _leaves(arrays, inputs, arrays["value"])[:, :, 0]
    scores = np.tile(np.asarray(arrays["base"], dtype=float), (len(inputs), 1))
    for tree, owner in enumerate(arrays["owner"].tolist()):
        scores[:, owner] += leaves[:, tree]
    return softmax(scores)


def _leaves(arrays: Arrays, inputs: Array, value: NDArray[Any]) -> Array:
    """Return the value of the leaf that each input (N, F) reaches in each tree: (N, T, K).

    One table holds the nodes of all trees: `feature` (negative in a leaf), `threshold`, `left`, `right`. `root` (T,) is
    the first node of each. All inputs descend all trees at once. `strict`: left means below the threshold instead of at
    most at it.
    """
    feature, threshold = arrays["feature"], arrays["threshold"]
    left, right = arrays["left"], arrays["right"]
    readings = np.asarray(inputs, dtype=np.float32)
    strict = bool(arrays["strict"])
    node = np.broadcast_to(arrays["root"], (len(inputs), len(arrays["root"]))).copy()
    rows = np.arange(len(inputs))[:, None]
    while True:
        split = feature[node]
        inner = split >= 0
        if not inner.any():
            return np.asarray(value[node], dtype=float)
        reading = readings[rows, np.maximum(split, 0)]
        goes_left = reading < threshold[node] if strict else reading <= threshold[node]
        node = np.where(inner, np.where(goes_left, left[node], right[node]), node)


def network(arrays: Arrays, inputs: Array) -> Array:
    """Softmax of a network's last dense layer on `hidden`."""
    last = _numbered(arrays, "dense")[-1]
    return softmax(np.asarray(hidden(arrays, inputs) @ arrays[last] + arrays[f"{last}_bias"], dtype=float))


def hidden(arrays: Arrays, inputs: Array) -> NDArray[Any]:
    """Last hidden layer (N, H): optional 3 × 3 convolutions over two channels, then dense layers, each with ReLU.

    Batch normalisation is folded into the weights. `convolution<i>` (3, 3, in, out) and `dense<i>` (in, out) each have
    a `…_bias`. Dense layers see the planes flattened channel by channel, as in PyTorch.
    """
    values: NDArray[Any] = np.asarray(inputs, dtype=arrays["dense0"].dtype)
    if "convolution0" in arrays:
        planes = values.reshape(len(values), 2, 10, 10).transpose(0, 2, 3, 1)
        for name in _numbered(arrays, "convolution"):
            planes = np.maximum(_convolve(planes, arrays[name]) + arrays[f"{name}_bias"], 0.0)
        values = planes.transpose(0, 3, 1, 2).reshape(len(values), -1)
    for name in _numbered(arrays, "dense")[:-1]:
        values = np.maximum(values @ arrays[name] + arrays[f"{name}_bias"], 0.0)
    return values


def _convolve(planes: NDArray[Any], kernel: NDArray[Any]) -> NDArray[Any]:
    """Correlate planes (N, H, W, in) with a kernel (3, 3, in, out), zeros around, same size."""
    padded = np.pad(planes, ((0, 0), (1, 1), (1, 1), (0, 0)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(1, 2))  # N, H, W, in, 3, 3
    flat = windows.reshape(*windows.shape[:3], -1)
    return np.asarray(flat @ kernel.transpose(2, 0, 1, 3).reshape(-1, kernel.shape[3]))


def _numbered(arrays: Arrays, stem: str) -> list[str]:
    return [f"{stem}{index}" for index in range(len(arrays)) if f"{stem}{index}" in arrays]


KINDS: dict[str, Callable[[Arrays, Array], Array]] = {
    "linear": linear,
    "one_against_rest": one_against_rest,
    "neighbours": neighbours,
    "forest": forest,
    "boosted": boosted,
    "network": network,
}
"""Function of each `kind` of file."""


FORMAT = 1


def read(path: str | Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the description (`kind`, `name`, `target`, …) and the arrays of a file.

    Raises:
        FileNotFoundError: no such file.
        ModelError: another kind of file or version.
    """
    try:
        about, arrays = read_npz(path, "about", LARGEST_MODEL)
    except NpzError as error:
        raise ModelError(str(path), str(error)) from error
    if about.get("format") != FORMAT or about.get("kind") not in KINDS:
        found = f"format {about.get('format')}, kind '{about.get('kind')}'"
        raise ModelError(str(path), f"{found} is unknown to this version; train it again")
    return about, full(arrays)


def full(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return arrays with float16, which only files use, converted to float32."""
    return {name: array.astype(np.float32) if array.dtype == np.float16 else array for name, array in arrays.items()}
