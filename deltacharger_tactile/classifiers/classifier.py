# SPDX-License-Identifier: Apache-2.0
"""The interface of all classifiers: fit, predict, predict_proba, save, load."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_core.arrays import Array
from deltacharger_core.machine import COLUMNS, CONTACT_FORCE, PADS, ROWS
from deltacharger_tactile import features
from deltacharger_tactile.classifiers import files, labels, pretrained, reliability
from deltacharger_tactile.classifiers.reliability import Reliability
from deltacharger_tactile.classifiers.runtime import KINDS
from deltacharger_tactile.errors import DatasetError, ModelError

Progress = Callable[[float, str], None]
"""Called with the share done and the current step."""


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


NAMES: dict[str, tuple[str, str]] = {
    "logistic": ("shallow", "taxels"),
    "svm": ("shallow", "taxels"),
    "knn": ("shallow", "taxels"),
    "tree": ("shallow", "taxels"),
    "gbdt": ("shallow", "taxels"),
    "forest": ("shallow", "taxels"),
    "xgboost": ("shallow", "taxels"),
    "nn": ("deep", "taxels"),
    "cnn": ("deep", "taxels"),
    "lda": ("shallow", "features"),
    "pose": ("shallow", "pose"),
}
"""Training module and inputs of each: all taxels, features, or features and the outputs of `pretrained`."""
DEFAULT = "pose"
"""The best on the frozen data."""
_FEWEST = 5  # different frames of a class: as many as cross-validation has folds, and knn neighbours
_PRETRAINED = "pretrained"  # key in a file: digest of the packaged models used in training


class Classifier:
    """Classifies a misalignment from two tactile frames.

    Args:
        name: one of `NAMES`.
        target: one of `labels.TARGETS`.
        threshold: readings below it count as 0, N.

    Attributes:
        fit_time: s of training; NaN if loaded.
        about: further contents of the file: data, seeds, digest of the generator's parameters.
        reliability: when an answer may be used; None before `calibrate`.

    Raises:
        ModelError: no such classifier or target.
    """

    def __init__(self, name: str, target: str, threshold: float = CONTACT_FORCE) -> None:
        if name not in NAMES or target not in labels.TARGETS:
            raise ModelError(name, f"known are {', '.join(NAMES)} for {', '.join(labels.TARGETS)}, not '{target}'")
        self.name = name
        self.target = target
        self.threshold = threshold
        self.fit_time = float("nan")
        self.about: dict[str, Any] = {}
        self.reliability: Reliability | None = None
        self._learnt: Learnt | None = None
        self._kind = ""
        self._arrays: dict[str, NDArray[Any]] = {}
        self._stored: dict[str, NDArray[Any]] = {}  # as in a file, if `shrink` found smaller types

    def fit(self, frames: ArrayLike, classes: ArrayLike, seed: int = 0, progress: Progress | None = None) -> Classifier:
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
        count = labels.classes(self.target)
        if not np.isin(known, np.arange(count)).all():
            raise ModelError(self.name, f"{self.target} has the classes 0 to {count - 1}")
        usable = np.bincount(known[features.distinct(_readings(frames), self.threshold)], minlength=count)
        if usable.min() < _FEWEST:
            raise DatasetError(
                self.target,
                f"class {usable.argmin()} (of 0 to {count - 1}) has {usable.min()} different frames in contact, at "
                f"least {_FEWEST} are needed: check the pads, and record more dockings",
            )
        module = importlib.import_module(f"deltacharger_tactile.classifiers.{NAMES[self.name][0]}")
        inputs = self._inputs(frames)
        started = time.perf_counter()
        self._learnt = module.train(self.name, inputs, known, seed, progress or (lambda share, text: None))
        self.fit_time = time.perf_counter() - started
        self._kind, self._arrays, self._stored = self._learnt.kind, dict(self._learnt.arrays), {}
        return self

    def refer(self, frames: ArrayLike, classes: ArrayLike) -> Classifier:
        """Remove a device's constant error, learnt from reference dockings of known classes.

        The mean deviation of their inputs from training, class by class, changes the scores. From now on, this change
        is subtracted, shrunk if it may be chance (James and Stein 1961).

        Raises:
            ModelError: the classifier does not use features, or fewer than two dockings differ and are in contact.
        """
        if "means" not in self._arrays:
            raise ModelError(self.name, "it cannot learn from reference dockings; train lda or pose")
        readings = _readings(frames)
        rows = features.distinct(readings, self.threshold)
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

    def calibrate(self, frames: ArrayLike, classes: ArrayLike, familiar: ArrayLike | None = None) -> Classifier:
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

    def predict_proba(self, frames: ArrayLike) -> Array:
        """Return class probabilities (N, C) of frames (N, 2, 10, 10) N, NaN where dead."""
        if not self._kind:
            raise ModelError(self.name, "it is not trained; call fit or load")
        return KINDS[self._kind](self._arrays, self._inputs(frames))

    def predict(self, frames: ArrayLike) -> NDArray[np.int64]:
        """Return the most probable class (N,)."""
        return np.asarray(np.argmax(self.predict_proba(frames), axis=1))

    def trainer_proba(self, frames: ArrayLike) -> Array:
        """Return the probabilities computed by the training library, before export."""
        if self._learnt is None:
            raise ModelError(self.name, "it was loaded and has no trainer; call fit")
        return self._learnt.trainer_proba(self._inputs(frames))

    def shrink(self, frames: ArrayLike) -> Classifier:
        """Store the arrays in the smallest types that change the class of none of these frames.

        Args:
            frames: (N, 2, 10, 10) N.
        """
        whole, known = self._arrays, self.predict(frames)
        for half in (True, False):
            self._stored = files.shrunk(whole, half)
            self._arrays = files.full(self._stored)
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
        if NAMES[self.name][1] == "pose":
            about[_PRETRAINED] = pretrained.digest(self.target, self.threshold)
        files.write(path, about, self._stored or self._arrays)

    @staticmethod
    def load(path: str | Path) -> Classifier:
        """Read a file written by `save`.

        Raises:
            FileNotFoundError: no such file.
            ModelError: no working classifier, or one trained on packaged models of another version.
        """
        about, arrays = files.read(path)
        try:
            model = Classifier(about.pop("name"), about.pop("target"), about.pop("threshold"))
            model._kind, model._arrays = about.pop("kind"), arrays
            if NAMES[model.name][1] == "pose":
                model._check_pretrained(about.pop(_PRETRAINED, ""))
            known = about.pop("reliability", None)
            model.reliability = Reliability.from_dict(known) if known else None
            shares = model.predict_proba(np.ones((1, PADS, ROWS, COLUMNS)))
        except ModelError as error:
            raise ModelError(str(path), error.reason) from error
        except Exception as error:  # arrays of a foreign file may raise anything
            raise ModelError(str(path), "its arrays and description do not fit together") from error
        if shares.shape != (1, labels.classes(model.target)) or not np.isclose(shares.sum(), 1.0):
            raise ModelError(str(path), "it does not give probabilities")
        model.about = about
        return model

    def _check_pretrained(self, trained_on: str) -> None:
        if trained_on != pretrained.digest(self.target, self.threshold):
            raise ModelError(self.name, "it was trained on packaged models of another version; train it again")

    def _inputs(self, frames: ArrayLike) -> Array:
        """Return the model's inputs: (N, 200) N, (N, F) features, or features and pretrained inputs; NaN unknown."""
        readings = _readings(frames)
        sees = NAMES[self.name][1]
        if sees == "taxels":
            return np.where(readings >= self.threshold, readings, 0.0).reshape(len(readings), -1)  # NaN gives 0
        if sees == "features":
            return features.extract(features.fill_dead(readings), self.threshold).values
        return pretrained.inputs(readings, self.target, self.threshold)


def _readings(frames: ArrayLike) -> Array:
    """Return frames as (N, 2, 10, 10) N."""
    return np.asarray(frames, dtype=float).reshape(-1, PADS, ROWS, COLUMNS)
