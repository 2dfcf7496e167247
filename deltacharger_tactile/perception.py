# SPDX-License-Identifier: Apache-2.0
"""Turns averaged frames into an estimate on a robot: pose model, the rig's calibration, the paper's classifiers."""

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
"""A reading beyond it (N) is no force: eleven times what a taxel measures."""
_SATURATED = 0.9 * SensorParameters().full_scale
"""A taxel that reads this much (N) may be pressed harder; the tare takes a part of the scale."""
_SATURATED_MOST = 3
"""Taxels of both pads that may; then their load and centres are no longer known."""


class PerceptionError(TactileError, ValueError):
    """A file cannot be used as asked. Example: a data set where a model belongs.

    Args:
        parameter: what the file was given for: model, calibration or classifiers.
        reason: what is wrong and what to do.
    """

    def __init__(self, parameter: str, reason: str) -> None:
        self.parameter = parameter
        self.reason = reason
        super().__init__(f"parameter '{parameter}': {reason}")


@dataclass(frozen=True)
class Perception:
    """Immutable, so that a node swaps it between two estimates.

    Attributes:
        model: estimates the pose.
        calibration: of the rig; None = none.
        classifiers: by target, replace the class probabilities that the pose model gives.
        classes: name of the packaged model that they are; '' = none of them.
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
            classifiers: the name of a packaged model, or npz files of `deltacharger tactile train`, one per target at
                most; empty names are ignored.

        Raises:
            PerceptionError: a file is missing or not what belongs there; the message says what to do.
        """
        pose_model = _read("model", PoseEstimator.load, model or MODEL_PATH)
        known = _read("calibration", TactileCalibration.load, calibration) if calibration else None
        found = Perception(pose_model, known)
        named = [name for name in classifiers if name]
        if len(named) == 1 and named[0] in packaged.MODELS:
            return found.answering(named[0])
        return dataclasses.replace(found, classifiers=_by_target(named))

    def answering(self, name: str) -> Perception:
        """Return the same with the class probabilities of a packaged model; with its own where the name is empty.

        Raises:
            PerceptionError: there is no such model, or its files are damaged or of another generator.
        """
        if not name:
            return self
        return dataclasses.replace(self, classifiers=_read("model", packaged.load, name), classes=name)

    @property
    def name(self) -> str:
        """What messages call the model; a calibrated one names its rig, one with packaged classes their model."""
        rig = f"+rig{self.calibration.rig}" if self.calibration else ""
        return self.model.name + rig + (f"+{self.classes}" if self.classes else "")

    @property
    def doubt(self) -> str:
        """What a person should know of how the files go together; empty = nothing."""
        if self.calibration is None or self.calibration.model == self.model.name:
            return ""
        return (
            f"the calibration was made for the model {self.calibration.model}, not {self.model.name}; "
            "make one with `deltacharger calibrate tactile --model`"
        )

    def predict(self, left: ArrayLike, right: ArrayLike) -> Estimate:
        """Estimate the pose from tared frames (10, 10) N, NaN where dead; never sure of readings that cannot be.

        Raises:
            FrameError: the arrays are not of that shape.
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
            frames = np.stack(pads)[None]  # as they were trained: without the rig's calibration
            for target, classifier in self.classifiers.items():
                shares = _shares(classifier, frames)
                changed |= {"sure": False} if shares is None else {f"{target}_probability": shares}
        return dataclasses.replace(estimate, **changed) if changed else estimate


def _by_target(paths: Sequence[str]) -> dict[str, Classifier]:
    by_target: dict[str, Classifier] = {}
    for path in paths:
        found = _read("classifiers", Classifier.load, path)
        if found.target not in TARGETS:
            raise PerceptionError("classifiers", f"{path} tells '{found.target}'; give one for {', '.join(TARGETS)}")
        if found.target in by_target:
            raise PerceptionError("classifiers", f"{path} is the second one for {found.target}; give one per target")
        by_target[found.target] = found
    return by_target


def _shares(classifier: Classifier, frames: Array) -> Array | None:
    """Return what a classifier says of one frame pair; None where a classifier of a file gives none."""
    try:
        shares = np.asarray(classifier.predict_proba(frames)[0])
    except Exception:  # arrays that fit where loading tried them need not fit here
        return None
    return shares if np.all(shares >= 0.0) and np.isclose(shares.sum(), 1.0) else None


def _read(parameter: str, load: Any, path: str | Path) -> Any:
    try:
        return load(path)
    except FileNotFoundError as error:
        raise PerceptionError(parameter, f"there is no file {path}; give the path of one that this host has") from error
    except (TactileError, OSError) as error:
        raise PerceptionError(parameter, str(error)) from error
