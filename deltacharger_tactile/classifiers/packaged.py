# SPDX-License-Identifier: Apache-2.0
"""The packaged nine models of the paper: by name, one file for each target."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path

import deltacharger_tactile
from deltacharger_core.texts import cut
from deltacharger_tactile.classifiers.classifier import NAMES, Classifier
from deltacharger_tactile.classifiers.labels import TARGETS
from deltacharger_tactile.errors import ModelError, UnknownModelError
from deltacharger_tactile.parameters import TactileParameters

MODELS = tuple(name for name, sees in NAMES.items() if sees == "taxels")
"""Their names, in the paper's order."""
FOLDER = deltacharger_tactile.MODELS
GENERATOR, ACCURACY = "generator", "accuracy"
"""Metadata of each file: digest of the generator's parameters; accuracy on rigs that it was not trained on."""


def path(name: str, target: str, folder: Path | None = None) -> Path:
    """Return the file of a model for a target; folder None = in the package."""
    return (folder or FOLDER) / f"{name}-{target}.npz"


def load(name: str) -> Mapping[str, Classifier]:
    """Return a model's classifiers by target; each file is read once per process.

    Raises:
        UnknownModelError: no such model.
        ModelError: one of its files is missing, damaged or from another generator.
    """
    if name not in MODELS:
        raise UnknownModelError(name, MODELS)
    return {target: _load(name, target, path(name, target)) for target in TARGETS}


@functools.cache
def _load(name: str, target: str, file: Path) -> Classifier:
    try:
        model = Classifier.load(file)
    except FileNotFoundError as error:
        raise ModelError(str(file), "it is missing from the package; install it again") from error
    wanted = TactileParameters().digest()
    if model.about.get(GENERATOR) != wanted:
        found = cut(str(model.about.get(GENERATOR)), 16)
        raise ModelError(str(file), f"it was trained on the generator {found} and this version has {wanted}")
    if (model.name, model.target) != (name, target):
        raise ModelError(str(file), f"it holds {model.name} for {model.target}")
    return model
