# SPDX-License-Identifier: Apache-2.0
"""The interface of all classifiers: load, predict, predict_proba."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_core.arrays import Array
from deltacharger_core.machine import COLUMNS, CONTACT_FORCE, PADS, ROWS
from deltacharger_tactile import features
from deltacharger_tactile.classifiers import files, labels, pretrained
from deltacharger_tactile.classifiers.runtime import KINDS
from deltacharger_tactile.errors import ModelError

Self = TypeVar("Self", bound="Classifier")

_NINE = ("logistic", "svm", "knn", "tree", "gbdt", "forest", "xgboost", "nn", "cnn")
NAMES = dict.fromkeys(_NINE, "taxels") | {"lda": "features", "pose": "pose"}
"""Inputs of each: all taxels, features, or features and the outputs of `pretrained`."""
PRETRAINED = "pretrained"
"""Key in a file: digest of the packaged models used in training."""


class Classifier:
    """Classifies a misalignment from two tactile frames; `load` reads a trained one.

    Args:
        name: one of `NAMES`.
        target: one of `labels.TARGETS`.
        threshold: readings below it count as 0, N.

    Attributes:
        about: further contents of the file: data, seeds, digest of the generator's parameters.

    Raises:
        ModelError: no such classifier or target.
    """

    def __init__(self, name: str, target: str, threshold: float = CONTACT_FORCE) -> None:
        if name not in NAMES or target not in labels.TARGETS:
            raise ModelError(name, f"known are {', '.join(NAMES)} for {', '.join(labels.TARGETS)}, not '{target}'")
        self.name = name
        self.target = target
        self.threshold = threshold
        self.about: dict[str, Any] = {}
        self._kind = ""
        self._arrays: dict[str, NDArray[Any]] = {}

    def predict_proba(self, frames: ArrayLike) -> Array:
        """Return class probabilities (N, C) of frames (N, 2, 10, 10) N, NaN where dead."""
        if not self._kind:
            raise ModelError(self.name, "it is not trained")
        return KINDS[self._kind](self._arrays, self._inputs(frames))

    def predict(self, frames: ArrayLike) -> NDArray[np.int64]:
        """Return the most probable class (N,)."""
        return np.asarray(np.argmax(self.predict_proba(frames), axis=1))

    @classmethod
    def load(cls: type[Self], path: str | Path) -> Self:
        """Read the npz file of a trained classifier.

        Raises:
            FileNotFoundError: no such file.
            ModelError: no working classifier, or one trained on packaged models of another version.
        """
        about, arrays = files.read(path)
        try:
            model = cls(about.pop("name"), about.pop("target"), about.pop("threshold"))
            model._restore(about, arrays)
            shares = model.predict_proba(np.ones((1, PADS, ROWS, COLUMNS)))
        except ModelError as error:
            raise ModelError(str(path), error.reason) from error
        except Exception as error:  # arrays of a foreign file may raise anything
            raise ModelError(str(path), "its arrays and description do not fit together") from error
        if shares.shape != (1, labels.classes(model.target)) or not np.isclose(shares.sum(), 1.0):
            raise ModelError(str(path), "it does not give probabilities")
        return model

    def _restore(self, about: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
        """Take what a file holds."""
        self._kind, self._arrays = about.pop("kind"), arrays
        if NAMES[self.name] == "pose" and about.pop(PRETRAINED, "") != pretrained.digest(self.target, self.threshold):
            raise ModelError(self.name, "it was trained on packaged models of another version; train it again")
        self.about = about

    def _inputs(self, frames: ArrayLike) -> Array:
        """Return the model's inputs: (N, 200) N, (N, F) features, or features and pretrained inputs; NaN unknown."""
        readings = readings_of(frames)
        sees = NAMES[self.name]
        if sees == "taxels":
            return np.where(readings >= self.threshold, readings, 0.0).reshape(len(readings), -1)  # NaN gives 0
        if sees == "features":
            return features.extract(features.fill_dead(readings), self.threshold).values
        return pretrained.inputs(readings, self.target, self.threshold)


def readings_of(frames: ArrayLike) -> Array:
    """Return frames as (N, 2, 10, 10) N."""
    return np.asarray(frames, dtype=float).reshape(-1, PADS, ROWS, COLUMNS)
