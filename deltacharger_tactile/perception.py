# SPDX-License-Identifier: Apache-2.0
"""Estimates from averaged frames on a robot: pose model, the rig's calibration, the paper's classifiers."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deltacharger_core.arrays import Array
from deltacharger_tactile import MODEL_PATH
from deltacharger_tactile.calibration.rig import TactileCalibration
from deltacharger_tactile.classifiers import packaged
from deltacharger_tactile.classifiers.classifier import Classifier
from deltacharger_tactile.classifiers.labels import TARGETS
from deltacharger_tactile.errors import TactileError
from deltacharger_tactile.estimate import Estimate
from deltacharger_tactile.estimator import PoseEstimator
from deltacharger_tactile.parameters import SensorParameters

_LARGEST = 100.0
"""A larger reading (N) is invalid: eleven times the measuring range."""
_SATURATED = 0.9 * SensorParameters().full_scale
"""A taxel that reads this much (N) may be saturated; the tare uses part of the range."""
_SATURATED_MOST = 3
"""Most saturated taxels of both pads; with more, load and centres are unknown."""


class PerceptionError(TactileError, ValueError):
    """A file cannot be used. Example: a data set instead of a model.

    Args:
        parameter: its parameter: model, calibration or classifiers.
        reason: what is wrong and what to do.
    """

    def __init__(self, parameter: str, reason: str) -> None:
        self.parameter = parameter
        self.reason = reason
        super().__init__(f"parameter '{parameter}': {reason}")


@dataclass(frozen=True)
class Perception:
    """Immutable, so a node can replace it between two estimates.

    Attributes:
        model: pose model.
        calibration: of the rig; None = none.
        classifiers: by target; their class probabilities replace the pose model's.
        classes: name of their packaged model; '' = none.
    """

    model: PoseEstimator
    calibration: TactileCalibration | None = None
    classifiers: Mapping[str, Classifier] = dataclasses.field(default_factory=dict)
    classes: str = ""

    @staticmethod
    def load(model: str = "", calibration: str = "", classifiers: Sequence[str] = ()) -> Perception:
        """Read and check every file.

        Args:
            model: npz file of a pose model; empty = the packaged one.
            calibration: YAML file of `deltacharger calibrate tactile`; empty = none.
            classifiers: the name of a packaged model, or trained npz files, at most one per target; empty
                names are ignored.

        Raises:
            PerceptionError: a file is missing or of the wrong kind; the message states what to do.
        """
        pose_model = _read("model", PoseEstimator.load, model or MODEL_PATH)
        known = _read("calibration", TactileCalibration.load, calibration) if calibration else None
        found = Perception(pose_model, known)
        named = [name for name in classifiers if name]
        if len(named) == 1 and named[0] in packaged.MODELS:
            return found.answering(named[0])
        return dataclasses.replace(found, classifiers=_by_target(named))

    def answering(self, name: str) -> Perception:
        """Return a copy with the class probabilities of a packaged model; an empty name changes nothing.

        Raises:
            PerceptionError: no such model, or its files are damaged or from another generator.
        """
        if not name:
            return self
        return dataclasses.replace(self, classifiers=_read("model", packaged.load, name), classes=name)

    @property
    def name(self) -> str:
        """Name in messages: pose model, rig of its calibration, model of its classes."""
        rig = f"+rig{self.calibration.rig}" if self.calibration else ""
        return self.model.name + rig + (f"+{self.classes}" if self.classes else "")

    @property
    def doubt(self) -> str:
        """A warning that the files do not match; empty = none."""
        if self.calibration is None or self.calibration.model == self.model.name:
            return ""
        return (
            f"the calibration was made for the model {self.calibration.model}, not {self.model.name}; "
            "make one with `deltacharger calibrate tactile --model`"
        )

    def predict(self, left: ArrayLike, right: ArrayLike) -> Estimate:
        """Estimate the pose from tared frames (10, 10) N, NaN where dead; invalid readings are never sure.

        Raises:
            FrameError: wrong shape.
        """
        pads = [np.asarray(pad, dtype=float) for pad in (left, right)]
        pads = [np.where(np.abs(pad) <= _LARGEST, pad, np.nan) for pad in pads]
        seen = self.calibration.apply(*pads) if self.calibration else pads
        estimate = self.model.predict(*seen)
        if self.calibration:
            estimate = self.calibration.correct(estimate, self.model.limits)
        changed: dict[str, Any] = {}
        if sum(np.count_nonzero(pad >= _SATURATED) for pad in pads) > _SATURATED_MOST:
            changed |= {"in_range": False, "sure": False}
        if estimate.contact:
            frames = np.stack(pads)[None]  # uncalibrated, as in training
            for target, classifier in self.classifiers.items():
                shares = _shares(classifier, frames)
                changed |= {"sure": False} if shares is None else {f"{target}_probability": shares}
        return dataclasses.replace(estimate, **changed) if changed else estimate


def _by_target(paths: Sequence[str]) -> dict[str, Classifier]:
    by_target: dict[str, Classifier] = {}
    for path in paths:
        found = _read("classifiers", Classifier.load, path)
        if found.target not in TARGETS:
            raise PerceptionError("classifiers", f"{path} is for '{found.target}'; give one for {', '.join(TARGETS)}")
        if found.target in by_target:
            raise PerceptionError("classifiers", f"{path} is the second one for {found.target}; give one per target")
        by_target[found.target] = found
    return by_target


def _shares(classifier: Classifier, frames: Array) -> Array | None:
    """Return a classifier's probabilities for one frame pair; None if the classifier fails."""
    try:
        shares = np.asarray(classifier.predict_proba(frames)[0])
    except Exception:  # a file that passed the test at loading may still fail here
        return None
    return shares if np.all(shares >= 0.0) and np.isclose(shares.sum(), 1.0) else None


def _read(parameter: str, load: Any, path: str | Path) -> Any:
    try:
        return load(path)
    except FileNotFoundError as error:
        raise PerceptionError(parameter, f"there is no file {path}; give the path of a file on this host") from error
    except (TactileError, OSError) as error:
        raise PerceptionError(parameter, str(error)) from error
