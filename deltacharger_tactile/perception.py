# SPDX-License-Identifier: Apache-2.0
"""Estimates from averaged frames on a robot: the newest frames, pose model, the rig's calibration, classifiers."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deltacharger_core import arrays, machine, real_time
from deltacharger_tactile import MODEL_PATH, errors, estimator, parameters
from deltacharger_tactile.calibration.rig import TactileCalibration
from deltacharger_tactile.classifiers import classifier
from deltacharger_tactile.classifiers.classifier import Classifier


@dataclass(frozen=True)
class Frame:
    """One reading of both pads.

    Attributes:
        sampled: s, time of sampling on the clock of `FrameWindow`.
        stamp: the same time, as in the message.
        sequence: of the message.
        tared: whether the baseline was subtracted.
        left: (10, 10) N, the pad at +x; NaN = dead.
        right: (10, 10) N, the pad at −x.
    """

    sampled: float
    stamp: Any
    sequence: int
    tared: bool
    left: arrays.Array
    right: arrays.Array


class Refused(Exception):
    """Frames do not allow an estimate. Example: untared frames; the message states what to do."""


class FrameWindow:
    """Received frames of one device; all methods are thread-safe.

    Args:
        now: clock of the frames' sampling times, s.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._frames: deque[tuple[float, Frame]] = deque(
            maxlen=parameters.FRAMES_MAX
        )  # with the time.monotonic() of their arrival
        self._arrived = threading.Condition()
        self._closed = False

    def add_frame(self, frame: Frame) -> None:
        """Add a frame and wake waiting threads."""
        with self._arrived:
            self._frames.append((time.monotonic(), frame))
            self._arrived.notify_all()

    def close(self) -> None:
        """Release waiting threads."""
        with self._arrived:
            self._closed = True
            self._arrived.notify_all()

    def newest(self, count: int) -> list[Frame]:
        """Return at most `count` frames, oldest first."""
        with self._arrived:
            return [frame for _, frame in self._frames][-count:]

    def fresh(self, wanted: int, timeout: float) -> list[Frame]:
        """Wait for `wanted` frames that are sampled and received from now on.

        Both conditions are needed: another computer's clock may be ahead, and its frames date from the future.

        Args:
            wanted: number of frames, at most FRAMES_MAX.
            timeout: s beyond their duration at 120 Hz.

        Raises:
            Refused: they did not arrive in time, or the window was closed.
        """
        since, asked = self._now(), time.monotonic()
        deadline = asked + timeout + wanted / machine.FRAME_RATE
        with self._arrived:
            while True:
                fresh = [frame for arrived, frame in self._frames if arrived > asked and frame.sampled > since]
                if self._closed:
                    raise Refused("the node is closing")
                if len(fresh) >= wanted:
                    return fresh[:wanted]
                left = deadline - time.monotonic()
                if left <= 0.0:
                    raise Refused(self._why_too_few(len(fresh), wanted))
                self._arrived.wait(left)

    def average(self, frames: Sequence[Frame], max_age: float) -> tuple[arrays.Array, arrays.Array]:
        """Return left and right (10, 10) N, the mean of frames; a taxel that is dead in one frame is dead.

        Args:
            frames: at least one, oldest first.
            max_age: s, largest age of the newest.

        Raises:
            Refused: the frames are stale or not tared.
        """
        age = self._now() - frames[-1].sampled
        if not age <= max_age:
            raise Refused(f"the newest tactile frame is {age:.3f} s old, more than max_age {max_age:g} s")
        if age < -max_age:
            raise Refused(
                f"the newest tactile frame is stamped {-age:.3f} s ahead of this node's clock; "
                f"{real_time.COMPARE_CLOCKS}"
            )
        if not all(frame.tared for frame in frames):
            raise Refused("the tactile frames are not tared; call the service tare without contact")
        left, right = (np.mean([getattr(frame, side) for frame in frames], axis=0) for side in ("left", "right"))
        return left, right

    def _why_too_few(self, fresh: int, wanted: int) -> str:
        if not self._frames:
            return "no tactile_frame has arrived; check that tactile_node runs"
        age = self._now() - self._frames[-1][1].sampled
        return (
            f"{fresh} of {wanted} fresh frames arrived in time, the newest is {age:.2f} s old; check tactile_node; "
            f"{real_time.COMPARE_CLOCKS}"
        )


_LARGEST = 100.0
"""A larger reading (N) is invalid: eleven times the measuring range."""
_SATURATED = 0.9 * parameters.SensorParameters().full_scale
"""A taxel that reads this much (N) may be saturated; the tare uses part of the range."""
_SATURATED_MOST = 3
"""Most saturated taxels of both pads; with more, load and centres are unknown."""


class PerceptionError(errors.TactileError, ValueError):
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

    model: estimator.PoseEstimator
    calibration: TactileCalibration | None = None
    classifiers: Mapping[str, Classifier] = dataclasses.field(default_factory=dict)
    classes: str = ""

    @staticmethod
    def load(model: str = "", calibration: str = "", classifiers: str = "") -> Perception:
        """Read and check every file.

        Args:
            model: npz file of a pose model; empty = the packaged one.
            calibration: YAML file of `deltacharger calibrate tactile`; empty = none.
            classifiers: the name of a packaged model; empty = none.

        Raises:
            PerceptionError: a file is missing or of the wrong kind; the message states what to do.
        """
        pose_model = _read("model", estimator.PoseEstimator.load, model or MODEL_PATH)
        known = _read("calibration", TactileCalibration.load, calibration) if calibration else None
        return Perception(pose_model, known).answering(classifiers)

    def answering(self, name: str) -> Perception:
        """Return a copy with the class probabilities of a packaged model; an empty name changes nothing.

        Raises:
            PerceptionError: no such model, or its files are damaged or from another generator.
        """
        if not name:
            return self
        return dataclasses.replace(self, classifiers=_read("model", classifier.load, name), classes=name)

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

    def predict(self, left: ArrayLike, right: ArrayLike) -> estimator.Estimate:
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


def _shares(classifier: Classifier, frames: arrays.Array) -> arrays.Array | None:
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
    except (errors.TactileError, OSError) as error:
        raise PerceptionError(parameter, str(error)) from error
