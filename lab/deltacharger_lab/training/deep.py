# SPDX-License-Identifier: Apache-2.0
"""Training of the paper's two networks with PyTorch, on the CPU: networks this small learn no faster on a GPU."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_lab.training.classifier import Arrays, Labels, Learnt, Progress

EPOCHS = 50
"""Passes over the data. From the paper, like cross entropy, ReduceLROnPlateau and the kinds of layers; widths, batch
size and learning rate are not."""
_DENSE = (512, 256, 128)  # widths of nn; narrower ones are worse on horizontal by one to three points
_PLANES, _CNN_DENSE = (8, 16), (64, 32)  # widths of cnn; 16 and 32 planes with 128 are no better
_BATCH = 16
_RATE = 3e-3
_PATIENCE = 5  # epochs without a smaller loss until the rate is divided by ten


def build(name: str, classes: int) -> Any:
    """Return `nn`, dense layers, or `cnn`, two convolutions and three dense layers; both with batch normalisation."""
    from torch import nn

    if name == "nn":
        layers: list[Any] = []
        for width, following in itertools.pairwise((200, *_DENSE)):
            layers += [nn.Linear(width, following), nn.BatchNorm1d(following), nn.ReLU()]
        return nn.Sequential(*layers, nn.Linear(_DENSE[-1], classes))
    (first, second), (wide, narrow) = _PLANES, _CNN_DENSE
    return nn.Sequential(
        nn.Unflatten(1, (2, 10, 10)),
        nn.Conv2d(2, first, 3, padding=1), nn.BatchNorm2d(first), nn.ReLU(),
        nn.Conv2d(first, second, 3, padding=1), nn.BatchNorm2d(second), nn.ReLU(),
        nn.Flatten(),
        nn.Linear(100 * second, wide), nn.ReLU(),
        nn.Linear(wide, narrow), nn.ReLU(),
        nn.Linear(narrow, classes),
    )  # fmt: skip


def train(name: str, inputs: Array, labels: Labels, seed: int, progress: Progress) -> Learnt:
    """Train the network `name` on inputs (N, 200) N with labels (N,), which include every class from 0 on."""
    import torch

    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        model = build(name, int(labels.max()) + 1)
        _learn(model, inputs, labels, generator, lambda epoch: progress(epoch / EPOCHS, f"{name}: epoch {epoch}"))
    model.eval().double()  # float32 rounding differs between libraries by more than the export may

    def trainer_proba(values: Array) -> Array:
        with torch.no_grad():
            scores = model(torch.as_tensor(values, dtype=torch.float64))
            return np.asarray(torch.softmax(scores, dim=1))

    return Learnt("network", _export(model), trainer_proba)


def _learn(model: Any, inputs: Array, labels: Labels, generator: Any, done: Callable[[int], None]) -> None:
    import torch

    x = torch.as_tensor(inputs, dtype=torch.float32)
    y = torch.as_tensor(labels)
    loss_of = torch.nn.CrossEntropyLoss()
    optimizer = torch.optim.Adam(model.parameters(), lr=_RATE)
    scheduler = torch.optim.lr_scheduler.ReduceLROnPlateau(optimizer, patience=_PATIENCE)
    model.train()
    for epoch in range(EPOCHS):
        total = 0.0
        for rows in torch.randperm(len(x), generator=generator).split(_BATCH):
            if len(rows) < 2:  # batch normalisation needs two rows
                continue
            optimizer.zero_grad()
            loss = loss_of(model(x[rows]), y[rows])
            loss.backward()
            optimizer.step()
            total += float(loss.detach()) * len(rows)
        scheduler.step(total / len(x))
        done(epoch + 1)


def _export(model: Any) -> Arrays:
    """Return the layers as arrays, with batch normalisation folded into the layer before it."""
    from torch import nn

    arrays: dict[str, NDArray[Any]] = {}
    counts = {"convolution": 0, "dense": 0}
    last = ""
    for layer in model:
        if isinstance(layer, nn.BatchNorm1d | nn.BatchNorm2d):
            scale = (layer.weight / (layer.running_var + layer.eps).sqrt()).detach().numpy()
            shift = layer.bias.detach().numpy() - layer.running_mean.numpy() * scale
            arrays[f"{last}_bias"] = arrays[f"{last}_bias"] * scale + shift
            arrays[last] = arrays[last] * scale
        elif isinstance(layer, nn.Linear | nn.Conv2d):
            stem = "dense" if isinstance(layer, nn.Linear) else "convolution"
            last = f"{stem}{counts[stem]}"
            counts[stem] += 1
            weight = layer.weight.detach().numpy()
            arrays[last] = weight.T if stem == "dense" else weight.transpose(2, 3, 1, 0)
            arrays[f"{last}_bias"] = layer.bias.detach().numpy()
    return arrays
