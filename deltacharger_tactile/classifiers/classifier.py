# SPDX-License-Identifier: Apache-2.0
"""The interface of all classifiers (load, predict, predict_proba), and the packaged nine models of the paper."""

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

import deltacharger_tactile
from deltacharger_core import machine, texts
from deltacharger_core.arrays import Array
from deltacharger_tactile import errors, parameters
from deltacharger_tactile.classifiers import runtime
from deltacharger_tactile.classifiers.runtime import KINDS

TARGETS = ("angle", "vertical", "horizontal")
MODELS = ("logistic", "svm", "knn", "tree", "gbdt", "forest", "xgboost", "nn", "cnn")
"""Names of the paper's models, in its order."""


def classes(target: str) -> int:
    """Return the number of classes of a target."""
    return parameters.ANGLE_CLASSES if target == "angle" else len(parameters.POSITION_CLASSES)


Self = TypeVar("Self", bound="Classifier")


class Classifier:
    """Classifies a misalignment from two tactile frames; `load` reads a trained one.

    Args:
        name: one of `names`.
        target: one of TARGETS.
        threshold: readings below it count as 0, N.

    Attributes:
        names: of the classifiers that this class can be.
        about: further contents of the file: data, seeds, digest of the generator's parameters.

    Raises:
        ModelError: no such classifier or target.
    """

    names: tuple[str, ...] = MODELS

    def __init__(self, name: str, target: str, threshold: float = machine.CONTACT_FORCE) -> None:
        if name not in self.names or target not in TARGETS:
            raise errors.ModelError(name, f"known are {', '.join(self.names)} for {', '.join(TARGETS)}, not '{target}'")
        self.name = name
        self.target = target
        self.threshold = threshold
        self.about: dict[str, Any] = {}
        self._kind = ""
        self._arrays: dict[str, NDArray[Any]] = {}

    def predict_proba(self, frames: ArrayLike) -> Array:
        """Return class probabilities (N, C) of frames (N, 2, 10, 10) N, NaN where dead."""
        if not self._kind:
            raise errors.ModelError(self.name, "it is not trained")
        return KINDS[self._kind](self._arrays, self._inputs(frames))

    def predict(self, frames: ArrayLike) -> NDArray[np.int64]:
        """Return the most probable class (N,)."""
        return np.asarray(np.argmax(self.predict_proba(frames), axis=1))

    @classmethod
    def load(cls: type[Self], path: str | Path) -> Self:
        """Read the npz file of a trained classifier.

        Raises:
            FileNotFoundError: no such file.
            ModelError: no working classifier.
        """
        about, arrays = runtime.read(path)
        try:
            model = cls(about.pop("name"), about.pop("target"), about.pop("threshold"))
            model._restore(about, arrays)
            shares = model.predict_proba(np.ones((1, machine.PADS, machine.ROWS, machine.COLUMNS)))
        except errors.ModelError as error:
            raise errors.ModelError(str(path), error.reason) from error
        except Exception as error:  # arrays of a foreign file may raise anything
            raise errors.ModelError(str(path), "its arrays and description do not fit together") from error
        if shares.shape != (1, classes(model.target)) or not np.isclose(shares.sum(), 1.0):
            raise errors.ModelError(str(path), "it does not give probabilities")
        return model

    def _restore(self, about: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
        """Take what a file holds."""
        self._kind, self._arrays = about.pop("kind"), arrays
        self.about = about

    def _inputs(self, frames: ArrayLike) -> Array:
        """Return the model's inputs (N, 200) N."""
        readings = readings_of(frames)
        return np.where(readings >= self.threshold, readings, 0.0).reshape(len(readings), -1)  # NaN gives 0


def readings_of(frames: ArrayLike) -> Array:
    """Return frames as (N, 2, 10, 10) N."""
    return np.asarray(frames, dtype=float).reshape(-1, machine.PADS, machine.ROWS, machine.COLUMNS)


FOLDER = deltacharger_tactile.MODELS
GENERATOR, ACCURACY = "generator", "accuracy"
"""Metadata of each file: digest of the generator's parameters; accuracy on rigs that it was not trained on."""


def path(name: str, target: str, folder: Path | None = None) -> Path:
    """Return the file of a model for a target; folder None = in the package."""
    return (folder or FOLDER) / f"{name}-{target}.npz"


def load(name: str) -> Mapping[str, Classifier]:
    """Return a model's classifiers by target; each file is read once per process.

    Raises:
        ModelError: no such model, or one of its files is from another generator.
    """
    if name not in MODELS:
        raise errors.ModelError(texts.cut(name, 40), f"the packaged classifiers are {', '.join(MODELS)}")
    return {target: _load(path(name, target)) for target in TARGETS}


@functools.cache
def _load(file: Path) -> Classifier:
    model = Classifier.load(file)
    wanted = parameters.TactileParameters().digest()
    if model.about.get(GENERATOR) != wanted:
        found = texts.cut(str(model.about.get(GENERATOR)), 16)
        raise errors.ModelError(str(file), f"it was trained on the generator {found} and this version has {wanted}")
    return model
