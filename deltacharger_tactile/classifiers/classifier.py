"""The one interface of all classifiers: fit, predict, predict_proba, save, load."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_tactile import features
from deltacharger_tactile.classifiers import files, labels, reliability
from deltacharger_tactile.classifiers.reliability import Reliability
from deltacharger_tactile.classifiers.runtime import KINDS
from deltacharger_tactile.errors import ModelError
from deltacharger_tactile.parameters import COLUMNS, CONTACT_THRESHOLD, PADS, ROWS

Array = NDArray[np.float64]
Progress = Callable[[float, str], None]
"""Told the share that is done and what is being done."""


@dataclass(frozen=True)
class Learnt:
    """What a trainer hands over.

    Attributes:
        kind: of `runtime.KINDS`.
        arrays: what that kind runs on.
        trainer_proba: probabilities (N, C) of inputs as the trainer's own library computes them; for tests.
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
}
"""The module that trains each, and what it sees: all taxels, or the physical features."""


class Classifier:
    """Tells the class of a misalignment from two tactile frames.

    Args:
        name: one of `NAMES`.
        target: one of `labels.TARGETS`.
        threshold: readings below it count as 0, N.

    Attributes:
        fit_time: s that training took; NaN where it was loaded.
        about: what else the file says: data, seeds, digest of the generator's parameters.
        reliability: when its answer may be acted on; None before `calibrate`.

    Raises:
        ModelError: there is no such classifier or target.
    """

    def __init__(self, name: str, target: str, threshold: float = CONTACT_THRESHOLD) -> None:
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

    def fit(self, frames: ArrayLike, classes: ArrayLike, seed: int = 0, progress: Progress | None = None) -> Classifier:
        """Learn from frames (N, 2, 10, 10) N and their classes (N,).

        Args:
            frames: tared; NaN where dead.
            classes: whole numbers from 0.
            seed: of whatever is random.
            progress: told how far training is.

        Raises:
            ModelError: a class without examples, or one that the target does not have.
            ModuleNotFoundError: the trainer's library is not installed; `deltacharger[train]` has all.
        """
        known = np.asarray(classes, dtype=np.int64)
        count = labels.classes(self.target)
        if not np.array_equal(np.unique(known), np.arange(count)):
            found = sorted(set(known.tolist()))
            raise ModelError(self.name, f"it needs examples of every class 0 to {count - 1} and found {found}")
        module = importlib.import_module(f"deltacharger_tactile.classifiers.{NAMES[self.name][0]}")
        inputs = self._inputs(frames)
        started = time.perf_counter()
        self._learnt = module.train(self.name, inputs, known, seed, progress or (lambda share, text: None))
        self.fit_time = time.perf_counter() - started
        self._kind, self._arrays = self._learnt.kind, dict(self._learnt.arrays)
        return self

    def calibrate(self, frames: ArrayLike, classes: ArrayLike) -> Classifier:
        """Learn from frames that `fit` has not seen when an answer may be acted on.

        Raises:
            ModelError: too few frames.
        """
        felt = np.nan_to_num(np.asarray(frames, dtype=float))
        known = np.asarray(classes, dtype=np.int64)
        self.reliability = reliability.learn(self.predict_proba(frames), known, felt, self.threshold)
        return self

    def predict_proba(self, frames: ArrayLike) -> Array:
        """Return class probabilities (N, C) of frames (N, 2, 10, 10) N, NaN where dead."""
        if not self._kind:
            raise ModelError(self.name, "it has not learnt anything; call fit or load")
        return KINDS[self._kind](self._arrays, self._inputs(frames))

    def predict(self, frames: ArrayLike) -> NDArray[np.int64]:
        """Return the most probable class (N,)."""
        return np.asarray(np.argmax(self.predict_proba(frames), axis=1))

    def trainer_proba(self, frames: ArrayLike) -> Array:
        """Return the probabilities as the library computes them with which it was trained, before it was exported."""
        if self._learnt is None:
            raise ModelError(self.name, "its trainer is gone: it was loaded")
        return self._learnt.trainer_proba(self._inputs(frames))

    def save(self, path: str | Path) -> None:
        """Write it as npz, without pickle."""
        about = {
            **self.about,
            "name": self.name,
            "target": self.target,
            "threshold": self.threshold,
            "kind": self._kind,
        }
        if self.reliability is not None:
            about["reliability"] = self.reliability.to_dict()
        files.write(path, about, self._arrays)

    @staticmethod
    def load(path: str | Path) -> Classifier:
        """Read what `save` wrote.

        Raises:
            ModelError: it is no classifier.
        """
        about, arrays = files.read(path)
        model = Classifier(about.pop("name"), about.pop("target"), about.pop("threshold"))
        model._kind, model._arrays = about.pop("kind"), arrays
        known = about.pop("reliability", None)
        model.reliability = Reliability.from_dict(known) if known else None
        model.about = about
        return model

    def _inputs(self, frames: ArrayLike) -> Array:
        """Return what the model sees of the frames: (N, 200) N or (N, F) features."""
        felt = np.asarray(frames, dtype=float).reshape(-1, PADS, ROWS, COLUMNS)
        if NAMES[self.name][1] == "features":
            return features.extract(features.fill_dead(felt), self.threshold).values
        return np.where(felt >= self.threshold, felt, 0.0).reshape(len(felt), -1)  # NaN is not at or above it
