# SPDX-License-Identifier: Apache-2.0
"""Training of the classifiers, with one interface: fit, calibrate, refer, shrink, save.

Training uses scikit-learn, XGBoost or PyTorch; the arrays that it exports need only numpy.
"""

from __future__ import annotations

import importlib
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_core.arrays import Array
from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_lab.training import reliability, splits
from deltacharger_lab.training.inputs import NAMES, PRETRAINED, digest, inputs
from deltacharger_tactile import features
from deltacharger_tactile.classifiers import runtime
from deltacharger_tactile.classifiers.classifier import Classifier, classes as classes_of, readings_of
from deltacharger_tactile.errors import DatasetError, ModelError

Progress = Callable[[float, str], None]
"""Called with the share done and the current step."""
Arrays = dict[str, NDArray[Any]]
Labels = NDArray[np.int64]

TRAINERS = {name: "deep" if name in ("nn", "cnn") else "shallow" for name in NAMES}
"""Module of this package that trains each."""
DEFAULT = "pose"
"""The best on the frozen data."""
_FEWEST = 5  # different frames of a class: as many as cross-validation has folds, and knn neighbours


@dataclass(frozen=True)
class Learnt:
    """Result of a trainer.

    Attributes:
        kind: one of `runtime.KINDS`.
        arrays: input of that kind.
        trainer_proba: probabilities (N, C) computed by the trainer's library; for tests.
    """

    kind: str
    arrays: Mapping[str, NDArray[Any]]
    trainer_proba: Callable[[Array], Array]


class TrainableClassifier(Classifier):
    """A classifier that learns; arguments of `Classifier`.

    Attributes:
        fit_time: s of training; NaN if loaded.
        reliability: when an answer may be used; None before `calibrate`.
    """

    names = tuple(NAMES)

    def __init__(self, name: str, target: str, threshold: float = CONTACT_FORCE) -> None:
        super().__init__(name, target, threshold)
        self.fit_time = float("nan")
        self.reliability: reliability.Reliability | None = None
        self._learnt: Learnt | None = None
        self._stored: Arrays = {}  # as in a file, if `shrink` found smaller types

    def fit(
        self, frames: ArrayLike, classes: ArrayLike, seed: int = 0, progress: Progress | None = None
    ) -> TrainableClassifier:
        """Train on frames (N, 2, 10, 10) N and their classes (N,).

        Args:
            frames: tared; NaN where dead.
            classes: whole numbers from 0.
            seed: of all random choices.
            progress: called with the share done.

        Raises:
            DatasetError: too few frames of a class differ and are in contact.
            ModelError: a class does not belong to the target.
            ModuleNotFoundError: the trainer's library is missing; `deltacharger[train]` has it.
        """
        known = np.asarray(classes, dtype=np.int64)
        count = classes_of(self.target)
        if not np.isin(known, np.arange(count)).all():
            raise ModelError(self.name, f"{self.target} has the classes 0 to {count - 1}")
        usable = np.bincount(known[splits.distinct(readings_of(frames), self.threshold)], minlength=count)
        if usable.min() < _FEWEST:
            raise DatasetError(
                self.target,
                f"class {usable.argmin()} (of 0 to {count - 1}) has {usable.min()} different frames in contact, at "
                f"least {_FEWEST} are needed: check the pads, and record more dockings",
            )
        module = importlib.import_module(f"deltacharger_lab.training.{TRAINERS[self.name]}")
        inputs = self._inputs(frames)
        started = time.perf_counter()
        self._learnt = module.train(self.name, inputs, known, seed, progress or (lambda share, text: None))
        self.fit_time = time.perf_counter() - started
        self._kind, self._arrays, self._stored = self._learnt.kind, dict(self._learnt.arrays), {}
        return self

    def refer(self, frames: ArrayLike, classes: ArrayLike) -> TrainableClassifier:
        """Remove a device's constant error, learnt from reference dockings of known classes.

        The mean deviation of their inputs from training, class by class, changes the scores. From now on, this change
        is subtracted, shrunk if it may be chance (James and Stein 1961).

        Raises:
            ModelError: the classifier does not use features, or fewer than two dockings differ and are in contact.
        """
        if "means" not in self._arrays:
            raise ModelError(self.name, "it cannot learn from reference dockings; train lda or pose")
        readings = readings_of(frames)
        rows = splits.distinct(readings, self.threshold)
        if len(rows) < 2:
            raise ModelError(
                self.name, f"{len(rows)} different reference dockings are too few; give at least two, better ten"
            )
        known = np.asarray(classes, dtype=np.int64)[rows]
        deviation = np.nan_to_num(self._inputs(readings[rows]) - self._arrays["means"][known])
        scores = deviation @ self._arrays["weights"]
        scores -= scores.mean(axis=1, keepdims=True)
        mean, chance = scores.mean(axis=0), scores.var(axis=0, ddof=1).sum() / len(known)
        self._arrays["bias"] = self._arrays["bias"] - max(0.0, 1.0 - chance / max(float(mean @ mean), 1e-12)) * mean
        return self

    def calibrate(
        self, frames: ArrayLike, classes: ArrayLike, familiar: ArrayLike | None = None
    ) -> TrainableClassifier:
        """Learn when an answer may be used, from frames that `fit` has not seen.

        Args:
            frames: (N, 2, 10, 10) N.
            classes: (N,) of these frames.
            familiar: (M, 2, 10, 10) N, further normal frames, such as those of `fit`; some hundred sharpen the drift
                check.

        Raises:
            ModelError: too few frames.
        """
        readings = np.nan_to_num(np.asarray(frames, dtype=float))
        known = np.asarray(classes, dtype=np.int64)
        more = None if familiar is None else np.nan_to_num(np.asarray(familiar, dtype=float))
        self.reliability = reliability.learn(self.predict_proba(frames), known, readings, self.threshold, more)
        return self

    def trainer_proba(self, frames: ArrayLike) -> Array:
        """Return the probabilities computed by the training library, before export."""
        if self._learnt is None:
            raise ModelError(self.name, "it was loaded and has no trainer; call fit")
        return self._learnt.trainer_proba(self._inputs(frames))

    def shrink(self, frames: ArrayLike) -> TrainableClassifier:
        """Store the arrays in the smallest types that change the class of none of these frames.

        Args:
            frames: (N, 2, 10, 10) N.
        """
        whole, known = self._arrays, self.predict(frames)
        for half in (True, False):
            self._stored = {name: _shrunk(name, array, half) for name, array in whole.items()}
            self._arrays = runtime.full(self._stored)
            if np.array_equal(self.predict(frames), known):
                return self
        self._stored = self._arrays = whole
        return self

    def save(self, path: str | Path) -> None:
        """Write the classifier as npz, without pickle."""
        about = {
            **self.about,
            "name": self.name,
            "target": self.target,
            "threshold": self.threshold,
            "kind": self._kind,
        }
        if self.reliability is not None:
            about["reliability"] = self.reliability.to_dict()
        if NAMES[self.name] == "pose":
            about[PRETRAINED] = digest(self.target, self.threshold)
        write(path, about, self._stored or self._arrays)

    def _restore(self, about: dict[str, Any], arrays: Arrays) -> None:
        known = about.pop("reliability", None)
        self.reliability = reliability.Reliability.from_dict(known) if known else None
        if NAMES[self.name] == "pose" and about.pop(PRETRAINED, "") != digest(self.target, self.threshold):
            raise ModelError(self.name, "it was trained on packaged models of another version; train it again")
        super()._restore(about, arrays)

    def _inputs(self, frames: ArrayLike) -> Array:
        """Return the model's inputs: (N, 200) N, (N, F) features, or features and pretrained inputs; NaN unknown."""
        sees, readings = NAMES[self.name], readings_of(frames)
        if sees == "taxels":
            return super()._inputs(readings)
        if sees == "features":
            return features.extract(features.fill_dead(readings), self.threshold).values
        return inputs(readings, self.target, self.threshold)


def write(path: str | Path, about: dict[str, Any], arrays: Arrays) -> None:
    """Write arrays and a description (`kind`, `name`, `target`, …) as npz, for `runtime.read`."""
    every: dict[str, Any] = {
        "about": np.array(json.dumps({"format": runtime.FORMAT, **about}, sort_keys=True)),
        **arrays,
    }
    np.savez_compressed(path, **every)


def _shrunk(name: str, array: NDArray[Any], half: bool) -> NDArray[Any]:
    """Return an array in the smallest integer type, or in float32, or rounded to `half`.

    Thresholds of trees are rounded down, so that every float32 reading stays on its side of "at most".
    """
    if array.dtype == bool:
        return array
    if np.issubdtype(array.dtype, np.integer):
        return array.astype(np.promote_types(np.min_scalar_type(array.min()), np.min_scalar_type(array.max())))
    small = array.astype(np.float32)
    if name == "threshold":
        return np.where(small > array, np.nextafter(small, np.float32(-np.inf)), small)
    return array.astype(np.float16) if half else small
